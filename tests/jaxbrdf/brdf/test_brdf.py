"""Every reflectance × every property that a reflectance has; cases.py has the table of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from tests import references
from tests.jaxbrdf.brdf.cases import (
    AT_SEAMS,
    EXCHANGED,
    MIRRORED,
    PAIRS,
    PLAIN,
    TURNED,
    WI,
    WO,
    compiled_quickly,
    evaluated,
    every_brdf,
    every_kind,
)

FEW = slice(0, 16, 5)  # of the pairs, for what takes many evaluations of the truth


def truth(case, parameters, which=PLAIN):
    f = case.reference(*parameters)
    return np.array([f(i, o) for i, o in zip(PAIRS[0][which], PAIRS[1][which], strict=True)])


@every_brdf
def test_value_is_plain_numpys(case):
    assert_allclose(evaluated(case).value[PLAIN], truth(case, case.parameters), rtol=case.error, atol=1e-14)


@every_brdf
def test_reciprocity(case):
    f = evaluated(case).value
    assert_allclose(f[PLAIN], f[EXCHANGED], rtol=1e-11, atol=1e-14)


@every_brdf
def test_isotropy_and_mirror_symmetry(case):
    f = evaluated(case).value
    if case.isotropic:
        assert_allclose(f[TURNED], f[PLAIN], rtol=1e-9, atol=1e-14)
        assert_allclose(f[MIRRORED], f[PLAIN], rtol=1e-9, atol=1e-14)
    else:
        assert np.max(np.abs(f[TURNED] - f[PLAIN])) > 0.1 * np.max(f[PLAIN])


@every_brdf
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_at_and_below_the_horizon_it_is_zero_and_all_is_finite(case, dtype):
    at = evaluated(case, dtype)
    dark = (WI[:, 2] <= 0) | (WO[:, 2] <= 0)
    assert_array_equal(at.value[dark], 0)
    assert np.all(at.value[AT_SEAMS] >= 0)
    for a in (at.value, at.by_parameter, at.by_wi, at.by_wo):
        assert a.dtype == dtype
        assert np.all(np.isfinite(a))


@every_brdf
def test_single_precision_is_accurate(case):
    assert_allclose(
        evaluated(case, np.float32).value[PLAIN], evaluated(case).value[PLAIN], rtol=1e-3, atol=1e-6
    )


@every_brdf
def test_derivatives_by_the_parameters(case):
    """By central differences of the plain numpy formula, in relation to f and the parameter."""
    at = evaluated(case)
    scale = np.maximum(at.value[FEW], 1e-3)
    for i, p in enumerate(case.parameters):
        step = 1e-4 * (abs(p) or 1)
        up, down = (
            truth(case, tuple(q + s * step * (i == j) for j, q in enumerate(case.parameters)), FEW)
            for s in (1, -1)
        )
        expected = (up - down) / (2 * step)
        found = at.by_parameter[i, FEW]
        assert_allclose(found * p / scale, expected * p / scale, rtol=1e-5, atol=1e-5)


@compiled_quickly
def evaluate(make, parameters, wi, wo, u):
    brdf = make(*parameters)
    return brdf(wi, wo), brdf.pdf(wi, wo), brdf.sample(u, wo)


@every_kind
def test_channels_trail_and_batches_lead(case):
    """Leaves (C,): f trails, one density and one direction serve all. Leaves (B,) by vmap: all lead."""
    factors = np.array([1.0, 0.95, 0.9])
    parameters = np.array(case.parameters)[:, None] * factors
    u = np.random.default_rng(2).uniform(size=(len(PAIRS[0]), 2))
    rgb, pdf, wi = evaluate(case.make, parameters, *PAIRS, u)
    batch, densities, _ = jax.vmap(lambda p: evaluate(case.make, p, *PAIRS, u), 1)(parameters)
    assert rgb.shape == (16, 3)
    assert_allclose(rgb, np.moveaxis(batch, 0, -1), rtol=1e-11, atol=1e-14)
    assert_allclose(batch[0], evaluated(case).value[PLAIN], rtol=1e-11, atol=1e-14)
    assert_allclose(pdf, np.mean(densities, axis=0), rtol=1e-11)
    assert_allclose(np.linalg.norm(wi, axis=-1), 1, atol=1e-12)
    assert wi.shape == (16, 3)


def test_the_published_normalisation_has_one_over_pi():
    """At normal incidence F D G / (π cos cos) is F D / π, not F D / 4 (Bagher 2012, eq. 1)."""
    n = jnp.array([0.0, 0.0, 1.0])
    D = references.sgd(0.3, 1.2)(np.asarray(n))
    assert_allclose(jb.ShiftedGammaBRDF(0.0, 1.0, 0.3, 1.2, 1.0, 0.0)(n, n), D / np.pi, rtol=1e-12)
    facets = jb.Microfacet(jb.ShiftedGamma(0.3, 1.2), jb.Constant(1.0))
    assert_allclose(facets(n, n), D / 4, rtol=1e-12)


N = jnp.array([[0.0, 0.0, 1.0]])


def test_a_sum_of_colours_and_greys():
    rgb = jb.Lambertian(jnp.array([0.1, 0.2, 0.3])) + jb.Lambertian(0.5)
    assert_allclose(rgb(N, N), [[0.6 / np.pi, 0.7 / np.pi, 0.8 / np.pi]])


@pytest.mark.parametrize(
    "colour", [jnp.array([0.1, 0.2, 0.3]), np.array([0.1, 0.2, 0.3])], ids=["jax", "numpy"]
)
def test_a_multiple_from_either_side(colour):
    for brdf in (colour * jb.Lambertian(0.5), jb.Lambertian(0.5) * colour):
        assert_allclose(brdf(N, N), 0.5 * colour[None] / np.pi)


def test_one_direction_against_many():
    """wi (3,) and wo (4, 3) broadcast, in all three calls."""
    brdf = jb.Microfacet(jb.TrowbridgeReitz(0.3), jb.Schlick(0.5))
    wi, wo = jb.spherical(0.5, 0.1), jb.spherical(jnp.linspace(0, 1.2, 4), 2.0)
    assert_allclose(brdf(wi, wo)[2], brdf(wi, wo[2]), rtol=1e-13)
    assert_allclose(brdf.pdf(wi, wo)[2], brdf.pdf(wi, wo[2]), rtol=1e-13)
    assert brdf.sample(jnp.array([0.3, 0.6]), wo).shape == (4, 3)
    assert brdf.sample(jnp.full((4, 2), 0.5), wo[0]).shape == (4, 3)
