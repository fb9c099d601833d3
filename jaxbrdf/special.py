r"""Functions that JAX lacks, or has without a finite gradient at the points that optics visits.

The safe_* functions give a singular point a stated value and a gradient of zero. They use the double
`where`: the argument is made harmless before the function sees it, so that no NaN enters a derivative.
"""

import math
from functools import lru_cache, partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

_SQRT_PI = math.sqrt(math.pi)


def safe_sqrt(x):
    """√x for x > 0; 0 with gradient 0 for x ≤ 0 (where rounding put it); NaN stays NaN."""
    nothing = x <= 0
    return jnp.where(nothing, 0, jnp.sqrt(jnp.where(nothing, 1, x)))


def safe_hypot(x, y):
    """√(x² + y²), with gradient 0 at the origin."""
    return safe_sqrt(x * x + y * y)


def safe_arctan2(y, x):
    """arctan2(y, x); 0 with gradient 0 at the origin."""
    away = (x != 0) | (y != 0)
    return arctan2(jnp.where(away, y, 0), jnp.where(away, x, 1))


@jax.custom_jvp
def arctan2(y, x):
    r"""The angle of (x, y) in [−π, π], to 3 units in the last place, in plain arithmetic that XLA vectorises.

        arctan r = r / (1 + u / (3 + 4u / (5 + 9u / (7 + …)))),   u = r²   (Gauss)

    of r = the smaller of |x| and |y| over the larger, turned by π/4 where r exceeds tan π/8.
    """
    y, x = jnp.broadcast_arrays(y, x)
    large, small = jnp.maximum(jnp.abs(x), jnp.abs(y)), jnp.minimum(jnp.abs(x), jnp.abs(y))
    steep = small > _TAN_EIGHTH * large
    above, below = jnp.where(steep, small - large, small), jnp.where(steep, small + large, large)
    r = above / jnp.where(below == 0, 1, below)
    over, under = (_horner(c, r * r) for c in _arctan_fraction(12 if r.dtype == jnp.float64 else 5))
    angle = r * over / under + jnp.where(steep, jnp.pi / 4, 0)
    angle = jnp.where(jnp.abs(y) > jnp.abs(x), jnp.pi / 2 - angle, angle)
    return jnp.copysign(jnp.where(jnp.signbit(x), jnp.pi - angle, angle), y)


@arctan2.defjvp
def _arctan2_jvp(primals, tangents):
    (y, x), (y_dot, x_dot) = primals, tangents
    return arctan2(y, x), (x * y_dot - y * x_dot) / (x * x + y * y)


_TAN_EIGHTH = math.tan(math.pi / 8)


@lru_cache
def _arctan_fraction(depth: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The continued fraction cut off at `depth`, as two polynomials in u, highest power first."""
    polynomial = np.polynomial.Polynomial
    under, over = [polynomial([1.0]), polynomial([1.0])], [polynomial([0.0]), polynomial([1.0])]
    for k in range(1, depth + 1):
        for p in (under, over):
            p.append((2 * k + 1) * p[-1] + polynomial([0, k**2]) * p[-2])
    scale = under[-1].coef[0]
    return tuple((over[-1].coef[::-1] / scale).tolist()), tuple((under[-1].coef[::-1] / scale).tolist())


def _horner(coefficients, x):
    return reduce(lambda p, c: p * x + c, coefficients)


def safe_arccos(x):
    """arccos x; 0 for x ≥ 1 and π for x ≤ −1, with gradient 0 there."""
    inside = jnp.abs(x) < 1
    return jnp.where(inside, jnp.arccos(jnp.where(inside, x, 0)), jnp.where(x > 0, 0, jnp.pi))


def safe_divide(a, b):
    """a / b; 0 with gradient 0 where b = 0."""
    divisible = b != 0
    return jnp.where(divisible, a / jnp.where(divisible, b, 1), 0)


def safe_erf_inv(x):
    """erf⁻¹ x; at ±1, where it is infinite, its value at the next number within."""
    end = 1 - jnp.finfo(x.dtype).epsneg
    return jax.lax.erf_inv(jnp.clip(x, -end, end))


def log1p_over(x):
    """log(1 + x) / x for x ≥ 0; 1 with gradient 0 at x = 0."""
    positive = x > 0
    return jnp.where(positive, jnp.log1p(x) / jnp.where(positive, x, 1), 1)


def fold(x):
    """(|x|, min(x, 0)), with the gradients of x > 0 at x = 0: one side's, where JAX would mix the two."""
    positive = x >= 0
    return jnp.where(positive, x, -x), jnp.where(positive, 0, x)


@lru_cache
def gauss_legendre(n: int, dtype: Any = np.float64) -> tuple[np.ndarray, np.ndarray]:
    """n Gauss–Legendre nodes in (0, 1) and their weights, which sum to 1; as numpy arrays of `dtype`."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return ((nodes + 1) / 2).astype(dtype), (weights / 2).astype(dtype)


ORDER = 6  # nodes of a local polynomial
_LAGRANGE = np.linalg.inv(np.vander(np.arange(ORDER) - (ORDER - 1) / 2, increasing=True).T)


def lagrange_stencil(
    position: Float[Array, "..."], count: int, periodic: bool = False
) -> tuple[Int[Array, "... order"], Float[Array, "... order"]]:
    """The six of `count` evenly spaced nodes around a position in [0, count − 1], and their Lagrange weights.

    Σ weight · value is the polynomial of degree 5 through them, at the position; one-sided at the ends,
    unless the nodes are `periodic`: then any position will do, and node `count` is node 0.
    """
    first = jnp.floor(position).astype(int) - (ORDER // 2 - 1)
    if not periodic:
        first = jnp.clip(first, 0, count - ORDER)
    x = position - first - (ORDER - 1) / 2
    nodes = jnp.stack([first + k for k in range(ORDER)], axis=-1)
    return nodes % count, jnp.stack([polynomial(c, x) for c in _LAGRANGE], axis=-1)


def polynomial(coefficients, x):
    """Σ c_k x^k by Horner's rule."""
    return reduce(lambda value, c: value * x + float(c), coefficients[::-1][1:], float(coefficients[-1]))


@lru_cache
def exponential_nodes(dtype: Any = np.float64) -> tuple[np.ndarray, np.ndarray]:
    r"""Some 56 nodes t and weights of ∫_0^∞ e^{−t} f(t) dt, f growing at most like a power of t.

    The double exponential rule t = exp(y − e^{−y}), evenly spaced in y (Takahasi & Mori 1974): nodes crowd at
    t = 0 through all decades, so f may start like √t or 1/√t, or change there on any scale: 1/√(t + b) to
    3e-9 relative whatever b, and to 1e-15 from b = 0.1 on or for b = 0. They begin where a few times t is
    still a number and √t is nothing beside 1.
    """
    y = np.arange(-4.4, 3.8, 0.15)
    y = y[y - np.exp(-y) > 4 * np.log(np.finfo(dtype).eps)]
    t = np.exp(y - np.exp(-y))
    return t.astype(dtype), (0.15 * t * (1 + np.exp(-y)) * np.exp(-t)).astype(dtype)


@jax.custom_jvp
def gaussian_ramp(z: Float[Array, "..."], r: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""⟨(z + r X)+⟩ over a Gaussian X of variance ½, r ≥ 0: z+ rounded off over a width r.

        z (1 + erf(z/r)) / 2 + r e^{−(z/r)²} / (2√π);   by z: (1 + erf(z/r)) / 2,   by r: e^{−(z/r)²} / (2√π)

    At r = 0 it is max(z, 0), with the derivatives' limits (½ and 1/(2√π) at z = r = 0).
    """
    a = _ratio(z, r)
    return z * (1 + jax.lax.erf(a)) / 2 + r * jnp.exp(-(a**2)) / (2 * _SQRT_PI)


@gaussian_ramp.defjvp
def _gaussian_ramp_jvp(primals, tangents):
    z, r = primals
    z_dot, r_dot = tangents
    a = _ratio(z, r)
    slope = (1 + jax.lax.erf(a)) / 2 * z_dot + jnp.exp(-(a**2)) / (2 * _SQRT_PI) * r_dot
    return gaussian_ramp(z, r), slope


def _ratio(z, r):
    """z / r; at r = 0 a number beyond which nothing changes, of the sign of z."""
    return jnp.where(r > 0, z / jnp.where(r > 0, r, 1), 1e4 * jnp.sign(z))


def log_gamma_step(x):
    r"""log Γ(x + ½) − log Γ(x) for x > 0, where the difference of the two would lose its digits.

    −Σ_{k<12} log(1 + ½ / (x + k)), and from x + 12 on the series ½ log x − 1/(8x) + 1/(192x³) − 1/(640x⁵) +
    17/(14336x⁷) − 31/(18432x⁹), to 1e-14 (DLMF 5.11.8 twice).
    """
    steps = sum(jnp.log1p(0.5 / (x + k)) for k in range(12))
    y = x + 12
    v = y**-2
    series = -1 / 8 + v * (1 / 192 - v * (1 / 640 - v * (17 / 14336 - v * 31 / 18432)))
    return jnp.log(y) / 2 + series / y - steps


def student_ramp(z: Float[Array, ""], r: Float[Array, ""], gamma: Float[Array, ""]) -> Float[Array, ""]:
    r"""⟨(z + r X)+⟩ over X of Student's density c (1 + x²)^{1/2 − γ}, c = Γ(γ−½) / (√π Γ(γ−1)), r ≥ 0.

        max(z, 0) − |z| Q + c k^{2γ−2} √(z² + r²) / (2γ − 3),   k² = r² / (z² + r²)
        Q = c ∫_{|z|/r}^∞ (1 + x²)^{1/2 − γ} dx = c k^{2γ−2} / (2γ−2) ∫_0^∞ e^{−t} dt / √(1 − k² e^{−t/(γ−1)})

    At r = 0 it is max(z, 0). For γ ≤ 3/2, where ⟨|X|⟩ is infinite, so is the ramp.
    """
    height, below = fold(z)
    t, weights = exponential_nodes(z.dtype)
    rounded = r > jnp.finfo(z.dtype).tiny ** 0.25
    r = jnp.where(rounded, r, 1)
    log_k2 = -jnp.log1p((height / r) ** 2)
    c = jnp.exp(log_gamma_step(gamma - 1)) / _SQRT_PI
    share = c * jnp.exp((gamma - 1) * log_k2)
    root = jnp.sqrt(-jnp.expm1(log_k2 - t / (gamma - 1)))
    Q = share * jnp.sum(weights / root) / (2 * gamma - 2)
    finite = gamma > 1.5
    rest = share * jnp.sqrt(height**2 + r**2) / jnp.where(finite, 2 * gamma - 3, 1)
    rounding = jnp.where(finite, rest - height * Q, jnp.inf)
    return height + below + jnp.where(rounded, rounding, 0)


def upper_gamma(s: Float[Array, "..."], x: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""Upper incomplete gamma function Γ(s, x) = ∫_x^∞ t^{s−1} e^{−t} dt, s any real number, x > 0.

    jax.scipy.special.gammaincc stops at s > 0. Differentiable in both arguments. Shapes broadcast.
    NaN where x ≤ 0. Relative error below 1e-12 in float64 for s in [−50, 50] and x in [1e-6, 100].
    DLMF 8.2.2.
    """
    return jnp.exp(log_upper_gamma(s, x))


@jax.custom_jvp
def log_upper_gamma(s: Float[Array, "..."], x: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""log Γ(s, x) for any real s and x > 0, safe where Γ itself would over- or underflow.

        Γ(s, x) = x^s e^{−x} ∫_0^∞ exp(ψ(v)) dv,   ψ(v) = s v − x (e^v − 1)     (t = x e^v)
        ∂ log Γ/∂s = ⟨log t⟩,   ∂ log Γ/∂x = −x^{s−1} e^{−x} / Γ(s, x)

    ψ is concave, so the integrand has one bump, and Gauss–Legendre covers what lies within e^−40 of
    its top; the mean of log t is taken over the same nodes. Nothing cancels.
    """
    return _log_gamma_and_mean_log(s, x)[0]


@log_upper_gamma.defjvp
def _log_upper_gamma_jvp(primals, tangents):
    s, x = primals
    s_dot, x_dot = tangents
    log_gamma, mean_log = _log_gamma_and_mean_log(s, x)
    slope = -jnp.exp((s - 1) * jnp.log(x) - x - log_gamma)
    return log_gamma, mean_log * s_dot + slope * x_dot


@jax.jit
@partial(jnp.vectorize, signature="(),()->(),()")
def _log_gamma_and_mean_log(s, x):
    s, x = (jnp.asarray(a, jnp.result_type(float, s, x)) for a in (s, x))
    top, lower, upper = (jax.lax.stop_gradient(v) for v in _bump(s, x))
    nodes, weights = gauss_legendre(64, x.dtype)
    v = lower + (upper - lower) * nodes
    height = _exponent(s, x, top)
    bump = weights * jnp.exp(_exponent(s, x, v) - height)
    total = jnp.sum(bump)
    log_gamma = s * jnp.log(x) - x + height + jnp.log((upper - lower) * total)
    return log_gamma, jnp.log(x) + jnp.sum(bump * v) / total


def _exponent(s, x, v):
    return s * v - x * jnp.expm1(v)


def _bump(s, x, depth: float = 40.0):
    """Where ψ is largest on v ≥ 0, and the interval of v ≥ 0 on which ψ is within `depth` of that."""
    top = jnp.log(jnp.maximum(s, x) / x)
    height = _exponent(s, x, top)

    def newton(v, _):
        return v - (_exponent(s, x, v) - height + depth) / (s - x * jnp.exp(v)), None

    # ψ is concave: Newton's steps from outside the interval approach its ends monotonically.
    scale = jnp.maximum(s, x)
    right = jnp.log((scale + depth + jnp.sqrt(2 * depth * scale)) / x)
    left = top - depth / scale - 1
    upper, _ = jax.lax.scan(newton, jnp.maximum(right, top + depth / (depth + scale)), None, length=10)
    lower, _ = jax.lax.scan(newton, left, None, length=10)
    return top, jnp.maximum(jnp.where(s > x, lower, 0), 0), upper


def safe_power(x, y):
    """x^y for x > 0; 0 with gradient 0, by y too, for x ≤ 0 (where rounding put it)."""
    positive = x > 0
    return jnp.where(positive, jnp.where(positive, x, 1) ** y, 0)


def complex_sqrt(x, y):
    """Real and imaginary part of √(x + iy) for y ≥ 0, both ≥ 0; 0 and 0 with gradient 0 at the origin.

    The larger part comes from a sum, the smaller from the larger, so that neither loses digits; at y = 0,
    where the smaller part vanishes, its derivative by y is the limit's.
    """
    size, _ = fold(x)
    large = safe_sqrt((safe_hypot(x, y) + size) / 2)
    small = safe_divide(y, 2 * large)
    return jnp.where(x >= 0, large, small), jnp.where(x >= 0, small, large)
