"""`jaxbrdf convert` and `jaxbrdf show`: files of every kind, pictures, JSON, and what is refused."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from data_loaders import read_brdf, write_brdf
from jaxbrdf import AdaptiveBRDF, Lambertian, MeasuredBRDF, MeasuredSamples, as_adaptive, as_table
from jaxbrdf.cli import portrait
from jaxbrdf.cli.main import app


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def samples(channels=3, **about) -> MeasuredSamples:
    """Three incidences, all around; f = 0.1, 0.2, … in the channels."""
    theta_i, theta_o, phi_o = np.meshgrid(
        [0.3, 0.7, 1.1], np.linspace(0, 1.5, 12), np.linspace(0, np.pi, 9), indexing="ij"
    )
    angles = [theta_i.ravel(), np.full(theta_i.size, np.pi), theta_o.ravel(), phi_o.ravel()]
    values = np.tile(0.1 * np.arange(1, channels + 1), (theta_i.size, 1))
    return MeasuredSamples(*angles, values, np.ones(theta_i.size), **about)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """spectral.csv (five wavelengths, one sample invalid) and rgb.alta."""
    folder = tmp_path_factory.mktemp("files")
    spectral = samples(5, wavelengths=np.linspace(0.4, 0.7, 5), name="paint", origin=("by hand",))
    spectral.values[0, 2] = -1.0
    write_brdf(folder / "spectral.csv", spectral)
    write_brdf(folder / "rgb.alta", samples())
    return folder


def test_lossless_is_said_and_true(folder):
    result = run("convert", folder / "spectral.csv", folder / "same.h5")
    assert result.exit_code == 0
    assert "lossless: read again, every number is the same" in result.stdout
    before, after = read_brdf(folder / "spectral.csv"), read_brdf(folder / "same.h5")
    np.testing.assert_array_equal(before.values, after.values)
    np.testing.assert_array_equal(before.wavelengths, after.wavelengths)


def test_published_numbers_become_samples(folder):
    target = folder / "nickel.csv"
    document = json.loads(run("convert", "abc:nickel", target, "--json").stdout)
    assert document["read_as"] == "published"
    assert document["from"] == "the model Lambertian + ABC"
    assert not document["lossless"]
    assert document["relative_l2"] == [0, 0, 0]
    assert len(document["channels"]) == read_brdf(target).values.shape[1] == 3
    assert "rearranged from the model" in run("convert", "abc:nickel", target, "--force").stdout


def test_the_error_of_resampling_is_that_of_the_file(folder):
    document = json.loads(run("convert", folder / "spectral.csv", folder / "x.bsdf", "--json").stdout)
    assert (document["read_as"], document["written_as"]) == ("CSV", "RGL")
    assert document["channels"][0] == "400 nm"
    assert 0 < max(document["relative_l2"]) < 0.05  # constants, but for what single precision and cosines do
    table = run("convert", folder / "spectral.csv", folder / "y.bsdf").stdout
    assert "channel  relative L2  median relative" in table
    assert "largest" in table
    assert isinstance(read_brdf(folder / "x.bsdf"), AdaptiveBRDF)


def test_spectra_become_colours_where_asked(folder):
    refused = run("convert", folder / "spectral.csv", folder / "z.binary")
    assert refused.exit_code == 2
    assert "--rgb" in refused.stderr
    assert not (folder / "z.binary").exists()
    document = json.loads(run("convert", folder / "spectral.csv", folder / "z.binary", "--json").stdout)
    assert "--rgb" in document["error"]
    assert run("convert", folder / "spectral.csv", folder / "z.csv", "--rgb").exit_code == 0
    assert read_brdf(folder / "z.csv").values.shape[1] == 3


def test_nothing_is_overwritten(folder):
    target = folder / "there.csv"
    target.write_text("precious")
    refused = run("convert", folder / "rgb.alta", target)
    assert refused.exit_code == 2
    assert "--force" in refused.stderr
    onto_itself = run("convert", folder / "rgb.alta", folder / "rgb.alta", "--force")
    assert "onto itself" in onto_itself.stderr
    assert target.read_text() == "precious"
    failed = run("convert", folder / "spectral.csv", target.with_suffix(".astm"))
    assert "MERL (.binary)" in failed.stderr
    nowhere = run("convert", folder / "rgb.alta", folder / "none" / "x.csv")
    assert "expected a folder" in nowhere.stderr


def test_show_describes_samples(folder):
    plot = folder / "spectral.png"
    result = run("show", folder / "spectral.csv", "--json", "--plot", plot)
    (document,) = json.loads(result.stdout)
    assert (document["name"], document["format"], document["origin"]) == ("paint", "CSV", ["by hand"])
    np.testing.assert_allclose(document["wavelengths_um"], np.linspace(0.4, 0.7, 5))
    np.testing.assert_allclose(document["median"], 0.1 * np.arange(1, 6))
    np.testing.assert_allclose(document["invalid_share"], [0, 0, 1 / 324, 0, 0])
    np.testing.assert_allclose(document["incidences_deg"], np.rad2deg([0.3, 0.7, 1.1]))
    share = np.array(document["covered_share"])[:, None]
    expected = np.pi * 0.1 * np.arange(1, 6) * share
    np.testing.assert_allclose(document["albedo"], expected, rtol=1e-6)
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_show_describes_what_is_known_everywhere(folder):
    write_brdf(folder / "grey.h5", Lambertian(np.float64(0.5)))
    result = run("show", folder / "grey.h5", folder / "missing.h5", "abc:nickel")
    assert result.exit_code == 1
    assert "HDF5, the model Lambertian" in result.stdout
    assert "0.500" in result.stdout
    assert "published, the model Lambertian + ABC" in result.stdout
    assert "missing.h5" in result.stderr


@pytest.mark.parametrize("kind", [MeasuredBRDF, AdaptiveBRDF])
def test_pictures_of_tables(kind):
    """The picture is drawn from values that are right: a constant reflectance has constant slices."""
    record = as_table(Lambertian(0.5)) if kind is MeasuredBRDF else as_adaptive(Lambertian(0.5))
    figure = portrait.draw(record, "grey $x$")
    for line in [*figure.axes[0].lines, *figure.axes[1].lines]:
        np.testing.assert_allclose(line.get_ydata()[:300], 0.5 / np.pi, rtol=0.03)


def test_show_refuses_nonsense(folder):
    two = run("show", folder / "rgb.alta", folder / "spectral.csv", "--plot", folder / "two.png")
    assert two.exit_code == 2
    assert "a picture shows one file" in two.stderr
    wrong = run("show", folder / "rgb.alta", "--plot", folder / "x.docx")
    assert ".png" in wrong.stderr
