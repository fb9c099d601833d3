"""Pictures of a measurement on a coarse grid: what is drawn where, and odd cases."""

import io

import numpy as np
import pytest

from jaxbrdf import HalfDifferenceGrid, Lambertian, MeasuredBRDF
from jaxbrdf.cli import pictures


def measured(values):
    """Every cell of a small table holds `values` (C,), in 1/sr."""
    edges = [np.linspace(0, top, n + 1) for top, n in ((np.pi / 2, 20), (np.pi / 2, 18), (np.pi, 12))]
    grid = HalfDifferenceGrid(*((e[1:] + e[:-1]) / 2 for e in edges), *edges)
    values = np.asarray(values, float)
    raw = np.broadcast_to(values, (*grid.shape, len(values)))
    return MeasuredBRDF(raw, np.ones(len(values)), grid, "flat")


def axes_of(figure):
    return [axes for part in figure.subfigs for axes in part.axes]


def test_two_slices_and_four_lobes():
    figure = pictures.material(measured([0.1, 0.2, 0.3]), Lambertian(0.5), "flat", [0.1, 0.2, 0.3], "a note")
    theta_h, theta_d, *lobes = axes_of(figure)
    assert "theta_h" in theta_h.get_xlabel()
    assert "theta_d" in theta_d.get_xlabel()
    assert [lobe.get_title().partition("°")[0] for lobe in lobes] == [
        rf"$\theta_i = {incidence}" for incidence in (10, 30, 50, 70)
    ]
    assert figure.get_suptitle().split() == ["flat", "normalized", "L2:", "R", "0.1", "G", "0.2", "B", "0.3"]
    assert figure.get_supxlabel() == "a note"


def test_points_are_the_measurement_and_lines_the_fit():
    figure = pictures.material(measured([0.25]), Lambertian([0.5]), "flat", [0.1])
    for axes in axes_of(figure)[:2]:
        points, line = axes.get_lines()[:2]
        np.testing.assert_allclose(points.get_ydata(), 0.25)
        np.testing.assert_allclose(line.get_ydata(), 0.5 / np.pi)


def test_a_lobe_is_a_cube_root():
    figure = pictures.material(measured([0.125]), Lambertian(0.5), "flat", [0.1])
    points, line = axes_of(figure)[2].get_lines()[:2]
    np.testing.assert_allclose(np.hypot(*points.get_data()), 0.5)
    np.testing.assert_allclose(np.hypot(*line.get_data()), np.cbrt(0.5 / np.pi))


@pytest.mark.parametrize("albedo", [np.nan, np.inf, -0.5])
@pytest.mark.parametrize("value", [0.0, -1.0, 0.1])
def test_failed_fits_and_empty_tables_are_drawn_too(albedo, value):
    name = "from $5 to $6 \udcff"
    figure = pictures.material(measured([value]), Lambertian(albedo), name, [np.nan])
    figure.savefig(io.BytesIO(), format="png")
