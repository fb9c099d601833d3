"""The stand-ins of the demo against the formula they are made from, and the demo from end to end."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from data_loaders import load_fit, read_merl
from jaxbrdf import from_half_difference, merl_grid
from jaxbrdf.cli import demo
from jaxbrdf.cli.main import app


@pytest.fixture(scope="module")
def nickel():
    return demo.stand_in("nickel")


def test_cells_below_the_horizon_are_marked_as_in_real_files(nickel):
    wi, wo = (np.asarray(w) for w in merl_grid().directions())
    below = (wi[..., 2] <= 0) | (wo[..., 2] <= 0)
    assert (nickel.raw[below] == -1).all()
    assert (nickel.raw[~below] > 0).all()


def test_one_cell_by_hand(nickel):
    """Written out with the vectors of the pair, Fresnel's equations in angles."""
    h, d, p = 20, 35, 50
    grid = merl_grid()
    wi, wo = (
        np.asarray(w) for w in from_half_difference(grid.theta_h[h], 0.0, grid.theta_d[d], grid.phi_d[p])
    )
    m = (wi + wo) / np.linalg.norm(wi + wo)
    t = np.arccos(wi @ m)
    u = np.arcsin(np.sin(t) / 5.441883)
    F = ((np.sin(t - u) / np.sin(t + u)) ** 2 + (np.tan(t - u) / np.tan(t + u)) ** 2) / 2
    G = min(1, 2 * m[2] * wi[2] / (wi @ m), 2 * m[2] * wo[2] / (wi @ m))
    S = 32.745403 / (1 + 705.733887 * (1 - m[2])) ** 1.945258
    f = 0.006663 / np.pi + F * G * S / (np.pi * wi[2] * wo[2])
    np.testing.assert_allclose(nickel.raw[h, d, p, 1] * nickel.scale[1], f, rtol=1e-10)


def test_stand_ins_are_near_the_materials_they_stand_for(merl_material):
    """With another factor than 1/π the stand-in would be off by 0.7 in log or more."""
    measured, made = merl_material("blue-rubber").values, demo.stand_in("blue-rubber").values
    near = np.s_[::4, :60:4, ::10]
    assert np.nanmedian(np.abs(np.log(made[near] / measured[near]))) < 0.1


def test_demo_from_end_to_end(tmp_path, monkeypatch):
    monkeypatch.setattr(demo, "MATERIALS", ("red-plastic",))
    result = CliRunner().invoke(app, ["demo", "--out", str(tmp_path / "demo")])
    assert result.exit_code == 0, result.output
    assert "not a measurement" in result.stderr
    assert "jaxbrdf fit " in result.stderr
    assert "abc-red-plastic" in result.stdout
    written = sorted(path.name for path in (tmp_path / "demo").iterdir())
    assert written == [f"abc-red-plastic.{suffix}" for suffix in ("h5", "json", "png")]
    document = json.loads((tmp_path / "demo" / "abc-red-plastic.json").read_text())
    assert document["source"] == demo.NOTE
    assert max(document["log_error_below_80"]) < 0.05
    assert load_fit(tmp_path / "demo" / "abc-red-plastic.h5").names == ("abc-red-plastic",)


def test_a_stand_in_survives_its_file(tmp_path, nickel):
    again = read_merl(demo.write_stand_in("nickel", tmp_path))
    assert again.name == "abc-nickel"
    np.testing.assert_allclose(again.values, nickel.values, rtol=1e-12)
    assert (again.raw[np.isnan(nickel.values)] == -1).all()  # as in real files
