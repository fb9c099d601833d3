"""Bilinear densities over the unit square: against brute-force integration, and the maps undo each other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxbrdf.brdf.square_warp import flatten, interpolate, square_warp, unflatten

RNG = np.random.default_rng(8)
TABLES = np.stack([RNG.uniform(size=(5, 7)), RNG.uniform(size=(5, 7)) ** 4, np.zeros((5, 7))])
TABLES[1, 2:4, 3] = 0  # a place where nothing is
POINTS = RNG.uniform(size=(400, 2))
MIXED = RNG.uniform(size=400)


def corners(first, second, share=MIXED):
    """Two of the tables, mixed by a share that differs from point to point."""
    index = [np.full(np.shape(share), k) for k in (first, second)]
    return [(jnp.asarray(index[0]), 1 - jnp.asarray(share)), (jnp.asarray(index[1]), jnp.asarray(share))]


def points(array):
    """(N, 2) as the pair of arrays that points are."""
    return jnp.asarray(array)[..., 0], jnp.asarray(array)[..., 1]


def bilinear(table, x, y):
    """The table at a point, by numpy alone."""
    rows, columns = table.shape
    across = np.array([np.interp(x, np.linspace(0, 1, columns), row) for row in table])
    return np.interp(y, np.linspace(0, 1, rows), across)


def normalised(table):
    """Divided by its integral, exact for a bilinear function: the trapezoid rule."""
    return table / np.trapezoid(np.trapezoid(table, dx=1 / (table.shape[1] - 1)), dx=1 / (table.shape[0] - 1))


@pytest.fixture(scope="module")
def flattened():
    return jax.jit(lambda: flatten(square_warp(jnp.asarray(TABLES)), corners(0, 1), points(POINTS)))()


def test_interpolation():
    found = interpolate(jnp.asarray(TABLES), corners(0, 1), points(POINTS))
    pairs = zip(POINTS, MIXED, strict=True)
    expected = [(1 - t) * bilinear(TABLES[0], *p) + t * bilinear(TABLES[1], *p) for p, t in pairs]
    assert_allclose(found, expected, rtol=1e-12)


def test_density(flattened):
    a, b = normalised(TABLES[0]), normalised(TABLES[1])
    pairs = zip(POINTS, MIXED, strict=True)
    expected = [(1 - t) * bilinear(a, *p) + t * bilinear(b, *p) for p, t in pairs]
    assert_allclose(flattened[1], expected, rtol=1e-12)


def test_flattened_coordinates_are_shares_of_the_density(flattened):
    """The second is what lies below the point, the first what lies left of it in its row."""
    fine = np.linspace(0, 1, 20001)
    for k in range(0, 400, 40):
        (x, y), t = POINTS[k], MIXED[k]
        table = (1 - t) * normalised(TABLES[0]) + t * normalised(TABLES[1])
        row = np.array([bilinear(table, v, y) for v in fine[::20]])
        left = np.trapezoid(np.where(fine[::20] <= x, row, 0)) / np.trapezoid(row)
        below = np.trapezoid(
            np.where(fine <= y, np.interp(fine, np.linspace(0, 1, 5), np.trapezoid(table, axis=1)), 0)
        )
        below /= np.trapezoid(np.interp(fine, np.linspace(0, 1, 5), np.trapezoid(table, axis=1)))
        assert_allclose([u[k] for u in flattened[0]], [left, below], atol=2e-3)


def test_the_determinant_of_the_map_is_the_density():
    warp, share = square_warp(jnp.asarray(TABLES)), np.float64(0.3)
    moved = jax.vmap(jax.jacfwd(lambda p: jnp.stack(flatten(warp, corners(0, 1, share), points(p))[0])))
    jacobian = moved(jnp.asarray(POINTS))
    density = flatten(warp, corners(0, 1, np.full(400, 0.3)), points(POINTS))[1]
    assert_allclose(np.linalg.det(jacobian), density, rtol=1e-9)


def test_the_maps_undo_each_other(flattened):
    warp = square_warp(jnp.asarray(TABLES))
    back, density = jax.jit(lambda u: unflatten(warp, corners(0, 1), u))(flattened[0])
    assert_allclose(jnp.stack(back, -1), POINTS, atol=1e-7)
    assert_allclose(density, flattened[1], rtol=1e-6)


def test_ends_and_nothing():
    """Corners of the square stay where they are; a table of zeros is an even density."""
    warp = square_warp(jnp.asarray(TABLES))
    ends = jnp.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    for pair in (corners(0, 1, np.full(4, 0.4)), corners(2, 2, np.zeros(4))):
        assert_allclose(jnp.stack(flatten(warp, pair, points(ends))[0], -1), ends, atol=1e-12)
        assert_allclose(jnp.stack(unflatten(warp, pair, points(ends))[0], -1), ends, atol=1e-6)
    even = flatten(warp, corners(2, 2), points(POINTS))
    assert_allclose(jnp.stack(even[0], -1), POINTS, atol=1e-12)
    assert_allclose(even[1], 1, rtol=1e-12)
