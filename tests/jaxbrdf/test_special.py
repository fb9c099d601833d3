"""Incomplete gamma against mpmath, and what the safe functions give at the points they exist for."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.special
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from jaxbrdf import special
from tests import references

S = [-3.0, -2.0, -1.999999, -1.3, -1.0, -0.5, -1e-9, 0.0, 1e-9, 0.3, 0.541, 1.0]
X = [1e-6, 1e-5, 1e-3, 0.1, 0.9, 1.0, 7.0, 50.0]
WIDE_S = [-50.0, -20.5, -7.0, 2.5, 10.0, 50.0]
WIDE_X = [1e-6, 1e-3, 1.0, 30.0, 100.0]


def truth(s, x):
    return np.moveaxis(np.array([[references.log_upper_gamma(a, b) for b in x] for a in s]), -1, 0)


@jax.jit
def log_gamma_and_gradients(s, x):
    """log Γ and both its derivatives on the grid of s and x, each (S, X)."""
    s, x = jnp.meshgrid(s, x, indexing="ij")
    value, gradient = jax.vmap(jax.value_and_grad(special.log_upper_gamma, (0, 1)))(s.ravel(), x.ravel())
    return tuple(a.reshape(s.shape) for a in (value, *gradient))


@pytest.mark.parametrize(("s", "x"), [(S, X), (WIDE_S, WIDE_X)], ids=["optics", "wide"])
def test_log_upper_gamma_and_both_derivatives_are_mpmaths(s, x):
    value, by_s, by_x = log_gamma_and_gradients(jnp.array(s), jnp.array(x))
    log_gamma, true_by_s, true_by_x = truth(s, x)
    assert_allclose(value, log_gamma, rtol=0, atol=1e-12)  # absolute in the logarithm: relative in Γ
    assert_allclose(by_s, true_by_s, rtol=1e-10, atol=1e-12)
    assert_allclose(by_x, true_by_x, rtol=1e-10)


def test_upper_gamma_and_its_gradient():
    s, x = (jnp.asarray(a.ravel()) for a in np.meshgrid(S, X, indexing="ij"))
    value, (by_s, by_x) = jax.jit(jax.vmap(jax.value_and_grad(special.upper_gamma, (0, 1))))(s, x)
    log_gamma, dlog_ds, dlog_dx = (a.ravel() for a in truth(S, X))
    assert_allclose(value, np.exp(log_gamma), rtol=1e-12)
    assert_allclose(by_s, np.exp(log_gamma) * dlog_ds, rtol=1e-10, atol=1e-300)
    assert_allclose(by_x, np.exp(log_gamma) * dlog_dx, rtol=1e-10)


def test_reverse_mode_and_jacobians_of_jacobians_agree_with_forward_mode():
    s, x = jnp.array([-1.5, 0.0, 0.7]), jnp.array([1e-5, 0.2, 3.0])

    def total(s, x):
        return jnp.sum(special.log_upper_gamma(s, x))

    forward = jax.jit(jax.jacfwd(jax.jacfwd(total, 1), 0))(s, x)
    assert_allclose(
        np.asarray(forward), np.asarray(jax.jit(jax.jacfwd(jax.grad(total, 1), 0))(s, x)), rtol=1e-12
    )
    step = 1e-5
    _, _, up = log_gamma_and_gradients(s + step, x)
    _, _, down = log_gamma_and_gradients(s - step, x)
    assert_allclose(np.diag(forward), np.diag((up - down) / (2 * step)), rtol=1e-6)


def test_it_neither_overflows_nor_underflows():
    assert_allclose(
        special.log_upper_gamma(jnp.array([-60.0, 0.5]), jnp.array([1e-12, 2000.0])),
        [references.log_upper_gamma(-60.0, 1e-12)[0], references.log_upper_gamma(0.5, 2000.0)[0]],
        rtol=1e-13,
    )


@pytest.mark.parametrize("x", [0.0, -1.0, np.nan])
def test_outside_its_domain_it_is_nan(x):
    assert np.isnan(special.upper_gamma(jnp.array(0.5), jnp.array(x)))


def test_float32_stays_float32():
    s, x = jnp.array([-0.8, 0.5], jnp.float32), jnp.array([1e-5, 0.3], jnp.float32)
    value = special.log_upper_gamma(s, x)
    assert value.dtype == jnp.float32
    true = [references.log_upper_gamma(float(a), float(b))[0] for a, b in zip(s, x, strict=True)]
    assert_allclose(value, true, atol=2e-5)


@settings(deadline=None, max_examples=60)
@given(s=st.floats(-20, 20), x=st.floats(1e-6, 100))
def test_recurrence(s, x):
    """Γ(s+1, x) = s Γ(s, x) + x^s e^{−x}, to the rounding of its largest term."""
    terms = np.asarray(special.log_upper_gamma(jnp.array([s + 1, s]), jnp.array([x, x])))
    power = s * np.log(x) - x
    largest = max(*terms, power)
    upper, lower, power = np.exp(terms[0] - largest), np.exp(terms[1] - largest), np.exp(power - largest)
    assert abs(upper - s * lower - power) < 1e-11 * max(1, abs(s))


@settings(deadline=None, max_examples=40)
@given(s=st.floats(-10, 10), x=st.floats(1e-5, 80), factor=st.floats(1.0001, 3))
def test_it_falls_with_x_and_its_logarithm_is_concave_in_log_x(s, x, factor):
    """What Newton's method in ShiftedGamma.sample rests on."""
    log_x = np.log(x) + np.log(factor) * np.arange(3)
    a, b, c = np.asarray(special.log_upper_gamma(jnp.full(3, s), jnp.exp(log_x)))
    rounding = 1e-12 * (1 + abs(b))
    assert a > b - rounding
    assert b > c - rounding
    assert a - 2 * b + c < 1e-10 * (1 + abs(b))


SAFE = [  # function, arguments, value, gradient by the first argument
    ("sqrt of nothing", special.safe_sqrt, (0.0,), 0.0, 0.0),
    ("sqrt of a rounding error", special.safe_sqrt, (-1e-17,), 0.0, 0.0),
    ("sqrt", special.safe_sqrt, (4.0,), 2.0, 0.25),
    ("hypot at the origin", special.safe_hypot, (0.0, 0.0), 0.0, 0.0),
    ("hypot", special.safe_hypot, (3.0, 4.0), 5.0, 0.6),
    ("arctan2 at the origin", special.safe_arctan2, (0.0, 0.0), 0.0, 0.0),
    ("arctan2 behind", special.safe_arctan2, (0.0, -2.0), np.pi, -0.5),
    ("arctan2", special.safe_arctan2, (1.0, 1.0), np.pi / 4, 0.5),
    ("arccos of 1", special.safe_arccos, (1.0,), 0.0, 0.0),
    ("arccos of -1", special.safe_arccos, (-1.0,), np.pi, 0.0),
    ("arccos beyond 1", special.safe_arccos, (1 + 1e-15,), 0.0, 0.0),
    ("arccos", special.safe_arccos, (0.5,), np.pi / 3, -2 / np.sqrt(3)),
    ("division by zero", special.safe_divide, (3.0, 0.0), 0.0, 0.0),
    ("division", special.safe_divide, (3.0, 2.0), 1.5, 0.5),
]


@pytest.mark.parametrize(
    ("function", "arguments", "value", "gradient"), [c[1:] for c in SAFE], ids=[c[0] for c in SAFE]
)
def test_safe_functions_give_their_stated_values_and_gradients(function, arguments, value, gradient):
    assert_allclose(function(*map(jnp.array, arguments)), value, rtol=1e-14)
    gradients = jax.grad(function, tuple(range(len(arguments))))(*map(jnp.array, arguments))
    assert_allclose(gradients[0], gradient, rtol=1e-14)
    assert np.all(np.isfinite(gradients))


@pytest.mark.parametrize(
    ("x", "value", "gradient"), [(-2.0, (2, -2), (-1, 1)), (0.0, (0, 0), (1, 0)), (3.0, (3, 0), (1, 0))]
)
def test_fold_has_the_gradient_of_one_side(x, value, gradient):
    assert_allclose(special.fold(jnp.array(x)), value)
    assert_allclose(jax.jacfwd(special.fold)(jnp.array(x)), gradient)


def test_gauss_legendre_integrates_polynomials_over_the_unit_interval():
    nodes, weights = special.gauss_legendre(5)
    powers = np.arange(10)  # exact to degree 2 n − 1
    assert_allclose(weights @ nodes[:, None] ** powers, 1 / (powers + 1), rtol=1e-14)


@pytest.mark.parametrize(
    ("x", "y", "value", "gradient"),
    [
        (0.5, 3.0, 0.125, (0.75, 0.125 * np.log(0.5))),
        (1e-30, 5.5, 1e-165, (5.5e-135, 1e-165 * np.log(1e-30))),
        (0.0, 5.5, 0.0, (0, 0)),
        (-1e-16, 5.5, 0.0, (0, 0)),
    ],
)
def test_safe_power(x, y, value, gradient):
    assert_allclose(special.safe_power(jnp.array(x), jnp.array(y)), value, rtol=1e-14)
    assert_allclose(jax.grad(special.safe_power, (0, 1))(x, y), gradient, rtol=1e-13)


@pytest.mark.parametrize(
    ("x", "y"), [(3.0, 4.0), (-3.0, 4.0), (0.0, 2.0), (1.0, 1e-12), (-1.0, 1e-12), (2.0, 0.0), (-2.0, 0.0)]
)
def test_complex_sqrt_and_its_gradient(x, y):
    """Against the principal root; at y = 0 the derivatives are those from y > 0."""
    root = np.sqrt(complex(x, y))
    assert_allclose(special.complex_sqrt(jnp.array(x), jnp.array(y)), (root.real, root.imag), rtol=1e-14)
    slope = 1 / (2 * root)  # d√z/dz; by x it is this, by y it is i times this
    by_x, by_y = jnp.array(jax.jacfwd(special.complex_sqrt, (0, 1))(x, y)).T
    assert_allclose(by_x, (slope.real, slope.imag), rtol=1e-12, atol=1e-15)
    assert_allclose(by_y, (-slope.imag, slope.real), rtol=1e-12, atol=1e-15)


def test_complex_sqrt_of_zero_has_no_slope():
    assert_array_equal(special.complex_sqrt(jnp.array(0.0), jnp.array(0.0)), [0, 0])
    assert_array_equal(jnp.array(jax.jacfwd(special.complex_sqrt, (0, 1))(0.0, 0.0)), np.zeros((2, 2)))


def test_the_step_of_log_gamma_keeps_its_digits():
    """log Γ(x + ½) − log Γ(x) by 40 digits, where lgamma's difference would have lost them; and its slope."""
    x = np.array([1e-3, 0.5, 1.0, 9.0, 12.5, 4e2, 5e5, 1e12])
    with mpmath.workdps(40):
        step = [float(mpmath.loggamma(mpmath.mpf(a) + 0.5) - mpmath.loggamma(a)) for a in x]
        slope = [float(mpmath.digamma(mpmath.mpf(a) + 0.5) - mpmath.digamma(a)) for a in x]
    assert_allclose(special.log_gamma_step(jnp.asarray(x)), step, rtol=2e-14, atol=1e-14)
    assert_allclose(jax.vmap(jax.grad(special.log_gamma_step))(jnp.asarray(x)), slope, rtol=1e-11)
    single = special.log_gamma_step(jnp.asarray(x, jnp.float32))
    assert_allclose(single, step, rtol=1e-6, atol=1e-6)


def test_the_inverse_error_function_is_finite_at_its_ends():
    x = jnp.array([-1.0, -0.5, 0.0, 0.9, 1.0])
    value, slope = jax.vmap(jax.value_and_grad(special.safe_erf_inv))(x)
    assert_allclose(scipy.special.erf(value), x, atol=1e-15)
    assert np.all(np.isfinite(value))
    assert np.all(np.isfinite(slope))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_arctan2_is_numpys(dtype):
    """All quadrants, ratios from 1e-9 to 1e9, within three units in the last place; zeros; slopes."""
    rng = np.random.default_rng(6)
    y, x = (rng.normal(size=(2, 20000)) * 10 ** rng.uniform(-9, 0, (2, 20000))).astype(dtype)
    true = np.arctan2(y.astype(np.longdouble), x.astype(np.longdouble))
    found = np.asarray(jax.jit(special.arctan2)(y, x))
    assert found.dtype == dtype
    assert np.max(np.abs(found - true) / np.spacing(np.abs(true).astype(dtype))) < 3
    ends = np.array(
        [[0, 1], [-0.0, 1], [0, -1], [-0.0, -1], [1, 0], [-1, 0], [0, 0], [1, 1], [-1, -1]], dtype
    ).T
    assert_allclose(special.arctan2(*ends), np.arctan2(*ends), rtol=3e-7)
    assert_array_equal(np.signbit(special.arctan2(*ends)), np.signbit(np.arctan2(*ends)))
    assert np.isnan(special.arctan2(np.array(np.nan, dtype), np.array(1, dtype)))
    by_y, by_x = jax.vmap(jax.grad(special.arctan2, (0, 1)))(jnp.array(y), jnp.array(x))
    square = x.astype(float) ** 2 + y.astype(float) ** 2
    assert_allclose(by_y, x / square, rtol=1e-6)
    assert_allclose(by_x, -y / square, rtol=1e-6)
