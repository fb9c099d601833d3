"""The Beckmann distribution: facets of a surface with Gaussian slopes."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Parameter, Range, parameter
from jaxbrdf.directions import Direction
from jaxbrdf.ndf.base import AbstractVisibleNDF, from_slopes, one_each, slopes
from jaxbrdf.special import gaussian_ramp, safe_divide, safe_erf_inv, safe_hypot, safe_sqrt


class Beckmann(AbstractVisibleNDF):
    r"""Beckmann distribution, iso- or anisotropic: Gaussian in the facets' slopes.

        D(m) = exp(−(t_x²/α_x² + t_y²/α_y²)) / (π α_x α_y cos⁴θ),   t_x = m_x/m_z, t_y = m_y/m_z
        σ(w) = w_z (1 + erf a)/2 + r e^{−a²}/(2√π),   r = √(α_x² w_x² + α_y² w_y²),   a = w_z / r

    Beckmann & Spizzichino 1963; Bagher et al. 2012, Table 1; σ by Smith 1967 in the form of Heitz 2014,
    eq. 65 and 84. `alpha_x`, `alpha_y` > 0 are √2 times the slopes' standard deviations along x and y;
    without `alpha_y` the distribution is isotropic. Raises ValueError for other values.
    """

    closed_form_area = True

    alpha_x: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-3, 3.0, log=True))
    alpha_y: Parameter | None = parameter(domain=POSITIVE, optional=True, fitted=Range(1e-3, 3.0, log=True))

    @property
    def is_isotropic(self) -> bool:
        return self.alpha_y is None

    @property
    def alphas(self) -> tuple[Parameter, Parameter]:
        """(α_x, α_y), which are one where the distribution is isotropic."""
        return self.alpha_x, self.alpha_x if self.alpha_y is None else self.alpha_y

    def _density(self, m: Direction) -> Float[Array, "..."]:
        t_x, t_y, above = slopes(m)
        alpha_x, alpha_y = self.alphas
        exponent = 2 * jnp.log1p(t_x**2 + t_y**2) - (t_x / alpha_x) ** 2 - (t_y / alpha_y) ** 2
        return jnp.where(above, jnp.exp(exponent) / (jnp.pi * alpha_x * alpha_y), 0)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        alpha_x, alpha_y = self.alphas
        return gaussian_ramp(w[..., 2], safe_hypot(alpha_x * w[..., 0], alpha_y * w[..., 1]))

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        r, phi = safe_sqrt(-jnp.log1p(-u[..., 0])), 2 * jnp.pi * u[..., 1]
        alpha_x, alpha_y = self.alphas
        return from_slopes(alpha_x * r * jnp.cos(phi), alpha_y * r * jnp.sin(phi))

    def _sample_visible(self, u: Float[Array, "... 2"], w: Direction) -> Direction:
        r"""Heitz & d'Eon 2014, section 3: with slopes in units of α, the one along w, s, is drawn from the
        density ∝ (w_z + r s)+ e^{−s²}, the one across it is Gaussian."""
        alpha_x, alpha_y = self.alphas
        w = one_each(u, w)
        w_x, w_y = alpha_x * w[..., 0], alpha_y * w[..., 1]
        r = safe_hypot(w_x, w_y)
        along = visible_slope(1 - u[..., 0], w[..., 2], r)
        across = safe_erf_inv(2 * u[..., 1] - 1)
        x, y = jnp.where(r > 0, safe_divide(w_x, r), 1), safe_divide(w_y, r)
        return from_slopes(alpha_x * (along * x - across * y), alpha_y * (along * y + across * x))


def visible_slope(
    survival: Float[Array, "..."], z: Float[Array, "..."], r: Float[Array, "..."]
) -> Float[Array, "..."]:
    r"""The s at which the density ∝ (z + r s)+ e^{−s²} has `survival` of its mass above it.

        T(s) = z erfc(s)/2 + r e^{−s²}/(2√π) = survival · σ,   σ = T(−z/r)

    T falls from s = −z/r on: bisection finds the root, and Newton's step there gives it its derivatives.
    """
    target = survival * gaussian_ramp(z, r)
    low = jnp.clip(-safe_divide(z, r), -6.5, 1e3)
    low = jnp.where(r > 0, low, -6.5)

    def tail(s):
        return z * jax.lax.erfc(s) / 2 + r * jnp.exp(-(s**2)) / (2 * jnp.sqrt(jnp.pi))

    def halve(bracket, _):
        low, high = bracket
        middle = (low + high) / 2
        above = tail(middle) > target
        return (jnp.where(above, middle, low), jnp.where(above, high, middle)), None

    bracket, _ = jax.lax.scan(halve, (low, jnp.maximum(low, 0) + 6.5), None, length=50)
    s = jax.lax.stop_gradient((bracket[0] + bracket[1]) / 2)
    slope = (z + r * s) * jnp.exp(-(s**2)) / jnp.sqrt(jnp.pi)
    step = safe_divide(tail(s) - target, jax.lax.stop_gradient(slope))
    return s + step - jax.lax.stop_gradient(step)
