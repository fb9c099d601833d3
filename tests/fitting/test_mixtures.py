"""Mixtures fitted with their shares: what made tables comes back, noise is told of, bounds are a status."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitting import fit_ndf, fit_ndf_patches, fit_reflectance
from fitting.model_space import model_space
from jaxbrdf import (
    Beckmann,
    FitStatus,
    Lambertian,
    Microfacet,
    Schlick,
    TabulatedNDF,
    TrowbridgeReitz,
    mixture,
)
from jaxbrdf.ndf.mixture import Mixture
from jaxbrdf.ndf.tabulated import disk_cells
from tests.fitting.made import table

N = 65
M = np.moveaxis(disk_cells(N), 0, -1)
TWO = mixture([0.5, 0.5], [TrowbridgeReitz(0.1), TrowbridgeReitz(0.4)])


def tabulated(ndf):
    return np.where(M[..., 2] > 0, ndf._density(jnp.asarray(M)), 0)


def mixed(shares, *ndfs):
    return Mixture(jnp.array(shares), ndfs)


def numbers(model):
    """(..., K, 1 + p): the share and the parameters of each part, narrow parts first."""
    parts = [jnp.stack(jax.tree.leaves(ndf), axis=-1) for ndf in model.ndfs]
    rows = np.concatenate([model.shares[..., None], np.stack(parts, axis=-2)], axis=-1)
    return np.take_along_axis(rows, np.argsort(rows[..., 1], axis=-1)[..., None], axis=-2)


TRUTHS = {
    "one family": [
        mixed([0.4, 0.6], TrowbridgeReitz(0.1), TrowbridgeReitz(0.4)),
        mixed([0.9, 0.1], TrowbridgeReitz(0.08), TrowbridgeReitz(0.5)),
        mixed([0.9, 0.1], TrowbridgeReitz(0.5), TrowbridgeReitz(0.15)),
        mixed([0.5, 0.5], TrowbridgeReitz(0.2), TrowbridgeReitz(0.3)),
    ],
    "two families": [
        mixed([0.3, 0.7], Beckmann(0.1, 0.3), TrowbridgeReitz(0.4, 0.2)),
        mixed([0.1, 0.9], Beckmann(0.15, 0.5), TrowbridgeReitz(0.07, 0.09)),
        mixed([0.5, 0.5], Beckmann(0.1, 0.8), TrowbridgeReitz(0.06, 0.09)),
    ],
    "three parts": [
        mixed([0.2, 0.3, 0.5], *map(TrowbridgeReitz, (0.08, 0.25, 0.7))),
        mixed([0.6, 0.3, 0.1], *map(TrowbridgeReitz, (0.1, 0.6, 0.25))),
    ],
}


@pytest.mark.parametrize("kind", TRUTHS)
def test_the_mixtures_that_made_a_stack_come_back(kind):
    truths = TRUTHS[kind]
    guess = mixed(np.full(len(truths[0].ndfs), 1 / len(truths[0].ndfs)), *truths[0].ndfs)
    guess = jax.tree.map(lambda leaf: leaf**0.7, guess)  # shares of another sum are as good a start
    result = fit_ndf_patches(guess, TabulatedNDF(np.stack([tabulated(truth) for truth in truths])))
    assert result.success.all()
    # Three parts of one family are nearly those of others: Σ r² of 1e-11 already.
    rtol = 1e-5 if kind != "three parts" else 3e-4
    np.testing.assert_allclose(numbers(result.model), [numbers(truth) for truth in truths], rtol=rtol)
    np.testing.assert_allclose(result.model.shares.sum(axis=1), 1, atol=1e-15)
    names = [name for name in result.parameters if name.startswith("shares")]
    assert names == [f"shares[{k}]" for k in range(len(guess.ndfs) - 1)]


def test_shares_of_counted_normals_are_within_their_standard_errors():
    truth = TRUTHS["one family"][0]
    clean = tabulated(truth)
    counts = [np.random.default_rng(seed).poisson(1e5 * clean / clean.sum()) for seed in range(16)]
    tables = np.stack(counts) * clean.sum() / 1e5
    result = fit_ndf_patches(TWO, TabulatedNDF(tables), loss="likelihood")
    assert result.success.all()
    # Of either order of the parts the first share has the same error.
    errors = np.sqrt(result.covariance[:, 0, 0])
    assert result.parameters[0] == "shares[0]"
    deviations = (numbers(result.model)[:, 0, 0] - 0.4) / errors
    assert np.abs(deviations).max() < 4
    assert 0.6 < np.sqrt(np.mean(deviations**2)) < 1.5


def test_fixed_shares_stay():
    truth = TRUTHS["one family"][0]
    guess = mixed([0.6, 0.4], TrowbridgeReitz(0.2), TrowbridgeReitz(0.2))
    result = fit_ndf(guess, TabulatedNDF(tabulated(truth)), fixed=("shares",))
    np.testing.assert_array_equal(result.model.shares, [0.6, 0.4])
    assert result.parameters == ("ndfs[0].alpha_x", "ndfs[1].alpha_x")
    np.testing.assert_allclose(numbers(result.model), numbers(truth), rtol=1e-5)


@pytest.mark.parametrize("first", [-0.2, 1.2])
def test_a_share_that_would_be_negative_is_on_its_bound(first):
    truth = mixed([0.5, 0.5], Beckmann(0.5), Beckmann(0.2))
    narrow, wide = (tabulated(ndf) for ndf in truth.ndfs)
    outside = TabulatedNDF(first * narrow + (1 - first) * wide)
    result = fit_ndf(truth, outside, fixed=("ndfs[0].alpha_x", "ndfs[1].alpha_x"))
    assert result.status == FitStatus.AT_BOUND
    np.testing.assert_array_equal(result.model.shares, [first > 0, first < 0])
    assert np.isnan(result.covariance).all()


def stick(u):
    """Shares, written out: each takes its part of what is left."""
    return np.array([u[0], (1 - u[0]) * u[1], (1 - u[0]) * (1 - u[1]) * u[2]])


@pytest.mark.parametrize("pinned", [None, 0, 1, 2])
def test_derivatives_by_shares_are_those_of_the_map(pinned):
    model = mixed([0.1, 0.2, 0.3, 0.4], *map(TrowbridgeReitz, (0.1, 0.2, 0.3, 0.4)))
    space, given, _ = model_space(model, fixed=("alpha_x",))
    u = np.array([0.3, 0.6, 0.2])
    step = 1e-6 * np.eye(3)
    slopes = np.stack([(stick(u + h) - stick(u - h)) / 2e-6 for h in step], axis=1)
    np.testing.assert_allclose(stick(given[0]), [0.1, 0.2, 0.3], rtol=1e-12)
    free = np.arange(3) != pinned
    expected = np.zeros((3, 3))
    expected[np.ix_(free, free)] = np.linalg.inv(slopes[np.ix_(free, free)])
    found = space.by_parameters(jnp.eye(3), jnp.asarray(u), jnp.asarray(~free))
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_the_covariance_of_shares_is_that_of_the_map():
    """With its parts fixed D is linear in the shares: least squares by hand."""
    truth = mixed([0.2, 0.3, 0.5], *map(TrowbridgeReitz, (0.08, 0.25, 0.7)))
    noise = np.random.default_rng(0).normal(size=(N, N)) * 0.1
    result = fit_ndf(truth, TabulatedNDF(tabulated(truth) + noise), fixed=("alpha_x",))
    D = np.stack([tabulated(ndf)[M[..., 2] > 0] for ndf in truth.ndfs])
    J = (D[:2] - D[2]).T
    r = np.asarray(result.residuals)
    half = np.linalg.solve(J.T @ J, J.T * r)
    np.testing.assert_allclose(result.covariance, half @ half.T * len(r) / (len(r) - 2), rtol=1e-8)
    best, *_ = np.linalg.lstsq(J, (tabulated(truth) + noise)[M[..., 2] > 0] - D[2], rcond=None)
    np.testing.assert_allclose(result.model.shares[:2], best, rtol=1e-6)


def test_nothing_left_to_take_a_part_of():
    """Behind a share of 1 the others are 0, whatever their parts of the rest are."""
    model = mixed([1.0, 0.0, 0.0], *map(TrowbridgeReitz, (0.1, 0.2, 0.3)))
    space, given, _ = model_space(model, fixed=("alpha_x",))
    np.testing.assert_array_equal(given, [[1, 0]])
    np.testing.assert_array_equal(space.model(jnp.array([1.0, 0.4]), jnp.zeros(0), []).shares, [1, 0, 0])
    found = space.by_parameters(jnp.ones((4, 2)), jnp.array([1.0, 0.4]), jnp.array([False, False]))
    assert np.isfinite(found).all()


def test_shares_in_a_reflectance_each_channel_with_its_own():
    shares = np.array([[0.3, 0.8], [0.7, 0.2]])
    truth = Lambertian(0.1) + 0.5 * Microfacet(
        mixed(shares, TrowbridgeReitz(0.1), TrowbridgeReitz(0.5)), Schlick(0.5)
    )
    guess = Lambertian(0.3) + 0.8 * Microfacet(TWO, Schlick(0.5))
    result = fit_reflectance(guess, [table(truth)], fixed=("f0",))
    assert result.success.all()
    assert result.model.terms[1].brdf.ndf.shares.shape == (1, 2, 2)
    found = result[0].model.terms[1].brdf.ndf
    order = np.argsort([ndf.alpha_x for ndf in found.ndfs], axis=0)
    np.testing.assert_allclose(np.take_along_axis(np.asarray(found.shares), order, axis=0), shares, rtol=1e-3)
    assert result.parameters[2] == "terms[1].brdf.ndf.shares[0]"
