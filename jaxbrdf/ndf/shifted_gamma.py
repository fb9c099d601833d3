"""The shifted gamma distribution (SGD) of Bagher, Soler & Holzschuch 2012."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Domain, Parameter, Range, in_chunks, parameter
from jaxbrdf.directions import Direction, spherical
from jaxbrdf.ndf.base import AbstractIsotropicNDF
from jaxbrdf.ndf.trowbridge_reitz import TrowbridgeReitz
from jaxbrdf.special import log_upper_gamma, safe_sqrt


class ShiftedGamma(AbstractIsotropicNDF):
    r"""Shifted gamma distribution: a power law near the normal, an exponential tail far from it.

        D(m) = P22(tan²θ) / cos⁴θ,   P22(x) = α^{p−1} / (π Γ(1−p, α)) · exp(−(α² + x)/α) / (α² + x)^p

    Bagher et al. 2012, section 4.2, with ∫_0^∞ P22 dx = 1/π (the paper prints ∫ = 1). `alpha` > 0 is
    the roughness (published fits: 2e-5 to 0.9), `p` ≥ 0 how fast the peak falls (0 to 1.8). p = 0 is an
    exponential in x, the Beckmann distribution of roughness √α. Its projected area has no closed form:
    it is an integral, to 1e-9 of 1 + Λ. Raises ValueError unless alpha > 0 and p lies in [0, 50].
    """

    alpha: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-5, 2.0, log=True))
    p: Parameter = parameter(domain=Domain(0.0, 50.0), fitted=Range(0.0, 3.0))

    def slope_density(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """P22(x) at x = tan²θ."""
        alpha, p = self.alpha, self.p
        log_K = (p - 1) * jnp.log(alpha) - alpha - log_upper_gamma(1 - p, alpha)
        return jnp.exp(log_K - x / alpha - p * jnp.log(alpha**2 + x)) / jnp.pi

    def slope_scales(self) -> tuple[Array, Array]:
        return self.alpha, jnp.sqrt(30 * self.alpha)

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        r"""Exact: tan²θ solves 1 − F(θ) = Γ(1−p, α + tan²θ/α) / Γ(1−p, α) = u_1 (section 4.5), φ = 2π u_2.

        No closed form of the inverse exists; log Γ(1−p, e^v) is concave in v, so Newton's method on it
        approaches the root monotonically.
        """
        x = in_chunks(self._inverse_survival, 1 - u[..., 0], size=4096)
        return spherical(jnp.arctan(safe_sqrt(x)), 2 * jnp.pi * u[..., 1])

    def sample_facing(self, u: Float[Array, "... 2"], w: Direction) -> Direction:
        """Visible normals of `_proposal`: they take no root for each u, and none faces away from w."""
        return self._proposal().sample_facing(u, w)

    def facing_density(self, m: Direction, w: Direction) -> Float[Array, "..."]:
        return self._proposal().facing_density(m, w)

    def _proposal(self) -> TrowbridgeReitz:
        """Trowbridge–Reitz (GGX, as in Bagher et al. 2012, section 4.5) of the same median slope.

        The paper takes its alpha to be this alpha, which is the width of the peak: of a sharp lobe, most of
        whose facets are in the tail of slopes √α, the samples then miss nearly all.
        """
        return TrowbridgeReitz(jnp.sqrt(self._inverse_survival(jnp.asarray(0.5, self.alpha.dtype))))

    def _inverse_survival(self, survival):
        alpha, s = self.alpha, 1 - self.p
        target = log_upper_gamma(s, alpha) + jnp.log(survival)
        v_min, v_max = jnp.log(alpha), jnp.log(alpha + 60)

        def newton(v, _):
            log_gamma = log_upper_gamma(s, jnp.exp(v))
            slope = -jnp.exp(s * v - jnp.exp(v) - log_gamma)
            return jnp.clip(v - (log_gamma - target) / slope, v_min, v_max), None

        v, _ = jax.lax.scan(newton, jnp.full_like(survival, v_max), None, length=24)
        return alpha * (jnp.exp(v) - alpha)
