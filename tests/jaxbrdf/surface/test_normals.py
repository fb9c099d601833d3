"""Normals of height maps and their distributions: brute-force fits, and surfaces with a closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbrdf import (
    Beckmann,
    Heightfield,
    default_sigma,
    facet_ndf,
    filtered_ndf,
    filtered_normals,
    gaussian_surface,
    mean_ndf,
)
from jaxbrdf.ndf.tabulated import disk_cells
from jaxbrdf.surface.normals import facet_cells

DX, DY, SIGMA = 0.5, 0.8, 1.2


@pytest.fixture(scope="module")
def rough():
    """A rough map on a slope far above zero, and where it was measured: points and a whole corner are not."""
    rng = np.random.default_rng(0)
    z = 40 + 0.3 * np.arange(31)[None, :] + 0.5 * rng.standard_normal((24, 31))
    mask = rng.random(z.shape) > 0.2
    mask[:9, :9] = False
    return z, mask


def brute_force(z, mask):
    """Slopes (n, 2) of the weighted least-squares plane around every measured point, over the whole map."""
    y, x = np.meshgrid(DY * np.arange(z.shape[0]), DX * np.arange(z.shape[1]), indexing="ij")
    slopes = []
    for i, j in np.argwhere(mask):
        u, v = x - x[i, j], y - y[i, j]
        root = np.sqrt(np.exp(-(u**2 + v**2) / (2 * SIGMA**2)) * mask).ravel()
        design = np.stack([np.ones_like(u), u, v], axis=-1).reshape(-1, 3)
        slopes.append(np.linalg.lstsq(design * root[:, None], z.ravel() * root)[0][1:])
    return np.array(slopes)


def apart(normals, slopes):
    """Degrees between normals (n, 3) and those of slopes (n, 2)."""
    truth = np.concatenate([-slopes, np.ones((len(slopes), 1))], axis=-1)
    truth /= np.linalg.norm(truth, axis=-1, keepdims=True)
    return np.rad2deg(np.linalg.norm(np.asarray(normals, float) - truth, axis=-1))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("complete", [True, False])
def test_filtered_normals_are_those_of_weighted_planes(rough, dtype, complete):
    z, mask = rough
    spoiled = z if complete else np.where(mask, z, 1e9)
    heightfield = Heightfield(spoiled.astype(dtype), DX, DY, None if complete else mask)
    normals = filtered_normals(heightfield, SIGMA)
    measured = np.ones_like(mask) if complete else mask
    assert np.max(apart(normals[measured], brute_force(heightfield.heights, measured))) < 1e-3


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_where_little_was_measured_a_normal_is_right_or_unknown(dtype):
    """Three points in two hundred: many lean on points that hardly weigh."""
    rng = np.random.default_rng(3)
    z, mask = rng.standard_normal((80, 80)), rng.random((80, 80)) > 0.985
    normals = filtered_normals(Heightfield(z.astype(dtype), DX, DY, mask), SIGMA)[mask]
    known = np.isfinite(normals[:, 0])
    assert 0.5 < known.mean() < 0.95
    assert np.max(apart(normals[known], brute_force(z, mask)[known])) < 1e-3


def test_a_normal_is_unknown_where_too_little_was_measured():
    mask = np.zeros((40, 40), bool)
    mask[20, :] = mask[5, 5] = True  # points in a line, and a single one
    normals = filtered_normals(Heightfield(np.zeros((40, 40)), 1, 1, mask), 1.0)
    assert np.isnan(normals[20, 20]).all()
    assert np.isnan(normals[5, 5]).all()
    with pytest.raises(ValueError, match="no normal is known"):
        filtered_ndf(Heightfield(np.zeros((40, 40)), 1, 1, mask), 1.0)


def test_gradients_by_the_heights_are_those_of_finite_differences(rough):
    z, mask = rough
    weight = np.random.default_rng(1).standard_normal((*z.shape, 3)) * mask[..., None]

    @jax.jit
    def total(z):
        return jnp.sum(weight * jnp.nan_to_num(filtered_normals(Heightfield(z, DX, DY, mask), SIGMA)))

    gradient = jax.grad(total)(jnp.asarray(z))
    for i, j in [(12, 20), (23, 30), (9, 4)]:
        step = np.zeros_like(z)
        step[i, j] = 1e-4
        difference = (total(z + step) - total(z - step)) / 2e-4
        assert float(gradient[i, j]) == pytest.approx(float(difference), rel=1e-5, abs=1e-7)


def test_an_unknown_normal_leaves_the_gradient_of_the_others_alone():
    z = np.random.default_rng(4).standard_normal((12, 40))
    mask = np.ones(z.shape, bool)
    mask[:, 20:] = False  # the last pixels are too far from anything

    def total(z):
        normals = filtered_normals(Heightfield(z, 1, 1, mask), 1.0)
        return jnp.sum(jnp.where(jnp.isnan(normals), 0, normals)[:, :20, 0])

    assert np.isnan(filtered_normals(Heightfield(z, 1, 1, mask), 1.0)[:, -1]).all()
    gradient = jax.grad(total)(z)
    step = np.where(np.arange(40) == 7, 1e-5, 0.0) * np.ones((12, 1))
    difference = (total(z + step) - total(z - step)) / 2e-5
    assert float(np.sum(gradient[:, 7])) == pytest.approx(float(difference), rel=1e-6)
    np.testing.assert_array_equal(gradient[:, 20:], 0)


def test_a_batch_is_a_vmap(rough):
    z, _ = rough
    stack = jnp.stack([z, 2 * z])
    normals = jax.vmap(lambda z: filtered_normals(Heightfield(z, DX, DY), SIGMA))(stack)
    np.testing.assert_allclose(normals[1], filtered_normals(Heightfield(2 * z, DX, DY), SIGMA), atol=1e-12)


@pytest.mark.parametrize("estimate", [facet_ndf, filtered_ndf])
def test_a_plane_has_one_normal_in_the_cell_where_it_belongs(estimate):
    """z rises with x, and so its normal leans to −x: to a column left of the middle."""
    y, x = np.mgrid[:12, :15]
    table = estimate(Heightfield(0.5 * x * DX + 0.1 * y * DY, DX, DY), size=41)
    m = np.array([-0.5, -0.1]) / np.sqrt(1 + 0.5**2 + 0.1**2)
    column, row = np.floor((m + 1) * 41 / 2).astype(int)
    expected = np.zeros((41, 41))
    expected[row, column] = (41 / 2) ** 2
    np.testing.assert_allclose(table.values, expected, rtol=1e-12)


def test_facets_of_a_sphere_are_spread_evenly():
    """Over a square of half side a the projected area of a sphere is even in m_x and m_y up to a/R."""
    x = np.linspace(-6, 6, 601)
    z = np.sqrt(10.0**2 - x[None, :] ** 2 - x[:, None] ** 2)
    table = np.asarray(facet_ndf(Heightfield(z, x[1] - x[0], x[1] - x[0]), size=25).values)
    inside = np.abs(2 * np.arange(25) - 24) / 25 + 1 / 25 < 0.6
    core = table[np.ix_(inside, inside)]
    np.testing.assert_allclose(core, 1 / 1.2**2, rtol=0.03)
    assert np.sum(table) * (2 / 25) ** 2 == pytest.approx(1)


def test_facets_of_a_sinusoid_follow_the_arcsine():
    """z = A sin kx: the share of slopes below s is 1/2 + arcsin(s / Ak) / π."""
    x = np.linspace(0, 2 * np.pi, 20001)
    z = np.broadcast_to(0.8 * np.sin(x), (3, len(x)))
    table = np.asarray(facet_ndf(Heightfield(z, x[1], 1.0), size=51).values)
    edges = np.clip(2 * np.arange(52) / 51 - 1, -0.999999, 0.999999)
    slopes = edges / np.sqrt(1 - edges**2)
    share = np.diff(0.5 + np.arcsin(np.clip(slopes / 0.8, -1, 1)) / np.pi)
    np.testing.assert_allclose(table.sum(axis=0) * (2 / 51) ** 2, share, atol=3e-4)


def test_the_facets_of_a_gaussian_surface_are_beckmanns():
    """α = 2σ/τ for slopes; between pixels they are √(1 − C(dx)) τ/dx of that."""
    surface = gaussian_surface(jax.random.key(2), (1024, 1024), 1.0, 1.0, (10.0, 20.0))
    table = np.asarray(facet_ndf(surface, size=129).values)
    between = [np.sqrt(1 - np.exp(-((1 / tau) ** 2))) * tau for tau in (10, 20)]
    m = np.moveaxis(disk_cells(129), 0, -1)
    beckmann = Beckmann(0.2 * between[0], 0.1 * between[1])
    truth = np.where(m[..., 2] > 0, beckmann(np.where(m[..., 2:] > 0, m, [0.0, 0.0, 1.0])), 0)
    assert np.linalg.norm(table - truth) < 0.06 * np.linalg.norm(truth)
    m_x, m_y, m_z = np.moveaxis(m, -1, 0)
    weight = table / table.sum()
    for slope, alpha in ((m_x, 0.2), (m_y, 0.1)):
        rms = np.sqrt(np.sum(weight * (slope / np.where(m_z > 0, m_z, 1)) ** 2))
        assert rms == pytest.approx(alpha / np.sqrt(2), rel=0.04)


def test_many_maps_count_as_one_of_all_their_points(rough):
    z, mask = rough
    maps = [Heightfield(z, DX, DY, mask), Heightfield(z[::-1], DX, DY)]
    together = np.asarray(mean_ndf(iter(maps), facet_cells, 33).values)
    counts = [np.sum(facet_cells(one, 33) < 33**2) for one in maps]
    apart = sum(n * np.asarray(facet_ndf(one, 33).values) for n, one in zip(counts, maps, strict=True))
    np.testing.assert_allclose(together, apart / sum(counts), rtol=1e-12)


def test_sigma_is_a_micrometre_or_more_where_pixels_are_coarse():
    flat = np.zeros((8, 8))
    assert filtered_normals(Heightfield(flat, 0.1, 0.2), np.float64(1)).shape == (8, 8, 3)
    assert default_sigma(Heightfield(flat, 0.1, 0.2)) == 1
    assert default_sigma(Heightfield(flat, 0.1, 2.0)) == 3
    with pytest.raises(ValueError, match="at least the larger pixel size, 2 µm; found 1 µm"):
        filtered_ndf(Heightfield(flat, 0.1, 2.0), 1.0)
    with pytest.raises(ValueError, match="at least"):
        filtered_normals(Heightfield(flat, 0.1, 2.0), np.nan)
