"""Nodes and weights against closed forms, and the MERL grid against its definition."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxbrdf as jb
from tests import references


@pytest.mark.parametrize(
    ("function", "integral"),
    [
        (lambda w: np.ones(len(w)), 2 * np.pi),
        (lambda w: w[:, 2], np.pi),
        (lambda w: w[:, 0] ** 2, 2 * np.pi / 3),
        (lambda w: w[:, 0] * w[:, 1], 0),
        (lambda w: w[:, 2] ** 15, 2 * np.pi / 16),
        (lambda w: w[:, 0] ** 2 * w[:, 1] ** 2 * w[:, 2], np.pi / 24),
    ],
    ids=["1", "z", "x^2", "xy", "z^15", "x^2 y^2 z"],
)
def test_hemisphere_is_exact_for_polynomials(function, integral):
    w, weight = jb.hemisphere(8, 12)
    assert w.shape == (96, 3)
    assert_allclose(np.sum(function(np.asarray(w)) * weight), integral, rtol=1e-13, atol=1e-14)


def test_hemisphere_weights_sum_to_its_solid_angle():
    assert_allclose(np.sum(jb.hemisphere(3, 5)[1]), 2 * np.pi, rtol=1e-14)


def test_merl_bins():
    grid = jb.merl_grid()
    assert grid.shape == (90, 90, 180)
    assert_allclose(np.rad2deg(grid.theta_h_edges[[0, 1, 45, 90]]), [0, 1 / 90, 22.5, 90])
    assert_allclose(np.rad2deg(grid.theta_h[[0, 89]]), [0.25 / 90, 89.5**2 / 90])
    assert_allclose(np.rad2deg(grid.theta_d[[0, 89]]), [0.5, 89.5])
    assert_allclose(np.rad2deg(grid.phi_d[[0, 179]]), [0.5, 179.5])
    assert np.all((grid.theta_h > grid.theta_h_edges[:-1]) & (grid.theta_h < grid.theta_h_edges[1:]))


@pytest.fixture(scope="module")
def centres():
    return [np.asarray(w) for w in jb.merl_grid().directions()]


def test_grid_directions_have_the_angles_of_their_cells(centres):
    wi, wo = centres
    grid = jb.merl_grid()
    for i, j, k in [(0, 0, 0), (20, 45, 90), (70, 10, 170), (89, 89, 1)]:
        angles = references.half_difference(wi[i, j, k], wo[i, j, k])
        assert_allclose(angles, [grid.theta_h[i], 0, grid.theta_d[j], grid.phi_d[k]], atol=1e-9)


def test_grid_cosines_are_those_of_its_directions(centres):
    wi, wo = centres
    assert_allclose(np.stack(jb.merl_grid().cosines()), [wi[..., 2], wo[..., 2]], atol=1e-14)


def test_measure_of_all_pairs_on_the_sphere_over_upper_half_vectors():
    """With θ_h, θ_d in [0, π/2] and both halves of φ_d the cells hold half of all pairs: (4π)² / 2."""
    assert_allclose(np.sum(jb.merl_grid().measure()), (4 * np.pi) ** 2 / 2, rtol=1e-13)


def uniform_grid(n):
    def axis(upper):
        edges = np.linspace(0, upper, n + 1)
        return (edges[1:] + edges[:-1]) / 2, edges

    (h, h_edges), (d, d_edges), (phi, phi_edges) = axis(np.pi / 2), axis(np.pi / 2), axis(np.pi)
    return jb.HalfDifferenceGrid(h, d, phi, h_edges, d_edges, phi_edges)


@pytest.mark.parametrize(
    ("grid", "error"), [(jb.merl_grid, 2e-4), (lambda: uniform_grid(40), 2e-3)], ids=["merl", "40^3"]
)
def test_measure_of_pairs_above_the_horizon(grid, error):
    """The sum over pairs above the horizon is (2π)², up to the cells that the horizon cuts."""
    grid = grid()
    cos_i, cos_o = grid.cosines()
    above = (cos_i > 0) & (cos_o > 0)
    assert_allclose(jnp.sum(jnp.where(above, grid.measure(), 0)), (2 * np.pi) ** 2, rtol=error)


def test_measure_integrates_a_product_of_cosines():
    """∫∫ cos θ_i cos θ_o dω_i dω_o = π² over pairs above the horizon: values at the centres of 1° cells."""
    grid = jb.merl_grid()
    cos_i, cos_o = (jnp.maximum(c, 0) for c in grid.cosines())
    both = (cos_i > 0) & (cos_o > 0)
    assert_allclose(jnp.sum(jnp.where(both, cos_i * cos_o * grid.measure(), 0)), np.pi**2, rtol=2e-4)
