"""`jaxbrdf check` on a fit, published numbers and what is no reflectance."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from data_loaders import save_fit
from jaxbrdf import FitResult, Lambertian
from jaxbrdf.cli.main import app


@pytest.fixture(scope="module")
def shining(tmp_path_factory):
    """A fit that reflects more than it gets, in one of three channels."""
    path = tmp_path_factory.mktemp("fits") / "shining.h5"
    result = FitResult(
        model=Lambertian(jnp.array([0.2, 0.5, 1.2])),
        status=np.zeros(3, int),
        cost=np.zeros(3),
        steps=np.ones(3, int),
        covariance=np.zeros((3, 1, 1)),
        residuals=np.zeros((3, 4)),
        parameters=("albedo",),
        recipe="slices",
        names=("shining",),
    )
    save_fit(path, result)
    return path


@pytest.fixture(scope="module")
def checked(shining, tmp_path_factory):
    """The command over a fit, a published model, a broken file and a name that nobody published."""
    folder = tmp_path_factory.mktemp("check")
    bad, plot = folder / "bad.binary", folder / "albedo.png"
    bad.write_bytes(b"no MERL file")
    names = [str(shining), "abc:nickel", str(bad), "abc:nikel"]
    return CliRunner().invoke(app, ["check", *names, "--json", "--plot", str(plot)]), plot


def test_what_was_found_is_json_and_the_rest_an_error(checked):
    result, plot = checked
    assert result.exit_code == 1
    fit, nickel, bad, unknown = json.loads(result.stdout)
    (found,) = fit["reflectances"]
    assert found["verdicts"]["energy"].startswith("creates energy: reflects 1.2 of the light")
    assert found["verdicts"]["reciprocity"] == "reciprocal"
    np.testing.assert_allclose(found["energy_excess"], [0, 0, 0.2], atol=1e-9)
    (found,) = nickel["reflectances"]
    assert found["model"] == "Lambertian + ABC"
    assert found["verdicts"]["energy"].startswith("conserves energy")
    assert found["verdicts"]["sampling"] == "samples fit the reflectance"
    assert "expected" in bad["error"]
    assert "nickel" in unknown["error"]
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_a_table_for_people(shining):
    """A finding is no error: the exit status is 0."""
    result = CliRunner().invoke(app, ["check", str(shining)])
    assert result.exit_code == 0
    assert "creates energy" in result.stdout
    assert "albedo at 89°" in result.stdout


@pytest.mark.parametrize("plot", ["albedo.txt", "shining.h5"])
def test_a_picture_that_cannot_be(shining, plot):
    result = CliRunner().invoke(app, ["check", str(shining), "--plot", str(shining.with_name(plot))])
    assert result.exit_code == 2
    assert "--plot" in result.output
