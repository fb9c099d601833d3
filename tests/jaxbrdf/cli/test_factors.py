"""`jaxbrdf show --factors`: what is read off the data, the fits' errors, the picture, and what is refused."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from data_loaders import write_brdf
from jaxbrdf import MeasuredBRDF, ShiftedGammaBRDF, TrowbridgeReitz, merl_grid
from jaxbrdf.cli.main import app
from jaxbrdf.metrics import tabulate


def run(*arguments):
    return CliRunner().invoke(app, ["show", *map(str, arguments)])


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """A glossy table of one channel, shown with its factors and drawn."""
    folder = tmp_path_factory.mktemp("factors")
    model = ShiftedGammaBRDF(0.2, 0.4, 0.1, 1.0, 0.3, 0.0).as_cook_torrance(TrowbridgeReitz(0.2))
    f = np.asarray(tabulate(model, merl_grid()))[..., None]
    write_brdf(folder / "glossy.h5", MeasuredBRDF(f, np.ones(1), merl_grid()))
    result = run(folder / "glossy.h5", "--factors", "--plot", folder / "factors.png", "--json")
    return folder, result


@pytest.mark.slow
def test_what_is_read_off_is_what_made_the_table(shown):
    _, result = shown
    assert result.exit_code == 0, result.stderr
    (document,) = json.loads(result.stdout)
    factors = document["factors"]
    theta = np.radians(factors["theta_h_deg"])
    D = TrowbridgeReitz(0.2)(np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=-1))
    read, near = np.array(factors["distribution"][0]), theta < np.radians(12)  # half the peak
    np.testing.assert_allclose((read / read[0])[near], np.asarray(D / D[0])[near], rtol=0.08)
    errors = {fit["model"]: fit["normalized_l2_below_80"][0] for fit in factors["fits"]}
    assert errors["GGX"] < 0.01
    assert errors["free form"] < 0.02 < errors["Beckmann"]
    assert errors["shifted gamma"] < errors["Beckmann"]


@pytest.mark.slow
def test_the_picture_is_there(shown):
    folder, _ = shown
    assert (folder / "factors.png").read_bytes().startswith(b"\x89PNG")


def test_without_backscattering_it_says_what_is_missing(tmp_path):
    raw = np.full((*merl_grid().shape, 1), -1.0)
    raw[:, 60:] = 0.1
    write_brdf(tmp_path / "bald.h5", MeasuredBRDF(raw, np.ones(1), merl_grid()))
    result = run(tmp_path / "bald.h5", "--factors")
    assert result.exit_code == 2
    assert "expected samples with wi near wo, found none" in result.stderr
