"""`jaxbrdf patches` and `jaxbrdf texture`: maps of scans, resumed and refused, and surfaces like them."""

import json
import shutil

import jax
import numpy as np
import pytest
from typer.testing import CliRunner

from data_loaders import read_about, read_ndf_maps, write_heightfield
from fitting import fit_ndf_patches
from jaxbrdf import Ellipsoid, Heightfield, gaussian_surface, levelled, patch_ndfs
from jaxbrdf.cli import patches as command
from jaxbrdf.cli.main import app

SIZE = ("--size", 12, "--cells", 33)


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def surfaces():
    """Brushed along x; the second has a hole larger than a patch."""
    first, second = (gaussian_surface(jax.random.key(k), (96, 120), 0.5, 0.2, (9.0, 3.0)) for k in (0, 1))
    mask = np.ones(second.z.shape, bool)
    mask[:40, :40] = False
    return [first, Heightfield(second.z, 0.5, 0.5, mask)]


@pytest.fixture(scope="module")
def folder(surfaces, tmp_path_factory):
    folder = tmp_path_factory.mktemp("patches")
    for name, surface in zip("ab", surfaces, strict=True):
        write_heightfield(folder / f"{name}.h5", surface)
    (folder / "broken.npy").write_bytes(b"nothing")
    return folder


@pytest.fixture(scope="module")
def result(folder):
    return run("patches", folder, *SIZE, "--out", folder / "out" / "maps.h5", "--json")


def test_maps_are_those_of_the_library(result, folder, surfaces):
    assert result.exit_code == 1  # one file is none
    maps = read_ndf_maps(folder / "out" / "maps.h5")
    assert [item.name for item in maps] == ["a", "b"]
    start = Ellipsoid(*(np.array(value) for value in (0.2, 0.2, 0.0, 0.0, 0.0)))
    for item, surface in zip(maps, surfaces, strict=True):
        tables = patch_ndfs(levelled(surface), 12.0, cells=33)
        fit = fit_ndf_patches(start, tables, loss="likelihood")
        np.testing.assert_array_equal(np.ravel(item.status), fit.status)
        np.testing.assert_allclose(np.ravel(item.cost), fit.cost, rtol=1e-9)
        pair = flat(item.ndf), fit.model
        scatter = [np.nan_to_num(jax.vmap(Ellipsoid.slope_form)(model)[1]) for model in pair]
        np.testing.assert_allclose(*scatter, atol=1e-9)
    about = read_about(folder / "out" / "maps.h5")
    assert about["source"] == (str(folder / "a.h5"), str(folder / "b.h5"))
    assert (about["patch"], about["loss"], about["levelled"]) == (12.0, "likelihood", "plane")
    assert (folder / "out" / "maps.png").read_bytes().startswith(b"\x89PNG")


def flat(ndf):
    return jax.tree.map(np.ravel, ndf)


def test_json_tells_of_maps_and_failures(result):
    document = json.loads(result.stdout)
    a, b = document["maps"]
    assert (a["shape"], a["size"], a["step"]) == ([4, 5], [12, 12], [12, 12])
    assert a["fitted"] == 20
    assert b["fitted"] + b["statuses"]["too_few_samples"] == 20
    assert a["parameters"]["alpha_y"]["mean"] > 2 * a["parameters"]["alpha_x"]["mean"]
    assert 0 < a["KL"] < 1
    assert "broken.npy" in document["failed"][0]["source"]


def test_l2_tells_its_own_error(folder):
    made = run(
        "patches", folder / "a.h5", *SIZE, "--loss", "l2", "--json", "--out", folder / "l2" / "maps.h5"
    )
    (found,) = json.loads(made.stdout)["maps"]
    (item,) = read_ndf_maps(folder / "l2" / "maps.h5")
    assert found["L2"] == pytest.approx(np.median(np.sqrt(item.cost / 50)))


def test_what_is_finished_is_kept(folder, result, monkeypatch):
    """A second run fits nothing; an interrupted one leaves what was finished, and the rest follows."""
    maps = folder / "out" / "maps.h5"
    before = read_ndf_maps(maps)
    fitted = command.Options.fitted
    monkeypatch.setattr(command.Options, "fitted", lambda *_: pytest.fail("fitted again"))
    again = run("patches", folder / "a.h5", folder / "b.h5", *SIZE, "--out", maps)
    assert again.exit_code == 0, again.output
    assert "a*" in again.stdout

    def interrupted(options, name, heightfield):
        if name == "b":
            raise KeyboardInterrupt
        return fitted(options, name, heightfield)

    monkeypatch.setattr(command.Options, "fitted", interrupted)
    arguments = ("patches", folder / "a.h5", folder / "b.h5", *SIZE, "--no-picture", "--out")
    half = folder / "half.h5"
    stopped = run(*arguments, half)
    assert stopped.exit_code == 130
    assert [item.name for item in read_ndf_maps(half)] == ["a"]
    monkeypatch.setattr(command.Options, "fitted", fitted)
    resumed = run(*arguments, half)
    assert resumed.exit_code == 0
    assert "1 of 2 kept" in resumed.stderr
    for one, other in zip(before, read_ndf_maps(half), strict=True):
        np.testing.assert_array_equal(one.status, other.status)
        np.testing.assert_allclose(one.ndf.alpha_x, other.ndf.alpha_x, rtol=1e-12)
        np.testing.assert_allclose(one.ndf.theta_z, other.ndf.theta_z, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("a.h5", "--size", "12", "--out", "out/maps.h5"), "holds"),
        (("a.h5", "b.h5", "--size", "10", "--out", "out/maps.h5"), "another way"),
        (("a.h5", "--size", "12", "--out", "b.h5"), "is there already"),
        (("a.h5", "--size", "12", "--out", "a.h5"), "overwrite"),
        (("a.h5", "--size", "-1", "--out", "t.h5"), "greater than 0"),
        (("a.h5", "--size", "12", "--loss", "l3", "--out", "t.h5"), "likelihood, l2"),
        (("a.h5", "--size", "12", "--cells", "3", "--out", "t.h5"), "at least 5"),
        (("a.h5", "--size", "12", "--level", "cubic", "--out", "t.h5"), "quadratic"),
    ],
)
def test_nonsense_is_refused_before_any_work(folder, result, monkeypatch, arguments, message):
    monkeypatch.chdir(folder)
    before = {path: path.read_bytes() for path in folder.rglob("*.h5")}
    refused = run("patches", *arguments)
    assert refused.exit_code == 2
    assert message in refused.stderr.replace("\n", " ")
    assert before == {path: path.read_bytes() for path in folder.rglob("*.h5")}


def test_patches_that_do_not_fit_the_scan_are_told(folder):
    refused = run("patches", folder / "a.h5", "--size", 500, "--out", folder / "none.h5")
    assert refused.exit_code == 2
    assert "at most the map" in refused.stderr.replace("\n", " ")
    assert not (folder / "none.h5").exists()


def test_a_scan_without_any_fitted_patch_is_told(tmp_path):
    """Too flat in one direction: every patch's normals lie in one line."""
    z = 0.3 * np.random.default_rng(0).standard_normal(60)[None, :] * np.ones((60, 1))
    write_heightfield(tmp_path / "grooves.h5", Heightfield(z, 0.5, 0.5))
    flat = run("patches", tmp_path / "grooves.h5", "--size", 10, "--out", tmp_path / "maps.h5")
    assert flat.exit_code == 0, flat.output
    assert "–" in flat.stdout
    assert not (tmp_path / "maps.png").exists()
    refused = run("texture", tmp_path / "maps.h5", "--shape", 8, 8)
    assert refused.exit_code == 2
    assert "two known values" in refused.stderr.replace("\n", " ")


def test_a_texture_is_written_told_of_and_drawn(folder, result, tmp_path):
    maps = shutil.copy(folder / "out" / "maps.h5", tmp_path / "maps.h5")
    made = run("texture", maps, "--shape", 24, 40, "--seed", 3)
    assert made.exit_code == 0, made.output
    assert "neighbours along x" in made.stdout
    (texture,) = read_ndf_maps(tmp_path / "maps.texture.h5")
    assert texture.shape == (24, 40)
    assert texture.step == (12.0, 12.0)
    assert (tmp_path / "maps.texture.png").read_bytes().startswith(b"\x89PNG")
    other = run(
        "texture", maps, "--shape", 24, 40, "--seed", 3, "--scan", "b", "--json", "--no-picture", "--force"
    )
    document = json.loads(other.stdout)
    assert document["exemplar"]["name"] == "b"
    both = document["parameters"]["theta_x"]
    assert both["texture"]["std"] == pytest.approx(both["exemplar"]["std"], rel=0.2)
    assert (document["spectrum"], document["marginals"]) == ("full", "those of the exemplar")


def test_two_files_are_strips(folder, result, tmp_path):
    """Whatever their shape, their patches are taken in order."""
    for name in ("along", "across"):
        shutil.copy(folder / "out" / "maps.h5", tmp_path / f"{name}.h5")
    strips = tmp_path / "along.h5", tmp_path / "across.h5"
    made = run("texture", *strips, "--shape", 30, 30, "--out", tmp_path / "t.h5", "--json", "--no-picture")
    assert made.exit_code == 0, made.output
    assert read_ndf_maps(tmp_path / "t.h5")[0].shape == (30, 30)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("out/maps.h5", "--shape", "0", "5"), "positive"),
        (("out/maps.h5", "--shape", "8", "8", "--scan", "c"), "expected one of a, b"),
        (("a.h5", "--shape", "8", "8"), "maps of distributions"),
        (("out/maps.h5", "out/maps.h5", "out/maps.h5", "--shape", "8", "8"), "two of strips"),
        (("out/maps.h5", "out/maps.h5", "--shape", "8", "8", "--normal"), "separable"),
        (("out/maps.h5", "--shape", "8", "8", "--out", "out/maps.h5"), "overwrite"),
        (("out/maps.h5", "--shape", "8", "8", "--out", "a.h5"), "--force"),
        (("none.h5", "--shape", "8", "8"), "none.h5"),
    ],
)
def test_nonsense_of_textures_is_refused(folder, result, monkeypatch, arguments, message):
    monkeypatch.chdir(folder)
    refused = run("texture", *arguments)
    assert refused.exit_code == 2
    assert message in refused.stderr.replace("\n", " ")
    assert not (folder / "out" / "maps.texture.h5").exists()


def test_a_file_cut_short_is_told(folder, result, tmp_path):
    whole = (folder / "out" / "maps.h5").read_bytes()
    (tmp_path / "cut.h5").write_bytes(whole[: len(whole) // 2])
    refused = run("texture", tmp_path / "cut.h5", "--shape", 8, 8)
    assert refused.exit_code == 2
    assert "cut.h5" in refused.stderr.replace("\n", "")
