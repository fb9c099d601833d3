"""The linear form of Cook–Torrance: never a negative lobe, and exactly the reflectance it stands for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from fitting.cook_torrance import CONSTANT_FRESNEL, linear_parameters, lobe_samples, solve_linear
from fitting.parameters import ShapeSpace
from tests import references
from tests.fitting.truths import fresnel

SPACE = ShapeSpace(jb.ShiftedGamma)
ANGLES = np.linspace(0, np.pi / 2, 500)
weights = st.one_of(st.just(0.0), st.floats(1e-6, 1e3))

parameters_of = jax.jit(linear_parameters)


@settings(deadline=None, max_examples=300)
@given(st.tuples(weights, weights, weights, weights))
def test_whatever_the_weights_no_lobe_is_negative(x):
    rho_d, rho_s, f0, f1 = np.asarray(parameters_of(jnp.array(x)))
    assert rho_d == x[0]
    assert rho_s >= 0
    F = fresnel(ANGLES, f0, f1)
    assert np.all(rho_s * F >= -1e-13 * max(x))
    if any(x[1:]):
        assert rho_s > 0
        assert np.all(F >= -1e-10)
        assert rho_s * F.max() > 0


def test_a_lobe_of_no_weight_has_zeros_for_parameters():
    assert_array_equal(parameters_of(jnp.array([0.3, 0.0, 0.0, 0.0])), [0.3, 0, 0, 0])


def test_the_constant_fresnel_term_is_one():
    assert np.all(CONSTANT_FRESNEL >= 0)
    _, rho_s, f0, f1 = np.asarray(parameters_of(np.concatenate([[0.0], 0.7 * CONSTANT_FRESNEL])))
    assert_allclose(rho_s, 0.7, rtol=1e-14)
    assert_allclose(fresnel(ANGLES, f0, f1), 1, rtol=1e-13)


def test_physical_fresnel_terms_lie_in_the_cone():
    """Schlick's for any F_0, and those that fall before they rise, are combinations with weights ≥ 0."""
    grazing = (1 - np.cos(ANGLES)) ** 5
    unit = np.asarray([parameters_of(jnp.array(row)) for row in np.eye(4)[1:]])
    features = np.stack([rho_s * fresnel(ANGLES, f0, f1) for _, rho_s, f0, f1 in unit])
    for f0, f1 in [(0.02, 0.0), (0.5, 0.0), (1.0, 0.0), (0.6, 0.1), (0.9, 0.3)]:
        x = np.linalg.lstsq(features.T, fresnel(ANGLES, f0, f1), rcond=None)[0]
        assert np.all(x >= -1e-12)
        assert_allclose(x @ features, f0 + (1 - f0) * grazing - f1 * np.cos(ANGLES), atol=1e-12)


@pytest.fixture(scope="module")
def samples():
    rng = np.random.default_rng(8)
    cos_theta = rng.uniform(0.2, 1, (2, 12))
    w = references.direction(np.arccos(cos_theta), rng.uniform(-np.pi, np.pi, (2, 12)))
    return lobe_samples(SPACE, jnp.asarray(w[0]), jnp.asarray(w[1]))


@pytest.mark.parametrize("shape", [(0.02, 0.7), (0.3, 0.2)])
def test_features_and_parameters_are_the_same_cook_torrance(samples, shape):
    """Both against the pair-by-pair truth with brute-force masking."""
    alpha, p = shape
    t = jnp.array([np.log(alpha / 1e-5) / np.log(2e5), p / 3])
    x = jnp.asarray(np.random.default_rng(9).uniform(0.1, 1, 4))
    rho_d, rho_s, f0, f1 = linear = np.asarray(parameters_of(x))
    row = {"rho_d": rho_d, "rho_s": rho_s, "alpha": alpha, "p": p, "f0": f0, "f1": f1}
    pairs = zip(np.asarray(samples.wi), np.asarray(samples.wo), strict=True)
    truth = [references.cook_torrance(wi, wo, **row) for wi, wo in pairs]

    exact, quick = jax.jit(lambda t: (samples.exact_lobe(t), samples.lobe(t)))(t)
    combine = jax.jit(lambda lobe: x @ samples.features(lobe))
    direct = jax.jit(lambda lobe: samples.reflectance(jnp.asarray(linear), lobe))
    assert_allclose(combine(exact), truth, rtol=1e-7)
    assert_allclose(direct(exact), truth, rtol=1e-7)
    assert_allclose(combine(quick), truth, rtol=5e-6)


def test_the_weights_of_a_combination_are_found_again(samples):
    x = np.array([0.3, 0.5, 0.0, 0.2])
    features = samples.features(samples.lobe(jnp.array([0.8, 0.2])))
    weight = jnp.asarray(np.random.default_rng(10).uniform(0.5, 1, 12))
    assert_allclose(jax.jit(solve_linear)(features, weight, x @ features), x, atol=1e-6)
