"""The unit cube of shape parameters: its ends, its middle, what lies outside, and slopes by differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from fitting.parameters import ShapeSpace, combinations

SPACE = ShapeSpace(jb.ShiftedGamma)
LOW, HIGH = np.array([1e-5, 0.0]), np.array([2.0, 3.0])


@pytest.fixture(scope="module")
def values():
    return jax.jit(SPACE.values)


def test_names_are_those_of_the_distribution_in_order():
    assert SPACE.names == ("alpha", "p")


def test_the_cube_is_the_range(values):
    assert_allclose(values(jnp.zeros(2)), LOW, rtol=1e-14)
    assert_allclose(values(jnp.ones(2)), HIGH, rtol=1e-14)


def test_alpha_runs_evenly_in_its_logarithm_and_p_in_itself(values):
    t = np.array([[0.25, 0.25], [0.5, 0.5], [0.9, 0.9]])
    expected = np.stack([np.exp(np.log(1e-5) + t[:, 0] * (np.log(2) - np.log(1e-5))), 3 * t[:, 1]], axis=1)
    assert_allclose([values(row) for row in t], expected, rtol=1e-12)


def test_outside_the_cube_the_bound_holds(values):
    assert_allclose(values(jnp.array([-3.0, 7.0])), [1e-5, 3.0], rtol=1e-14)
    assert_allclose(values(jnp.array([1.001, -0.001])), [2.0, 0.0], rtol=1e-14)


def test_batches_of_shapes_make_batches_of_distributions():
    ndf = SPACE.ndf(jnp.full((4, 5, 2), 0.5))
    assert isinstance(ndf, jb.ShiftedGamma)
    assert ndf.alpha.shape == ndf.p.shape == (4, 5)


def test_slopes_are_differences(values):
    step = 1e-6
    for t in np.array([[0.1, 0.9], [0.5, 0.2], [0.99, 0.01]]):
        rise = values(t + step) - values(t - step)
        assert_allclose(eqx.filter_jit(SPACE.slopes)(t), rise / (2 * step), rtol=1e-7)


def test_slopes_are_zero_on_and_beyond_a_bound():
    for t in ([0.0, 1.0], [1.0, 0.0], [-0.5, 1.5]):
        assert_array_equal(SPACE.slopes(jnp.array(t)), 0)


def test_grid_fills_the_cube_evenly_off_its_bounds():
    grid = SPACE.grid(1600)
    assert grid.shape == (1600, 2)
    assert len(np.unique(grid, axis=0)) == 1600
    assert grid.min() > 0
    assert grid.max() < 1
    assert_allclose(grid.mean(axis=0), 0.5)
    for axis in grid.T:
        assert_allclose(np.diff(np.unique(axis.round(12))), 1 / 40)


def test_combinations():
    expected = [[1, 3], [1, 4], [1, 5], [2, 3], [2, 4], [2, 5]]
    assert_array_equal(combinations(np.array([1, 2]), np.array([3, 4, 5])), expected)
