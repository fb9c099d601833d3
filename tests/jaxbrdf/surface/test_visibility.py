"""Traced visibility and the virtual goniometer: rays one by one, grooves, Gaussian surfaces."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbrdf import (
    Beckmann,
    Constant,
    HeightCorrelated,
    Heightfield,
    Microfacet,
    Schlick,
    gaussian_surface,
    hemisphere,
    smith_G1,
    spherical,
    virtual_goniometer,
    visibility,
    visible_facets,
)
from jaxbrdf.directions import safe_normalize

ALPHA = 0.5


@pytest.fixture(scope="module")
def gaussian():
    """A surface whose normals are those of Beckmann(ALPHA, ALPHA)."""
    return gaussian_surface(jax.random.key(7), (512, 512), 1.0, rms=ALPHA * 8 / 2, correlation=8.0)


def clearance(z, known, dx, dy, w):
    """How far above the map the ray of each facet passes where it comes nearest, in µm; infinity if nowhere.

    Each ray is followed to where it crosses the lines of the grid that it crosses most steeply.
    """
    if abs(w[1]) / dy > abs(w[0]) / dx:
        return clearance(z.T, known.T, dy, dx, w[[1, 0, 2]]).T
    ny, nx = z.shape
    standing = np.where(known, z, -1e9)
    gap = np.full((ny - 1, nx - 1), np.inf)
    for i, j in np.ndindex(*gap.shape):
        column = np.arange(j + 1, nx) if w[0] > 0 else np.arange(j, -1, -1)
        t = (column - j - 0.5) * dx / w[0]
        row = i + 0.5 + t * w[1] / dy
        column, t, row = (a[(row >= 0) & (row < ny - 1)] for a in (column, t, row))
        below = np.floor(row).astype(int)
        ground = (1 - row + below) * standing[below, column] + (row - below) * standing[below + 1, column]
        ray = z[i : i + 2, j : j + 2].mean() + t * w[2]
        gap[i, j] = np.min(ray - ground, initial=np.inf)
    return gap


def slopes(z, dx, dy):
    x, y = np.diff(z, axis=1) / dx, np.diff(z, axis=0) / dy
    return (x[1:] + x[:-1]) / 2, (y[:, 1:] + y[:, :-1]) / 2


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rays_one_by_one(dtype):
    """In all octants, along axes and a diagonal: the same but for rays that graze the surface or a border."""
    z = np.asarray(gaussian_surface(jax.random.key(1), (40, 56), (1.0, 0.6), rms=1.0, correlation=6.0).z)
    known, more, less = np.ones((3, *z.shape), bool)
    for mask, grow in ((known, 0), (more, -1), (less, 1)):
        mask[10 - grow : 14 + grow, 20 - grow : 30 + grow] = False
    less[[0, 1, -2, -1]] = less[:, [0, 1, -2, -1]] = False
    heightfield = Heightfield(np.where(known, z, 1e6).astype(dtype), 1.0, 0.6, known)
    whole = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
    inner = np.pad(whole[1:-1, 1:-1], 1)  # beside a border a line of rays starts outside
    p, q = slopes(z, 1.0, 0.6)
    wrong = hidden = 0
    for phi in np.radians([0, 20, 59.0362434679265, 80, 130, 180, 190, 255, 270, 320]):  # one is the diagonal
        w = np.asarray(spherical(1.3, phi))
        seen = np.asarray(visible_facets(heightfield, w.astype(dtype)))
        high, low = (clearance(z, mask, 1.0, 0.6, w) for mask in (less, more))
        facing = w[2] - w[0] * p - w[1] * q
        sure = ((high < -0.04) | (low > 0.04)) & (np.abs(facing) > 1e-5) & inner
        wrong += np.sum(seen[sure] != ((low > 0) & (facing > 0))[sure])
        assert np.mean(sure[inner]) > 0.75
        assert not seen[~whole].any()
        hidden += np.sum(facing[sure & (low < 0)] > 0)
    assert wrong < 10 < 500 < hidden


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_grooves_in_closed_form(turn):
    """Slopes ±s across: σ = (cos θ + s sin θ cos φ) / 2 once the far sides face away, and G1 = cos θ / σ.

    Of each side's 40 facets whole ones are seen; whole periods are counted.
    """
    s, period = 0.8, 80
    profile = s * np.abs((np.arange(8 * period + 1) + 7) % period - period / 2)
    heightfield = Heightfield(np.rot90(np.broadcast_to(profile, (501, profile.size)), -turn), 1, 1)
    for theta, phi in np.radians([(0, 0), (40, 0), (60, 30), (75, 15), (85, 0), (85, -40)]):
        w = spherical(theta, phi + turn * np.pi / 2)
        along = s * np.tan(theta) * np.cos(phi)
        truth = 2 / (1 + along) if along > 1 else 1
        traced = visibility(heightfield, w, margin=3 * period / np.cos(phi))
        np.testing.assert_allclose(traced, truth, atol=0.5 / 40)


def test_a_tilted_plane_hides_nothing():
    z = 0.3 * np.arange(30)[None, :] - 0.2 * np.arange(20)[:, None]
    w = np.asarray(spherical(np.radians([0, 50, 88]), np.radians([0, 200, 120])))
    np.testing.assert_array_equal(visibility(Heightfield(z, 1, 2), w), 1)


def test_of_a_gaussian_surface_smith_is_right(gaussian):
    theta, phi = np.meshgrid(np.radians([0, 30, 60, 75, 83]), np.radians([10, 100, 200, 300]))
    w = spherical(theta, phi)
    traced = np.asarray(visibility(gaussian, w))
    np.testing.assert_allclose(traced, smith_G1(Beckmann(ALPHA, ALPHA), w), atol=0.02)
    assert traced.min() < 0.6


def test_what_escapes_over_the_border_is_left_out(gaussian):
    """Narrow maps see too much of themselves, unless what lies near the border ahead is not counted."""
    strips = jnp.moveaxis(gaussian.z.reshape(512, 8, 64), 1, 0)
    w = spherical(np.radians(83), 0.0)

    @partial(jax.jit, static_argnums=0)
    def mean(margin):
        return jnp.mean(jax.vmap(lambda z: visibility(Heightfield(z, 1, 1), w, margin))(strips))

    truth = visibility(gaussian, w)
    assert mean(0.0) > truth + 0.06
    assert abs(mean(None) - truth) < 0.015
    assert np.isnan(visibility(gaussian, w, margin=512.0))


def test_missing_points_hide_nothing_and_count_nothing():
    z, known = np.zeros((12, 40)), np.ones((12, 40), bool)
    z[:, 30], known[:, 30] = 50, False
    w = np.asarray(spherical(1.4, 0.1))
    seen = np.asarray(visible_facets(Heightfield(z, 1, 1, known), w))
    np.testing.assert_array_equal(seen.all(axis=0), (np.arange(39) < 29) | (np.arange(39) > 30))
    np.testing.assert_array_equal(seen.any(axis=0), seen.all(axis=0))
    assert not np.asarray(visible_facets(Heightfield(z, 1, 1), w))[2:9, 5:29].any()


def test_horizon_and_batches(gaussian):
    """Nothing is seen from below; maps are vmapped, jit or not."""
    below = np.asarray(spherical(np.radians([91.0, 120.0]), 0.0))
    np.testing.assert_array_equal(visibility(gaussian, below), 0)
    w = np.asarray(spherical(np.radians([70.0, 80.0]), 0.4))
    maps = jnp.stack([gaussian.z[:90, :80], gaussian.z[100:190, 100:180]])
    together = jax.jit(jax.vmap(lambda z: visibility(Heightfield(z, 1, 1), w)))(maps)
    apart = [visibility(Heightfield(z, 1, 1), w) for z in maps]
    np.testing.assert_allclose(together, apart, rtol=1e-12)


def test_the_goniometer_measures_what_microfacets_predict(gaussian):
    """Mean over eight azimuths; what is left is the noise of one surface."""
    pairs = [(0.3, 0.3, np.pi), (0.6, 0.6, np.pi), (1.1, 1.1, np.pi), (1.0, 0.2, 2.0), (0.9, 0.4, 0.5)]
    theta_i, theta_o, apart = np.array(pairs)[:, :, None].transpose(1, 0, 2)
    azimuth = np.arange(8) * np.pi / 4
    wi = np.asarray(spherical(theta_i, azimuth[None, :]))
    wo = np.asarray(spherical(theta_o, azimuth[None, :] + apart))
    measured = np.mean(virtual_goniometer(gaussian, wi, wo), axis=1)
    model = Microfacet(Beckmann(ALPHA, ALPHA), Constant(1.0), HeightCorrelated())
    np.testing.assert_allclose(measured, np.mean(model(wi, wo), axis=1), rtol=0.07)
    np.testing.assert_allclose(virtual_goniometer(gaussian, wo, wi).mean(axis=1), measured, rtol=1e-12)


def test_the_goniometer_counts_lit_and_seen_facets(gaussian):
    z = np.asarray(gaussian.z[:70, :60])
    heightfield = Heightfield(z, 1, 1)
    wi, wo, width = np.asarray(spherical(1.3, 2.0)), np.asarray(spherical(1.2, 4.5)), 0.3
    h = (wi + wo) / np.linalg.norm(wi + wo)
    p, q = slopes(z, 1, 1)
    m = np.asarray(safe_normalize(jnp.stack([-p, -q, np.ones_like(p)], axis=-1)))
    both = np.asarray(visible_facets(heightfield, wi)) & np.asarray(visible_facets(heightfield, wo))
    counted = both & (m @ h > np.cos(width))
    D = np.sum(counted / m[..., 2]) / counted.size / (2 * np.pi * (1 - np.cos(width)))
    f = virtual_goniometer(heightfield, wi, wo, width=width, margin=0.0)
    np.testing.assert_allclose(f, D / (4 * wi[2] * wo[2]), rtol=1e-12)
    assert 20 < counted.sum() < np.sum(m @ h > np.cos(width))
    fresnel = Schlick(jnp.array([0.2, 0.5, 0.9]))
    coloured = virtual_goniometer(heightfield, wi, wo, fresnel, width, 0.0)
    np.testing.assert_allclose(coloured, f * fresnel(wi @ h), rtol=1e-12)


def test_a_flat_mirror_reflects_within_the_width():
    """And all of it: ∫ f cos θ_o dω_o = 1."""
    flat, width = Heightfield(np.zeros((20, 20)), 1, 1), 0.05
    wi = np.asarray(spherical(0.5, np.pi))
    offset = np.array([0.0, 0.099, 0.101, 3.0])
    f = virtual_goniometer(flat, wi, np.asarray(spherical(0.5 + offset[:3], 0.0)), width=width)
    solid_angle = 2 * np.pi * (1 - np.cos(width))
    truth = 1 / (4 * np.cos(0.5) * np.cos(0.5 + offset[:2]) * solid_angle)
    np.testing.assert_allclose(f, [*truth, 0], rtol=1e-12)
    assert virtual_goniometer(flat, wi, np.asarray(spherical(1.8, 0.0)), width=width) == 0


def test_no_more_light_leaves_than_arrives(gaussian):
    """A single bounce of a rough surface loses some: at 1.2 rad it has 80 to 100 % of the light."""
    surface, wi = Heightfield(gaussian.z[:200, :200], 1, 1), spherical(1.2, 0.0)
    wo, solid_angle = hemisphere(12, 24)
    f = virtual_goniometer(surface, wi, wo, width=0.15)
    albedo = np.sum(f * wo[:, 2] * solid_angle)
    assert 0.8 < albedo < 1


def test_misuse(gaussian):
    n = np.array([0.0, 0.0, 1.0])
    with pytest.raises(ValueError, match="one direction"):
        visible_facets(gaussian, np.stack([n, n]))
    with pytest.raises(ValueError, match="width must be an angle in"):
        virtual_goniometer(gaussian, n, n, width=0.0)
    with pytest.raises(ValueError, match="unit vectors"):
        visibility(gaussian, 2 * n)
