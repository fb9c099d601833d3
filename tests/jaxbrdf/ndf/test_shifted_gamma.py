"""The shifted gamma distribution beyond what every distribution is tested for: the paper's own formulas."""

import csv

import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxbrdf as jb
from tests import references


@eqx.filter_jit
def projected_area(ndf, w):
    return ndf.projected_area(w)


@pytest.fixture(scope="module")
def published(shared_data):
    """The columns of the 300 published rows (100 MERL materials × RGB)."""
    with open(shared_data / "published" / "sgd_bagher2012_merl.csv") as file:
        rows = list(csv.DictReader(file))
    return {
        name: np.array([float(row[name]) for row in rows])
        for name in ("alpha", "p", "K", "lambda", "c", "k", "theta0")
    }


def test_the_published_normalisation(published):
    """K = 1 / (α Γ(1−p, α)) of all 300 rows to the six digits printed (of α and p as well)."""
    alpha, p = jnp.asarray(published["alpha"]), jnp.asarray(published["p"])
    assert len(alpha) == 300
    assert_allclose(1 / (alpha * jb.upper_gamma(1 - p, alpha)), published["K"], rtol=5e-6)


def test_the_published_density(published):
    """D(0) = K exp(−α) / (π α^p), K being the published one."""
    alpha, p = published["alpha"], published["p"]
    ndf = jax.vmap(jb.ShiftedGamma)(jnp.asarray(alpha), jnp.asarray(p))
    peak = jax.jit(jax.vmap(lambda ndf: ndf(jnp.array([0.0, 0.0, 1.0]))))(ndf)
    assert_allclose(peak, published["K"] * np.exp(-alpha) / (np.pi * alpha**p), rtol=1e-5)


def test_the_published_theta_0(published):
    shadowing = jb.ShiftedGammaShadowing(published["lambda"], published["c"], published["k"])
    assert_allclose(shadowing.theta_0, published["theta0"], atol=6e-6)


@pytest.mark.parametrize(
    ("alpha", "p", "theta"), [(0.5, 0.0, 0.8), (0.1, 0.5, 1.2), (0.0148, 1.0, 1.5), (0.5, 2.0, 0.37)]
)
def test_projected_area_is_that_of_the_papers_integral(alpha, p, theta):
    """Section 4.3: one integral over a confluent hypergeometric function, by mpmath."""
    sigma = projected_area(jb.ShiftedGamma(alpha, p), jb.spherical(theta, 0.0))
    assert_allclose(sigma, references.sgd_projected_area(alpha, p, theta), rtol=1e-10)


def test_without_a_peak_it_is_beckmanns():
    """p = 0 is Beckmann's of roughness √α, whose Λ is known: (erf a − 1)/2 + exp(−a²)/(2 a √π)."""
    alpha, theta = 0.09, np.array([0.1, 0.7, 1.2, 1.5])
    a = 1 / (np.sqrt(alpha) * np.tan(theta))
    Lambda = [(mpmath.erf(x) - 1) / 2 + mpmath.exp(-(x**2)) / (2 * x * mpmath.sqrt(mpmath.pi)) for x in a]
    sigma = jb.ShiftedGamma(alpha, 0.0).projected_area(jb.spherical(jnp.asarray(theta), 0.0))
    assert_allclose(sigma, np.cos(theta) * (1 + np.array(Lambda, float)), rtol=1e-10)


@pytest.mark.parametrize(("alpha", "p"), [(1e-3, 0.5), (0.05, 1.0), (0.3, 1.5)])
def test_derivatives_by_the_parameters(alpha, p):
    """Of log D and σ, by central differences of the references."""
    m, w = (references.direction(np.array(theta), 0.2) for theta in ([0.0, 0.02, 0.2], [0.4, 1.3, 1.55]))

    @jax.jit
    def library(alpha, p):
        ndf = jb.ShiftedGamma(alpha, p)
        return jnp.stack([jnp.log(ndf(jnp.asarray(m))), ndf.projected_area(jnp.asarray(w))])

    def reference(alpha, p):
        density = references.sgd(alpha, p)
        return np.stack([np.log(density(m)), [references.projected_area(density, x) for x in w]])

    by_alpha, by_p = jax.jit(jax.jacfwd(library, (0, 1)))(alpha, p)
    step = 1e-4
    true_alpha = (reference(alpha * (1 + step), p) - reference(alpha * (1 - step), p)) / (2 * step * alpha)
    true_p = (reference(alpha, p + step) - reference(alpha, p - step)) / (2 * step)
    assert_allclose(by_alpha, true_alpha, rtol=1e-5, atol=1e-8)
    assert_allclose(by_p, true_p, rtol=1e-5, atol=1e-8)


def test_samples_have_the_closed_distribution_function():
    """1 − F(θ) = Γ(1−p, α + tan²θ/α) / Γ(1−p, α) (section 4.5), turned back into u_1 by mpmath."""
    alpha, p, u = 0.05, 1.2, np.array([1e-9, 1e-3, 0.4, 0.9, 1 - 1e-12])
    m = np.asarray(jb.ShiftedGamma(alpha, p).sample(jnp.stack([jnp.asarray(u), 0.1 * jnp.ones(5)], axis=-1)))
    tan2 = (m[:, 0] ** 2 + m[:, 1] ** 2) / m[:, 2] ** 2
    survival = [references.log_upper_gamma(1 - p, alpha + t / alpha)[0] for t in tan2]
    survival = np.exp(np.array(survival) - references.log_upper_gamma(1 - p, alpha)[0])
    assert_allclose(1 - survival, u, rtol=1e-6, atol=1e-14)
    assert_allclose(survival, 1 - u, rtol=1e-4)
