"""The exponential distribution of radio-wave scattering."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Parameter, Range, parameter
from jaxbrdf.directions import Direction
from jaxbrdf.ndf.base import AbstractIsotropicNDF, from_slopes
from jaxbrdf.special import safe_sqrt


class Exponential(AbstractIsotropicNDF):
    r"""Exponential distribution: sharper at the peak and longer in the tail than Beckmann's.

        D(m) = P22(tan²θ) / cos⁴θ,   P22(x) = exp(−√x/α) / (2π α²)

    Brown 1980; Bagher et al. 2012, Table 1. The peak is a cusp: at the normal the gradient by direction is
    stated as 0. `alpha` > 0, the scale of tan θ; raises ValueError otherwise.
    """

    alpha: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-3, 2.0, log=True))

    def slope_density(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """P22(x) at x = tan²θ."""
        return jnp.exp(-safe_sqrt(x) / self.alpha) / (2 * jnp.pi * self.alpha**2)

    def slope_scales(self) -> tuple[Array, Array]:
        return self.alpha, 40 * self.alpha

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        """1 − F = (1 + y) e^{−y}, y = tan θ / α: its logarithm is concave, so Newton's steps from the right
        approach the root monotonically; φ = 2π u_2."""
        target = jnp.log1p(-u[..., 0])
        start = jnp.sqrt(-2 * target) - target + 1e-12

        def newton(y, _):
            return y + (jnp.log1p(y) - y - target) * (1 + y) / y, None

        y, _ = jax.lax.scan(newton, start, None, length=12)
        phi = 2 * jnp.pi * u[..., 1]
        return from_slopes(self.alpha * y * jnp.cos(phi), self.alpha * y * jnp.sin(phi))
