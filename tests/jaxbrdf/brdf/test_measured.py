"""Measured tables: validity, interpolation against scipy, slices against loops, symmetries of φ_d."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import RegularGridInterpolator
from scipy.stats import chi2

import jaxbrdf as jb
from jaxbrdf.arrays import per_channel


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


# Sampling

VIEWS = jb.spherical(np.array([0.3, 1.2]), np.array([0.5, -2.0]))
U = np.random.default_rng(8).uniform(size=(20_000, 2))


@eqx.filter_jit
def sampled(brdf, u, wo):
    """Of one wo: wi, pdf and f cos θ_i / pdf, with missing cells dark as for the albedo."""
    wi = brdf.sample(u, wo[None])
    f, pdf = jnp.nan_to_num(brdf(wi, wo[None])), brdf.pdf(wi, wo[None])
    lit = (pdf > 0)[:, None]
    return wi, pdf, jnp.where(lit, f * wi[:, 2:] / jnp.where(lit, pdf[:, None], 1), 0)


@eqx.filter_jit
@per_channel
def weight_in_a_sum(brdf, wo):
    return brdf._weight(wo)


@eqx.filter_jit
def density(brdf, wi, wo):
    return brdf.pdf(wi, wo)


def hemisphere(n_cos, n_phi):
    """Directions even in cos θ and φ: (n_cos, n_phi, 3)."""
    cos, phi = (np.arange(n_cos) + 0.5) / n_cos, (np.arange(n_phi) + 0.5) / n_phi * 2 * np.pi
    return np.asarray(jb.spherical(np.arccos(cos)[:, None], phi[None, :]))


def lobes():
    """A table with two peaks over θ_h, one in each channel, on a diffuse ground, and a hole."""
    h = np.broadcast_to(GRID.theta_h[:, None, None], SHAPE)
    raw = np.stack(
        [0.3 + 20 * np.exp(-((h / 0.3) ** 2)), 0.1 + 5 * np.exp(-(((h - 0.6) / 0.2) ** 2))], axis=-1
    )
    raw[3, 4] = -1
    return jb.MeasuredBRDF(raw, np.array([0.5, 1.0]), GRID)


@pytest.mark.parametrize("k", range(len(VIEWS)))
def test_samples_follow_their_density(k):
    """χ² over blocks of the hemisphere and what falls below it; the density is the two channels' mean."""
    brdf, wo = lobes(), VIEWS[k]
    wi, pdf, _ = (np.asarray(a) for a in sampled(brdf, U, wo))
    assert wi.shape == (len(U), 3)
    assert pdf.shape == (len(U),)
    assert_allclose(np.linalg.norm(wi, axis=-1), 1, atol=1e-12)
    grid = hemisphere(480, 720)
    inside = np.asarray(density(brdf, grid.reshape(-1, 3), wo[None])).reshape(8, 60, 12, 60).sum(axis=(1, 3))
    share = np.append(inside * (2 * np.pi / grid[..., 0].size), 0)
    assert share.sum() < 1 + 1e-3
    share[-1] = max(1 - share.sum(), 0)
    row = np.where(wi[:, 2] > 0, (wi[:, 2] * 8).astype(int).clip(0, 7), 8)
    column = (np.arctan2(wi[:, 1], wi[:, 0]) / (2 * np.pi) % 1 * 12).astype(int) % 12
    counts = np.bincount(np.where(row < 8, row * 12 + column, 96), minlength=97)
    expected = len(U) * share
    used = expected > 10
    assert used.sum() > 50
    assert chi2.sf(np.sum((counts - expected)[used] ** 2 / expected[used]), used.sum() - 1) > 1e-3


def brute_albedo(wo):
    """Of both channels of `lobes`, by a sum over the hemisphere."""
    grid = hemisphere(300, 400).reshape(-1, 3)
    f = np.nan_to_num(evaluate(lobes(), grid, wo[None]))
    return np.sum(f * grid[:, 2:], axis=0) * 2 * np.pi / len(grid)


def test_the_mean_over_samples_is_the_albedo_of_each_channel():
    for wo in VIEWS:
        _, _, weight = (np.asarray(a) for a in sampled(lobes(), U, wo))
        error = 4.5 * weight.std(axis=0) / np.sqrt(len(U))
        albedo = brute_albedo(wo)
        assert np.all(np.abs(weight.mean(axis=0) - albedo) < error + 2e-3 * albedo)


def test_a_diffuse_table_is_sampled_like_a_diffuse_surface():
    brdf = jb.MeasuredBRDF(np.full((*SHAPE, 1), 0.25), np.ones(1), GRID)
    wi, pdf, weight = (np.asarray(a) for a in sampled(brdf, U[:1000], VIEWS[0]))
    assert_allclose(pdf, wi[:, 2] / np.pi, rtol=1e-9)
    known = weight[:, 0] > 0  # the border of the coarse table lacks cells
    assert known.mean() > 0.9
    assert_allclose(weight[known], 0.25 * np.pi, rtol=1e-9)


def test_a_table_without_any_valid_cell_is_sampled_like_a_diffuse_surface():
    brdf = jb.MeasuredBRDF(np.full((*SHAPE, 1), -1.0), np.ones(1), GRID)
    wi, pdf, _ = (np.asarray(a) for a in sampled(brdf, U[:1000], VIEWS[0]))
    assert_allclose(pdf, wi[:, 2] / np.pi, rtol=1e-9)
    assert_array_equal(weight_in_a_sum(brdf, VIEWS), np.zeros((2, 1)))


def test_wherever_light_comes_from_it_can_be_drawn():
    """At least a tenth of the diffuse density, whatever the table; nothing at and below the horizon."""
    grid = np.concatenate([hemisphere(40, 60).reshape(-1, 3), [[1.0, 0, 0], [0.6, 0, -0.8]]])
    pdf = np.asarray(density(lobes(), grid, VIEWS[1][None]))
    assert np.all(pdf[:-2] >= 0.1 * grid[:-2, 2] / np.pi * (1 - 1e-12))
    assert_array_equal(pdf[-2:], 0)


def test_single_precision_stays_single_when_sampling():
    brdf = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), lobes())
    wi, pdf, weight = sampled(brdf, U[:500].astype(np.float32), VIEWS[0].astype(np.float32))
    double = sampled(lobes(), U[:500].astype(np.float32).astype(float), VIEWS[0])
    assert {a.dtype for a in (wi, pdf, weight)} == {jnp.dtype(jnp.float32)}
    near = (
        np.linalg.norm(np.asarray(wi) - np.asarray(double[0]), axis=-1) < 1e-4
    )  # the rest chose another way
    assert near.mean() > 0.99
    assert_allclose(np.asarray(pdf)[near], np.asarray(double[1])[near], rtol=0.05)


def test_its_weight_in_a_sum_is_about_its_albedo():
    weight = weight_in_a_sum(lobes(), VIEWS)
    assert weight.shape == (2, 2)
    assert_allclose(weight[0], brute_albedo(VIEWS[0]), rtol=0.5)


def test_merl_materials_are_sampled_well(merl_material):
    """A mirror with hundreds of times less variance than by cosine, a felt with about the same."""
    for name, most in [("chrome", 1e-2), ("pink-felt", 1.5)]:
        measured = merl_material(name)
        one = jb.MeasuredBRDF(measured.raw[..., :1], measured.scale[:1], measured.grid)
        for wo in VIEWS:
            _, _, weight = (np.asarray(a)[..., 0] for a in sampled(one, U, wo))
            albedo = float(jb.albedo(one, wo)[0])
            assert abs(weight.mean() - albedo) < 4.5 * weight.std() / np.sqrt(len(U)) + 5e-3 * albedo
            assert weight.var() < most * cosine_weights(one, wo).var()


def cosine_weights(brdf, wo):
    """π f of directions of density cos θ / π."""
    r, phi = np.sqrt(U[:, 0]), 2 * np.pi * U[:, 1]
    wi = np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - U[:, 0])], axis=-1)
    return np.pi * np.nan_to_num(evaluate(brdf, wi, wo[None]))[:, 0]
