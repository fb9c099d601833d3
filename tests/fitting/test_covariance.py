"""Standard errors: White's formula in numpy, and the scatter of 500 repeated fits."""

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from fitting.covariance import sandwich

covariance = jax.jit(sandwich)


@pytest.fixture(scope="module")
def problem():
    rng = np.random.default_rng(6)
    J = rng.normal(size=(60, 4)) * [1, 1e3, 1e-3, 10]
    weight = rng.uniform(0, 2, 60) * (rng.uniform(size=60) < 0.8)
    return J, rng.normal(size=60), weight


def textbook(J, r, w):
    """Σ over samples, one outer product at a time; N is the number that weigh anything."""
    bread = np.linalg.inv(sum(wi * np.outer(j, j) for wi, j in zip(w, J, strict=True)))
    meat = sum((wi * ri) ** 2 * np.outer(j, j) for wi, ri, j in zip(w, r, J, strict=True))
    N, n = np.sum(w > 0), J.shape[1]
    return bread @ meat @ bread * N / (N - n)


def test_it_is_the_textbooks(problem):
    expected = textbook(*problem)
    size = np.sqrt(np.diagonal(expected))
    assert_allclose(covariance(*problem) / np.outer(size, size), expected / np.outer(size, size), atol=1e-10)


def test_samples_of_no_weight_do_not_exist(problem):
    J, r, w = problem
    J, r = J.copy(), r.copy()
    J[w == 0], r[w == 0] = 1e6, -1e6
    assert_allclose(covariance(J, r, w), covariance(*problem), rtol=1e-10)


def test_the_scale_of_the_weights_does_not_matter(problem):
    J, r, w = problem
    assert_allclose(covariance(J, r, 1e7 * w), covariance(*problem), rtol=1e-8)


def test_an_undetermined_parameter_has_nan_and_the_others_their_own(problem):
    J, r, w = problem
    J = J.copy()
    J[:, 1] = 0
    found = np.array(covariance(J, r, w))
    others = np.ix_([0, 2, 3], [0, 2, 3])
    expected = textbook(J[:, [0, 2, 3]], r, w)
    size = np.sqrt(np.diagonal(expected))
    assert_allclose(found[others] / np.outer(size, size), expected / np.outer(size, size), atol=1e-10)
    found[others] = np.nan
    assert np.all(np.isnan(found))


def test_no_more_samples_than_parameters_determine_nothing():
    J = np.eye(4)[:, :3]
    assert np.all(np.isnan(covariance(J, np.ones(4), np.array([1.0, 1.0, 1.0, 0.0]))))


def test_standard_errors_are_the_scatter_of_repeated_fits():
    """A straight line and a parabola under noise that grows with x, which the weights know nothing about."""
    rng = np.random.default_rng(7)
    x = np.linspace(0, 1, 120)
    J = np.stack([np.ones_like(x), x, x**2], axis=1)
    weight = 1 / (0.3 + x)
    truth = np.array([1.0, -2.0, 0.5])
    y = J @ truth + rng.normal(size=(500, 120)) * (0.02 + 0.3 * x**2)
    found = np.linalg.solve(J.T @ (weight[:, None] * J), J.T @ (weight * y).T).T
    residual = found @ J.T - y
    claimed = jax.jit(jax.vmap(sandwich, (None, 0, None)))(J, residual, weight)
    errors = np.sqrt(np.diagonal(claimed, axis1=1, axis2=2))
    assert_allclose(np.sqrt(np.mean(errors**2, axis=0)), found.std(axis=0), rtol=0.15)
    within = np.abs(found - truth) < 2 * errors
    assert np.all((within.mean(axis=0) > 0.91) & (within.mean(axis=0) < 0.98))
