"""`jaxbrdf ndf`: one table of many scans, what is said of it, and what is refused."""

import json

import jax
import numpy as np
import pytest
from typer.testing import CliRunner

from data_loaders import read_about, read_ndf, write_heightfield
from jaxbrdf import Heightfield, TabulatedNDF, facet_ndf, filtered_ndf, gaussian_surface, levelled
from jaxbrdf.cli import ndf, ndf_pictures
from jaxbrdf.cli.main import app


def run(*arguments):
    return CliRunner().invoke(app, ["ndf", *(str(argument) for argument in arguments)])


@pytest.fixture(scope="module")
def surfaces():
    """Brushed along x: slopes along y are three times as steep."""
    return [gaussian_surface(jax.random.key(k), (96, 128), 0.5, 0.3, (9.0, 3.0)) for k in (0, 1)]


@pytest.fixture(scope="module")
def folder(surfaces, tmp_path_factory):
    """Two scans, and a file that is none."""
    folder = tmp_path_factory.mktemp("scans")
    for name, surface in zip(("a.h5", "b.h5"), surfaces, strict=True):
        write_heightfield(folder / name, surface)
    (folder / "broken.npy").write_bytes(b"nothing")
    return folder


@pytest.fixture(scope="module")
def result(folder):
    return run(folder, "--size", 65, "--out", folder / "out" / "table.h5", "--json")


def test_one_table_of_all_scans_is_written(result, folder, surfaces):
    table = np.asarray(read_ndf(folder / "out" / "table.h5").values)
    each = [np.asarray(filtered_ndf(levelled(surface), size=65).values) for surface in surfaces]
    np.testing.assert_allclose(table, sum(each) / 2, atol=1e-9)
    about = read_about(folder / "out" / "table.h5")
    assert (about["method"], about["levelled"], about["scans"]) == ("filtered", "plane", 2.0)
    assert about["sigma"] == 1.0  # of both
    assert about["source"] == (str(folder / "a.h5"), str(folder / "b.h5"))
    assert (folder / "out" / "table.png").read_bytes().startswith(b"\x89PNG")


def test_json_tells_of_scans_slopes_fits_and_failures(result, folder):
    assert result.exit_code == 1  # one file is none
    document = json.loads(result.stdout)
    assert [scan["name"] for scan in document["scans"]] == ["a", "b"]
    scan = document["scans"][0]
    assert (scan["shape"], scan["pixel"], scan["missing"], scan["sigma"]) == ([96, 128], [0.5, 0.5], 0, 1)
    assert 0.1 < scan["Sq"] < 0.5
    assert document["integral"] == pytest.approx(1)
    x, y = document["rms_slope"]
    assert y > 2 * x
    assert [fit["model"] for fit in document["fits"]] == ["ellipsoid", "GGX", "Beckmann"]
    assert all(0 < fit["relative_l2"] < 0.8 for fit in document["fits"])
    beckmann = document["fits"][2]["parameters"]
    assert beckmann["alpha_y"] > 2 * beckmann["alpha_x"]
    assert "broken.npy" in document["failed"][0]["source"]


def test_other_methods_and_a_table_for_people(folder, surfaces):
    plain = ("--method", "facet", "--size", 33, "--level", "none", "--no-picture")
    shown = run(folder / "a.h5", *plain, "--out", folder / "facet.h5")
    assert shown.exit_code == 0, shown.output
    assert "rms slope" in shown.stdout
    assert "Beckmann" in shown.stdout
    np.testing.assert_array_equal(read_ndf(folder / "facet.h5").values, facet_ndf(surfaces[0], 33).values)
    assert not (folder / "facet.png").exists()
    waves = ("--method", "kirchhoff", "--wavelength", 2.0, "--size", 129, "--no-picture", "--json")
    kirchhoff = run(folder / "a.h5", *waves, "--out", folder / "kirchhoff.h5")
    document = json.loads(kirchhoff.stdout)
    assert document["integral"] == pytest.approx(1, abs=0.1)
    assert document["wavelength"] == 2.0


def test_a_table_of_a_window_is_told_of_and_drawn_like_the_disk():
    values = np.zeros((65, 65))
    x = np.arange(-12, 13) / 4
    values[20:45, 20:45] = np.exp(-((x[None, :] - 0.5) ** 2) - (x[:, None] + x[None, :]) ** 2 / 3)
    whole, window = TabulatedNDF(values), TabulatedNDF(values[20:45, 20:45], (25 / 65, 25 / 65))
    told = [np.hstack(list(ndf._slopes(table).values())) for table in (window, whole)]
    np.testing.assert_allclose(*told, rtol=1e-12)
    assert ndf_pictures._spread(window) == pytest.approx(ndf_pictures._spread(whole), rel=1e-9)
    figures = [ndf_pictures.overview(table, {}, "") for table in (window, whole)]
    left, right = (figure.axes[1].lines[0].get_xydata() for figure in figures)
    inside = np.isfinite(left[:, 1])
    assert 0.2 < np.mean(inside) < 1
    middle = np.abs(left[:, 0]) < 10  # degrees; what slices are smoothed by ends with the window
    np.testing.assert_allclose(left[middle], right[middle], rtol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("a.h5", "--out", "t.txt"), "ends in .h5"),
        (("a.h5", "--out", "a.h5", "--force"), "overwrite"),
        (("a.h5", "--out", "b.h5"), "--force replaces it"),
        (("a.h5", "--out", "t.h5", "--size", "64"), "odd number"),
        (("a.h5", "--out", "t.h5", "--method", "guess"), "filtered"),
        (("a.h5", "--out", "t.h5", "--level", "cubic"), "quadratic"),
        (("empty", "--out", "t.h5"), "no file with the suffix"),
    ],
)
def test_nonsense_is_refused_before_any_work(folder, monkeypatch, arguments, message):
    monkeypatch.chdir(folder)
    (folder / "empty").mkdir(exist_ok=True)
    result = run(*arguments)
    assert result.exit_code == 2
    assert message in result.stderr.replace("\n", " ")


def test_a_wrong_sigma_is_told_and_nothing_is_written(folder):
    result = run(folder / "a.h5", "--sigma", "0.2", "--out", folder / "none.h5")
    assert result.exit_code == 2
    assert "at least the larger pixel size" in result.stderr
    assert not (folder / "none.h5").exists()


def test_scans_without_a_normal_are_told_and_nothing_is_written(folder, tmp_path):
    mask = np.zeros((9, 9), bool)
    mask[::3, ::3] = True
    write_heightfield(tmp_path / "sparse.h5", Heightfield(np.zeros((9, 9)), 1, 1, mask))
    result = run(tmp_path / "sparse.h5", "--method", "facet", "--out", tmp_path / "none.h5")
    assert result.exit_code == 2
    assert "no normal is known" in result.stderr
    assert not (tmp_path / "none.h5").exists()
