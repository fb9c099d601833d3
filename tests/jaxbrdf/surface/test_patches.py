"""Distributions of a map's patches: counted anew in plain numpy, and against those of the whole map."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxbrdf import (
    Heightfield,
    PatchNDFs,
    TabulatedNDF,
    filtered_ndf,
    filtered_normals,
    gaussian_surface,
    patch_ndfs,
)
from jaxbrdf.ndf.tabulated import disk_cells

DX, DY = 0.5, 0.8


@pytest.fixture(scope="module")
def surface():
    """48 × 60 µm, steeper along x; pixels are not square."""
    return gaussian_surface(jax.random.key(1), (60, 120), (DX, DY), 0.4, (4.0, 8.0))


@pytest.fixture(scope="module")
def holed(surface):
    """With holes of one pixel, and a whole corner that was not measured."""
    mask = np.random.default_rng(0).random(surface.z.shape) > 0.1
    mask[:30, :50] = False
    return Heightfield(surface.z, DX, DY, mask)


def counted(heightfield, rows, columns, n, extent):
    """D and the number of normals of a part of a map, by numpy's own histogram of `filtered_normals`."""
    m = np.asarray(filtered_normals(heightfield))[rows, columns]
    m = m[np.asarray(heightfield.valid)[rows, columns] & np.isfinite(m[..., 0])]
    x, y = extent
    counts = np.histogram2d(m[:, 1], m[:, 0], n, [[-y, y], [-x, x]])[0]
    return counts / (len(m) * (2 * x / n) * (2 * y / n)), len(m)


@pytest.mark.parametrize("which", ["surface", "holed"])
@pytest.mark.parametrize(
    "stride", [None, (9.9, 3.3), (4.0, 20.0)], ids=["side by side", "overlapping", "mixed"]
)
def test_every_patch_is_a_histogram_of_its_normals(which, stride, request):
    heightfield = request.getfixturevalue(which)
    patches = patch_ndfs(heightfield, (13.2, 8.1), stride, cells=21)
    wide, high = 26, 10  # pixels
    x, y = (wide, high) if stride is None else np.rint(np.array(stride) / [DX, DY]).astype(int)
    starts = [(i, j) for i in range(0, 60 - high + 1, y) for j in range(0, 120 - wide + 1, x)]
    assert patches.shape == (len({i for i, _ in starts}), len({j for _, j in starts}))
    assert patches.values.shape == (len(starts), 21, 21)
    for k, (i, j) in enumerate(starts):
        place = slice(i, i + high), slice(j, j + wide)
        if patches.counts[k]:
            density, number = counted(heightfield, *place, 21, patches.tables.extent)
            assert_allclose(patches.values[k], density, rtol=1e-12)
            assert patches.counts[k] == number
    middles = [((j + (wide - 1) / 2) * DX, (i + (high - 1) / 2) * DY) for i, j in starts]
    assert_allclose(patches.centres, middles, rtol=1e-12)
    assert_allclose(patches.size + patches.stride, (wide * DX, high * DY, x * DX, y * DY), rtol=1e-12)


def test_a_patch_without_a_normal_is_nan_and_others_leave_out_what_is_missing(holed):
    patches = patch_ndfs(holed, (10.0, 8.0))
    counts, missing = patches.image(np.asarray(patches.counts)), patches.image(np.isnan(patches.values))
    assert counts.shape == (6, 6)
    assert_array_equal(counts[:3, :2], 0)
    valid = np.asarray(holed.valid).reshape(6, 10, 6, 20).sum(axis=(1, 3))
    assert_array_equal(counts, valid)
    assert_array_equal(missing, np.broadcast_to((counts == 0)[..., None, None], (6, 6, 65, 65)))


def test_patches_side_by_side_are_the_map(holed):
    """Whatever is known in them, over the whole disk, weighed by how many normals each has."""
    patches = patch_ndfs(holed, (10.0, 8.0), cells=33, extent=1.0)
    assert patches.tables.extent == (1.0, 1.0)
    known = np.asarray(patches.counts) > 0
    mean = np.average(patches.values[known], axis=0, weights=patches.counts[known])
    assert_allclose(mean, filtered_ndf(holed, size=33).values, rtol=1e-12)


def test_patches_of_half_a_stride_hold_those_side_by_side(surface):
    apart, over = patch_ndfs(surface, (10.0, 16.0)), patch_ndfs(surface, (10.0, 16.0), (5.0, 8.0))
    assert (apart.shape, over.shape) == ((3, 6), (5, 11))
    assert_array_equal(over.image(over.values)[::2, ::2], apart.image(apart.values))
    assert_array_equal(over.centres.reshape(5, 11, 2)[::2, ::2], apart.centres.reshape(3, 6, 2))
    assert not np.array_equal(over.image(over.values)[::2, 1:-1:2], apart.image(apart.values)[:, :-1])


def test_a_tilt_moves_the_mean_slope_of_every_patch(surface):
    y, x = np.indices(surface.z.shape)
    tilted = Heightfield(surface.z + 0.2 * DX * x - 0.1 * DY * y, DX, DY)
    flat, tilt = (mean_slopes(patch_ndfs(z, 12.0, cells=513, extent=0.8)) for z in (surface, tilted))
    assert np.std(flat, axis=0).min() > 0.005
    assert_allclose(tilt - flat, np.broadcast_to([0.2, -0.1], flat.shape), atol=5e-4)


def mean_slopes(patches):
    """(∂z/∂x, ∂z/∂y) of each patch: the normal leans away from where z rises."""
    m_x, m_y, m_z = disk_cells(patches.values.shape[-1], patches.tables.extent)
    safe = np.where(m_z > 0, m_z, 1)
    values = np.asarray(patches.values)
    share = values / values.sum(axis=(1, 2), keepdims=True)
    return np.stack([-np.sum(share * m / safe, axis=(1, 2)) for m in (m_x, m_y)], axis=-1)


def test_the_window_holds_99_percent_of_the_normals_along_each_axis(holed):
    m = np.asarray(filtered_normals(holed))[np.asarray(holed.valid)]
    patches = patch_ndfs(holed, (10.0, 8.0))  # that tile the map
    x, y = patches.tables.extent
    assert x > 1.5 * y
    inside = np.mean(np.abs(m[:, :2]) <= (x, y), axis=0)
    assert np.all((inside >= 0.99) & (inside < 0.9905))
    share = np.nansum(patches.values, axis=(1, 2)) * (4 * x * y / 65**2)
    assert share.max() <= 1 + 1e-12
    mean = np.average(share, weights=patches.counts)
    assert mean == pytest.approx(np.mean(np.all(np.abs(m[:, :2]) <= (x, y), axis=1)), rel=1e-12)
    assert 0.98 <= mean < 0.99


def test_the_window_of_a_map_with_one_normal_holds_it():
    """A level plane, and tilted ones of which rounding makes normals on both sides of the border."""
    x = np.indices((20, 30))[1]
    for slope in (0.0, 0.3, 1e3):
        for dtype in (np.float32, np.float64):
            patches = patch_ndfs(Heightfield((slope * x).astype(dtype), 1, 1), 10.0)
            half_x, half_y = patches.tables.extent
            assert half_x == pytest.approx(max(1e-6, slope / np.hypot(slope, 1)), rel=1e-5)
            assert 0 < half_y < 1e-5
            assert_allclose(np.sum(patches.values, axis=(1, 2)) * (4 * half_x * half_y / 65**2), 1, rtol=1e-6)


def test_tables_are_in_the_precision_that_jax_works_in(surface):
    single = Heightfield(np.asarray(surface.z, np.float32), DX, DY)
    assert patch_ndfs(single, 20.0, cells=5).values.dtype == np.float64
    with jax.enable_x64(False):
        assert patch_ndfs(single, 20.0, cells=5).values.dtype == np.float32


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (
            (0.7,),
            {},
            "x a patch must be at least two pixels, 1 µm, and at most the map, 60 µm; found 0.7",
        ),
        ((10.0, 0.2), {}, r"along x the stride must be at least one pixel, 0.5 µm; found 0.2"),
        (((10.0, 50.0),), {}, "along y a patch must be .* at most the map, 48 µm; found 50"),
        ((10.0, (5.0, np.inf)), {}, "along y the stride must be"),
        ((np.nan,), {}, "found nan"),
        ((10.0,), {"cells": 0}, "at least one cell; found 0"),
        (
            (10.0,),
            {"extent": (0.5, 0.0)},
            r"greater than 0 and at most 1, .*; found \(0.5, 0.0\)",
        ),
        ((10.0,), {"sigma": 0.1}, "sigma must be at least"),
    ],
)
def test_misuse_is_explained(surface, arguments, options, message):
    with pytest.raises(ValueError, match=message):
        patch_ndfs(surface, *arguments, **options)


def test_what_has_no_normals_or_not_one_for_each_patch_is_refused(surface):
    mask = np.zeros((20, 20), bool)
    mask[5, 5] = True
    tables = TabulatedNDF(np.ones((2, 5, 5)))
    with pytest.raises(ValueError, match="no normal is known"):
        patch_ndfs(Heightfield(np.zeros((20, 20)), 1, 1, mask), 10.0, extent=0.5)
    with pytest.raises(ValueError, match=r"for each of the 4 patches; found shape \(3, 2\)"):
        patch_ndfs(surface, (30.0, 24.0), cells=5).image(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="of one number of patches; found 2, 2, 3"):
        PatchNDFs(tables, jnp.ones(2, int), (1, 3), (1.0, 1.0), (1.0, 1.0), (1.0, 1.0))
