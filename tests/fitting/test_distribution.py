"""Distributions fitted to tables: what made them comes back, noise is told of, and nonsense is a status."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitting import fit_ndf
from jaxbrdf import Beckmann, Ellipsoid, FitStatus, StudentT, TabulatedNDF, TrowbridgeReitz
from jaxbrdf.ndf.tabulated import disk_cells

N = 129
M = np.moveaxis(disk_cells(N), 0, -1)
GUESS = Ellipsoid(0.2, 0.2, 0.0, 0.0, 0.0)
TILTED = Ellipsoid(0.06, 0.3, 0.1, -0.05, 0.6)


def tabulated(ndf):
    return np.where(M[..., 2] > 0, ndf._density(jnp.asarray(M)), 0)


def counted(ndf, count, seed):
    """The table of a count of normals, each cell Poisson distributed."""
    share = tabulated(ndf)
    normals = np.random.default_rng(seed).poisson(count * share / share.sum())
    return normals / normals.sum() * (N / 2) ** 2


def numbers(result):
    return np.array(jax.tree.leaves(result.model))


@pytest.mark.parametrize(
    ("truth", "guess"),
    [
        (TILTED, GUESS),
        (Ellipsoid(0.3, 0.05, -0.2, 0.1, -0.3), GUESS),
        (TrowbridgeReitz(0.05, 0.2), TrowbridgeReitz(0.3, 0.3)),
        (Beckmann(0.1), Beckmann(0.5)),
        (StudentT(0.1, 3.0), StudentT(0.3, 2.0)),
    ],
)
def test_the_distribution_that_made_a_table_comes_back(truth, guess):
    result = fit_ndf(guess, TabulatedNDF(tabulated(truth)))
    assert result.success
    np.testing.assert_allclose(numbers(result), jax.tree.leaves(truth), rtol=1e-5)
    assert result.residuals.shape == (np.sum(M[..., 2] > 0),)


def test_a_stack_of_noisy_tables_ends_within_its_standard_errors():
    tables = np.stack([counted(TILTED, 2e5, seed) for seed in range(6)])
    result = fit_ndf(GUESS, TabulatedNDF(tables))
    assert result.success.all()
    deviations = (numbers(result).T - jax.tree.leaves(TILTED)) / np.sqrt(
        np.diagonal(result.covariance, axis1=1, axis2=2)
    )
    assert np.abs(deviations).max() < 4
    assert 0.5 < np.sqrt(np.mean(deviations**2)) < 1.6


def test_cells_without_a_value_do_not_count():
    values = tabulated(TILTED)
    values[:, :40] = np.nan
    result = fit_ndf(GUESS, TabulatedNDF(values))
    np.testing.assert_allclose(numbers(result), jax.tree.leaves(TILTED), rtol=1e-5)
    assert np.isnan(result.residuals).any()


def test_a_table_of_a_window_is_compared_in_its_cells():
    truth, extent = Ellipsoid(0.004, 0.02, 0.003, -0.01, 0.2), (0.03, 0.1)
    m = jnp.asarray(np.moveaxis(disk_cells(65, extent), 0, -1))
    result = fit_ndf(GUESS, TabulatedNDF(truth._density(m), extent))
    assert result.success
    np.testing.assert_allclose(numbers(result), jax.tree.leaves(truth), rtol=1e-5)
    assert result.residuals.shape == (65**2,)


def test_fixed_parameters_stay():
    truth = Ellipsoid(0.06, 0.3, 0.0, 0.0, 0.6)
    guess = Ellipsoid(0.2, 0.2, 0.0, 0.0, 0.0)
    result = fit_ndf(guess, TabulatedNDF(tabulated(truth)), fixed=("theta_x", "theta_y"))
    np.testing.assert_allclose(numbers(result), jax.tree.leaves(truth), atol=1e-6)
    assert result.parameters == ("alpha_x", "alpha_y", "theta_z")


@pytest.mark.parametrize("value", [0.0, np.nan, np.float32(0)])
@pytest.mark.parametrize("size", [N, 257], ids=["all cells", "some cells"])
def test_a_table_of_nothing_is_a_status(value, size):
    result = fit_ndf(Beckmann(0.1), TabulatedNDF(np.full((size, size), value)))
    assert result.status == FitStatus.TOO_FEW_SAMPLES
    assert np.isnan(result.model.alpha_x)


@pytest.mark.parametrize(
    ("model", "table", "message"),
    [
        (Beckmann(jnp.array([0.1, 0.2])), np.ones((N, N)), "without channels"),
        (Beckmann(0.1), np.ones((N, N, 3)), "without channels"),
        (TabulatedNDF(np.ones((5, 5))), np.ones((N, N)), "nothing to fit"),
    ],
)
def test_misuse_is_explained(model, table, message):
    with pytest.raises(ValueError, match=message):
        fit_ndf(model, TabulatedNDF(table))
