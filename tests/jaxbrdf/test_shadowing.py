"""Smith's masking and the paper's approximation of it: range, limits, formula in 50 digits, gradients."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from tests import references

THETA = np.array([0.0, 0.3, 1.0, 1.4, 1.55, np.pi / 2 - 1e-9])
W = jb.spherical(jnp.asarray(THETA), 0.4)
LOBES = [(1e-5, 0.5), (0.05, 1.0), (1.0, 0.0)]
MIRROR_LIKE = (31.0579, 1.63655e109, 251.7)  # the published c reaches 1e109


@eqx.filter_jit
def evaluate(function, *arguments):
    return function(*arguments)


@jax.jit
def gradients(alpha, p, w):
    return jax.jacrev(lambda a, p, w: jb.smith_G1(jb.ShiftedGamma(a, p), w), (0, 1, 2))(alpha, p, w)


@pytest.mark.parametrize(("alpha", "p"), LOBES)
def test_smith_is_cosine_over_projected_area(alpha, p):
    G1 = evaluate(jb.smith_G1, jb.ShiftedGamma(alpha, p), W)
    density = references.sgd(alpha, p)
    expected = [w[2] / references.projected_area(density, w) for w in references.direction(THETA, 0.4)]
    assert_allclose(G1, np.minimum(expected, 1), rtol=1e-8)
    assert np.all((G1 >= 0) & (G1 <= 1))
    assert np.all(np.diff(G1) <= 1e-15)


@pytest.mark.parametrize(("alpha", "p"), LOBES)
def test_smith_at_and_below_the_horizon_is_zero_with_finite_gradients(alpha, p):
    w = jnp.array([[1.0, 0.0, 0.0], [0.6, 0.0, -0.8], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    value = evaluate(jb.smith_G1, jb.ShiftedGamma(alpha, p), w)
    assert_array_equal(value[:3], 0)
    assert_allclose(value[3], 1, rtol=1e-15)
    for gradient in gradients(alpha, p, w):
        assert np.all(np.isfinite(gradient))


def test_uncorrelated_is_the_product_of_both_maskings():
    ndf = jb.ShiftedGamma(jnp.array([0.1, 0.3]), 0.5)
    wi, wo = W, W[::-1]
    G = evaluate(jb.Uncorrelated(), ndf, wi, wo)
    assert G.shape == (len(THETA), 2)
    density = references.sgd(0.3, 0.5)
    masks = np.array([w[2] / references.projected_area(density, w) for w in references.direction(THETA, 0.4)])
    assert_allclose(G[:, 1], masks * masks[::-1], rtol=1e-8)


def approximation(lam, c, k):
    return jb.ShiftedGammaShadowing(jnp.array(lam), jnp.array(c), jnp.array(k))


@pytest.mark.parametrize(
    ("lam", "c", "k"),
    [(2.60672, 1.12717e-07, 47.783), (1.5, 0.8, 5.57), MIRROR_LIKE, (1.5e7, 3e-8, 12.0), (4.5e-8, 5e3, 20.0)],
    ids=["alum-bronze", "rough", "mirror-like", "large lambda", "small lambda"],
)
def test_approximation_is_equation_9_in_50_digits(lam, c, k):
    shadowing = approximation(lam, c, k)
    truth = [references.mask_approximation(t, lam, c, k) for t in THETA]
    assert_allclose(shadowing.theta_0, truth[0][1], rtol=1e-12)
    value = shadowing.G1(jnp.asarray(np.cos(THETA)))
    assert_allclose(value, [g for g, _ in truth], rtol=1e-9, atol=3e-7)
    assert np.all((value >= 0) & (value <= 1))


@pytest.mark.parametrize("parameters", [(2.6, 1e-7, 47.8), MIRROR_LIKE], ids=["bronze", "mirror-like"])
def test_approximation_at_its_seams(parameters):
    """0 at and below the horizon, 1 up to θ_0, and finite gradients at each, and at the normal."""
    shadowing = approximation(*parameters)
    at_theta_0 = jnp.cos(shadowing.theta_0)
    cos = jnp.stack([jnp.array(0.0), jnp.array(-0.5), at_theta_0, jnp.array(1.0), at_theta_0 * 0.999])
    value = shadowing.G1(cos)
    assert_array_equal(value[:2], 0)
    assert_allclose(value[2:4], 1, atol=1e-12)
    for leaf in jax.tree.leaves(jax.jit(jax.jacrev(lambda s, x: s.G1(x), (0, 1)))(shadowing, cos)):
        assert np.all(np.isfinite(leaf))


def test_approximation_multiplies_both_directions_and_does_not_ask_the_distribution():
    shadowing = approximation(2.6, 1e-7, 47.8)
    G = shadowing(jb.ShiftedGamma(0.5, 0.5), W[3], W[4])
    one, other = (references.mask_approximation(t, 2.6, 1e-7, 47.8)[0] for t in THETA[3:5])
    assert_allclose(G, one * other, rtol=1e-10)


def test_approximation_is_close_to_smith_for_a_published_material():
    """alum-bronze, red: the paper's fit of eq. 9 to G1 stays within 1e-2 up to 85°, as its Fig. 5 shows."""
    theta = np.linspace(0, np.deg2rad(85), 18)
    w = jb.spherical(jnp.asarray(theta), 0.0)
    smith = evaluate(jb.smith_G1, jb.ShiftedGamma(0.014832, 0.459076), w)
    approximate = approximation(2.60672, 1.12717e-07, 47.783).G1(w[:, 2])
    assert_allclose(approximate, smith, atol=1e-2)
