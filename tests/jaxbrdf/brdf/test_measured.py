"""Measured tables: validity, interpolation against scipy, slices against loops, symmetries of φ_d."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import RegularGridInterpolator

import jaxbrdf as jb


@eqx.filter_jit
def evaluate(brdf, wi, wo):
    return brdf(wi, wo)


SHAPE, CHANNELS = (9, 10, 8), 3
SCALE = np.array([1.0, 1.15, 1.66]) / 1500


def axis(n, upper, power=1):
    edges = upper * (np.arange(n + 1) / n) ** power
    return upper * ((np.arange(n) + 0.5) / n) ** power, edges


def small_grid():
    (h, h_edges), (d, d_edges), (phi, phi_edges) = axis(9, np.pi / 2, 2), axis(10, np.pi / 2), axis(8, np.pi)
    return jb.HalfDifferenceGrid(h, d, phi, h_edges, d_edges, phi_edges)


GRID = small_grid()
RAW = np.random.default_rng(3).uniform(1, 100, (*SHAPE, CHANNELS))


@pytest.fixture(scope="module")
def measured():
    """Random values in every cell, those below the horizon included, and one negative sample in green."""
    raw = RAW.copy()
    raw[4, 3, 2, 1] = -1
    return jb.MeasuredBRDF(raw, SCALE, GRID, "noise")


def above_horizon():
    """Whether both directions at a cell's centre are above the horizon, from cos θ_h cos θ_d ± …"""
    h, d, phi = np.meshgrid(GRID.theta_h, GRID.theta_d, GRID.phi_d, indexing="ij")
    return np.cos(h) * np.cos(d) > np.abs(np.sin(h) * np.sin(d) * np.cos(phi))


def test_values_are_scaled_and_nan_where_invalid(measured):
    values, above = measured.values, above_horizon()
    assert 0 < above.sum() < above.size
    assert_array_equal(np.isnan(values[..., 0]), ~above)
    assert np.isnan(values[4, 3, 2, 1])
    assert not np.isnan(values[4, 3, 2, 0])
    above[4, 3, 2] = False
    assert_allclose(values[above], RAW[above] * SCALE)


def test_at_the_centres_it_is_the_table(measured):
    wi, wo = GRID.directions()
    f, above = evaluate(measured, wi, wo), above_horizon()
    above[4, 3, 2] = False
    assert f.shape == (*SHAPE, CHANNELS)
    assert_allclose(np.asarray(f)[above], (RAW * SCALE)[above], rtol=1e-6)


def inside(n):
    """Angles whose neighbouring cells are all above the horizon, φ_d over the whole circle."""
    rng = np.random.default_rng(4)
    return rng.uniform(0.02, 0.5, n), rng.uniform(0.1, 0.6, n), rng.uniform(-np.pi, np.pi, n)


def test_between_the_centres_it_is_trilinear(measured):
    """scipy's interpolator over the table padded by half a turn of φ_d on both sides."""
    padded = np.concatenate([RAW[:, :, -1:], RAW, RAW[:, :, :1]], axis=2) * SCALE
    phi = np.concatenate([GRID.phi_d[-1:] - np.pi, GRID.phi_d, GRID.phi_d[:1] + np.pi])
    truth = RegularGridInterpolator((GRID.theta_h, GRID.theta_d, phi), padded)
    theta_h, theta_d, phi_d = inside(60)
    wi, wo = jb.from_half_difference(theta_h, np.full(60, 0.7), theta_d, phi_d)
    expected = truth(np.stack([np.clip(theta_h, GRID.theta_h[0], None), theta_d, phi_d % np.pi], axis=-1))
    assert_allclose(evaluate(measured, wi, wo)[:, 0], expected[:, 0], rtol=1e-9)
    assert_allclose(evaluate(measured, wi, wo)[:, 2], expected[:, 2], rtol=1e-9)


def test_it_is_reciprocal_and_isotropic(measured):
    theta_h, theta_d, phi_d = inside(30)
    wi, wo = jb.from_half_difference(theta_h, np.zeros(30), theta_d, phi_d)
    assert_allclose(evaluate(measured, wo, wi), evaluate(measured, wi, wo), rtol=1e-9)
    turned = jb.from_half_difference(theta_h, np.full(30, 2.0), theta_d, phi_d)
    assert_allclose(evaluate(measured, *turned), evaluate(measured, wi, wo), rtol=1e-9)


def test_an_invalid_neighbour_is_left_out_and_the_others_share_its_weight():
    raw = np.full((*SHAPE, 1), 5.0)
    raw[3, 3, 3] = -1
    brdf = jb.MeasuredBRDF(raw, np.ones(1), GRID)
    step = [np.array([a[3], (a[3] + a[4]) / 2]) for a in (GRID.theta_h, GRID.theta_d, GRID.phi_d)]
    wi, wo = jb.from_half_difference(step[0], np.zeros(2), step[1], step[2])
    assert_allclose(evaluate(brdf, wi, wo)[1], [5.0], rtol=1e-12)


def test_where_no_neighbour_is_valid_it_is_nan():
    raw = np.full((*SHAPE, 2), -1.0)
    raw[..., 1] = 2.0
    theta_h, theta_d, phi_d = inside(5)
    f = evaluate(
        jb.MeasuredBRDF(raw, np.ones(2), GRID), *jb.from_half_difference(theta_h, np.zeros(5), theta_d, phi_d)
    )
    assert np.all(np.isnan(f[:, 0]))
    assert_allclose(f[:, 1], 2)


def test_cells_below_the_horizon_are_never_used():
    """Whatever a file holds there: the border of the horizon takes its value from above it alone."""
    raw = np.where(above_horizon()[..., None], 3.0, 1e6)
    wi, wo = (w.reshape(-1, 3) for w in jb.merl_grid().directions())
    wi, wo = wi[::1009], wo[::1009]
    f = np.asarray(evaluate(jb.MeasuredBRDF(raw, np.ones(1), GRID), wi, wo))[:, 0]
    above = np.asarray((wi[:, 2] > 0) & (wo[:, 2] > 0))
    assert_array_equal(f[~above], 0)
    valid = ~np.isnan(f[above])
    assert valid.mean() > 0.8
    assert_allclose(f[above][valid], 3.0, rtol=1e-12)


def test_at_the_normal_and_at_grazing_the_border_cells_are_used(measured):
    n = jnp.array([[0.0, 0.0, 1.0]])
    assert np.all(np.isfinite(evaluate(measured, n, n)))
    grazing = jb.spherical(jnp.array([np.pi / 2 - 1e-6]), 0.0)
    mirrored = grazing * jnp.array([[-1.0, 1.0, 1.0]])
    assert np.all(np.isfinite(evaluate(measured, grazing, mirrored)))


def test_gradients_by_the_directions_are_finite(measured):
    w = jb.spherical(jnp.array([0.0, 0.4, 1.2]), 0.3)
    gradient = jax.jit(jax.jacrev(lambda w: jnp.nansum(measured(w, w[::-1]))))(w)
    assert np.all(np.isfinite(gradient))


def test_slices_are_means_over_the_valid_phi(measured):
    slices, above = measured.slices(), above_horizon()

    def mean(raw, above):
        usable = raw[above & (raw >= 0)]
        return usable.mean() if usable.size else np.nan

    for c in range(CHANNELS):
        m_h = [mean(measured.raw[i, 0, :, c], above[i, 0]) * SCALE[c] for i in range(SHAPE[0])]
        m_d = [mean(measured.raw[0, j, :, c], above[0, j]) * SCALE[c] for j in range(SHAPE[1])]
        assert_allclose(slices.m_h[:, c], m_h, rtol=1e-12)
        assert_allclose(slices.m_d[:, c], m_d, rtol=1e-12)
    assert_array_equal(slices.theta_h, GRID.theta_h)
    assert_array_equal(slices.theta_d, GRID.theta_d)
    assert slices.theta_h_mirror == GRID.theta_h[0]


def test_a_slice_without_valid_samples_is_nan():
    raw = RAW.copy()
    raw[2, 0, :, 1] = -1
    m_h = jb.MeasuredBRDF(raw, SCALE, GRID).slices().m_h
    assert np.isnan(m_h[2, 1])
    assert np.isfinite(m_h[2, [0, 2]]).all()


def test_reconstructed_merl_material(merl_material):
    """As a reader gives it: RGB on the MERL grid, its centres reproduced, and brightest around the mirror."""
    measured = merl_material("gold-metallic-paint")
    assert measured.raw.shape == (90, 90, 180, 3)
    i, j, k = np.array([0, 10, 40]), np.array([5, 20, 40]), np.array([10, 100, 60])
    grid = measured.grid
    wi, wo = jb.from_half_difference(grid.theta_h[i], np.zeros(3), grid.theta_d[j], grid.phi_d[k])
    assert_allclose(evaluate(measured, wi, wo), measured.raw[i, j, k] * measured.scale, rtol=1e-6)
    slices = measured.slices()
    assert np.all(slices.m_h[0] > 5 * slices.m_h[45])
