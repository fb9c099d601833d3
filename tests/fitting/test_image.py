"""Fits chosen and made by how they look, and the bounded minima that are behind the latter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from fitting import fit_image, fit_losses, fit_reflectance, minimize
from jaxbrdf import (
    Beckmann,
    Lambertian,
    MeasuredBRDF,
    Microfacet,
    Schlick,
    StudentT,
    TrowbridgeReitz,
    lab_difference,
)
from tests.fitting.made import GRID, table

GUESS = Lambertian(0.5) + 0.5 * Microfacet(Beckmann(0.5), Schlick(0.5))
LOSSES = ("l2", "log", "cube_root")


@pytest.fixture(scope="module")
def measured():
    """Two materials whose tails no Beckmann distribution has."""
    tails = StudentT(jnp.array([0.1, 0.12, 0.15]), 2.0)
    first = Lambertian(jnp.array([0.3, 0.1, 0.05])) + 0.8 * Microfacet(tails, Schlick(0.1))
    second = Lambertian(jnp.array([0.01, 0.02, 0.03])) + 1.0 * Microfacet(TrowbridgeReitz(0.05), Schlick(0.7))
    return [table(first, "first"), table(second, "second")]


@pytest.fixture(scope="module")
def chosen(measured):
    return fit_reflectance(GUESS, measured, LOSSES, select="image")


def test_the_closest_picture_is_chosen(measured, chosen):
    by_loss = fit_losses(GUESS, measured, LOSSES)
    names = chosen.recipe.removeprefix("image: ").split(", ")
    for i, material in enumerate(measured):
        differences = [float(lab_difference(result[i].model, material)) for result in by_loss]
        assert names[i] == LOSSES[int(np.argmin(differences))]
        assert float(lab_difference(chosen[i].model, material)) == pytest.approx(min(differences), rel=1e-6)
    assert chosen.names == ("first", "second")
    assert chosen.status.shape == (2, 3)


def test_a_picture_is_matched_better_than_by_any_loss(measured, chosen):
    result = fit_image(GUESS, measured[1], LOSSES, max_steps=40)
    before, after = (float(lab_difference(m, measured[1])) for m in (chosen[1].model, result.model))
    assert after < 0.9 * before
    np.testing.assert_allclose(result.cost, after, rtol=1e-6)
    assert np.isnan(result.covariance).all()


def test_misuse_is_explained(measured):
    with pytest.raises(ValueError, match="several with select='image'"):
        fit_reflectance(GUESS, measured, LOSSES)
    with pytest.raises(ValueError, match="several with select='image'"):
        fit_reflectance(GUESS, measured, "l2", select="image")
    two = MeasuredBRDF(measured[0].raw[..., :2], np.ones(2), GRID)
    with pytest.raises(ValueError, match="one grey channel or of R, G and B; found 2"):
        fit_image(GUESS, two)


def test_bounded_minima_are_scipys():
    def rosenbrock(z):
        return (1 - z[0]) ** 2 + 10 * (z[1] - z[0] ** 2) ** 2

    start, low, high = np.array([-1.0, 1.0]), np.array([-2.0, -2.0]), np.array([0.5, 2.0])
    ours = minimize(rosenbrock, *map(jnp.asarray, (start, low, high)), tolerance=1e-8)
    theirs = scipy.optimize.minimize(
        lambda z: float(rosenbrock(z)), start, bounds=list(zip(low, high, strict=True)), method="L-BFGS-B"
    )
    assert ours.converged
    np.testing.assert_allclose(ours.z, theirs.x, atol=1e-4)
    assert float(ours.value) <= theirs.fun + 1e-8


def test_maximum_likelihood_of_slopes_is_their_mean_square():
    """Beckmann's α² of drawn normals is the mean of tan²θ: the closed form of the likelihood's maximum."""
    m = Beckmann(0.3).sample(jax.random.uniform(jax.random.key(1), (20_000, 2)))
    tan2 = (m[:, 0] ** 2 + m[:, 1] ** 2) / m[:, 2] ** 2

    def cost(z):
        return -jnp.mean(jnp.log(Beckmann(jnp.exp(z[0]))(m) * m[:, 2]))

    found = minimize(cost, jnp.array([-1.0]), jnp.array([-3.0]), jnp.array([1.0]), tolerance=1e-8)
    np.testing.assert_allclose(jnp.exp(2 * found.z[0]), jnp.mean(tan2), rtol=1e-5)


def test_a_hopeless_objective_keeps_its_start():
    found = minimize(lambda z: jnp.log(-jnp.abs(z[0])), jnp.ones(1), -jnp.ones(1), 2 * jnp.ones(1))
    assert not found.converged
    np.testing.assert_array_equal(found.z, 1.0)
