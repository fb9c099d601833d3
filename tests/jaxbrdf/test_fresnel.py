"""The Fresnel terms: values at the ends, the printed formula, channels and gradients."""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose

import jaxbrdf as jb

COS = np.linspace(0, 1, 11)


def test_at_grazing_everything_is_reflected():
    """F(π/2) = 1 whatever the parameters, published negative F(0) included."""
    f0, f1 = jnp.array([0.04, 0.9, 6.05524, 0.1]), jnp.array([0.0, -0.3, 5.05524, 0.4])
    assert_allclose(jb.LinearSchlick(f0, f1)(jnp.array(0.0)), 1, atol=1e-15)


def test_at_normal_incidence_it_is_f0_less_f1():
    assert_allclose(jb.LinearSchlick(0.1, 0.4)(jnp.array(1.0)), -0.3, atol=1e-15)


def test_without_slope_it_is_schlicks():
    r = 0.04
    assert_allclose(
        jb.LinearSchlick(r, 0.0)(jnp.asarray(COS)), [r + (1 - r) * (1 - c) ** 5 for c in COS], rtol=1e-14
    )


def test_the_printed_formula_and_its_derivatives():
    f0, f1 = 0.7, 0.25
    assert_allclose(
        jb.LinearSchlick(f0, f1)(jnp.asarray(COS)),
        [f0 + (1 - f0) * (1 - np.cos(t)) ** 5 - f1 * np.cos(t) for t in np.arccos(COS)],
        atol=1e-14,
    )
    by_f0, by_f1 = jax.jacfwd(lambda a, b: jb.LinearSchlick(a, b)(jnp.asarray(COS)), (0, 1))(f0, f1)
    assert_allclose(by_f0, 1 - (1 - COS) ** 5, atol=1e-14)
    assert_allclose(by_f1, -COS, atol=1e-14)


def test_channels_trail_and_precision_is_kept():
    F = jb.LinearSchlick(jnp.array([0.1, 0.2, 0.3], jnp.float32), jnp.array(0.05, jnp.float32))
    value = F(jnp.asarray(COS, jnp.float32))
    assert value.shape == (11, 3)
    assert value.dtype == jnp.float32
    assert_allclose(value[-1], [0.05, 0.15, 0.25], rtol=1e-5)
