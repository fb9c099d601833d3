"""How much of the surface both directions see: small functions of an NDF's projected area."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import Parameter, parameter, per_channel
from jaxbrdf.directions import Direction, cos_theta
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.special import safe_arccos, safe_divide


class AbstractShadowing(eqx.Module):
    """A shadowing and masking term: called with (ndf, wi, wo), gives G (...) in [0, 1]."""

    @abstractmethod
    def __call__(self, ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        """G(wi, wo), the fraction of facets that both directions see."""


def smith_G1(ndf: AbstractNDF, w: Direction) -> Float[Array, "..."]:
    """Smith's masking G1(w) = min(1, (w·n)+ / σ(w)), 0 below the horizon; (...), or (..., C)."""
    sigma = ndf.projected_area(w)
    cos_w = jnp.maximum(cos_theta(w), 0)
    return jnp.minimum(1, safe_divide(cos_w.reshape(cos_w.shape + (1,) * (sigma.ndim - cos_w.ndim)), sigma))


class Uncorrelated(AbstractShadowing):
    """Smith's shadowing with independent heights: G = G1(wi) G1(wo) (Bagher 2012, section 3.2)."""

    def __call__(self, ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return smith_G1(ndf, wi) * smith_G1(ndf, wo)


class ShiftedGammaShadowing(AbstractShadowing):
    r"""Bagher's closed approximation of the shifted gamma distribution's masking; the NDF is not asked.

        G1(θ) = 1 + λ (1 − exp(c (θ − θ_0)^k))   for θ > θ_0, else 1
        θ_0 = π/2 − (log(1 + 1/λ) / c)^{1/k},   so that G1(π/2) = 0;   G = G1(wi) G1(wo)

    Bagher et al. 2012, eq. 9. `lam`, `c`, `k` > 0; published c reach 1e109 with k in the hundreds, so
    c (θ − θ_0)^k is computed as an exponential. `fitting.fit_masking` finds the three for an NDF.
    """

    lam: Parameter = parameter()
    c: Parameter = parameter()
    k: Parameter = parameter()

    @per_channel
    def __call__(self, ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return self.G1(cos_theta(wi)) * self.G1(cos_theta(wo))

    @property
    def theta_0(self) -> Float[Array, "..."]:
        """θ_0, the angle up to which nothing is masked; negative for rough materials."""
        return jnp.pi / 2 - jnp.exp((jnp.log(jnp.log1p(1 / self.lam)) - jnp.log(self.c)) / self.k)

    def G1(self, cos_w: Float[Array, "..."]) -> Float[Array, "..."]:
        """Masking towards a direction at polar cosine cos_w."""
        beyond = safe_arccos(cos_w) - self.theta_0
        masked = (beyond > 0) & (cos_w > 0)
        exponent = jnp.log(self.c) + self.k * jnp.log(jnp.where(masked, beyond, 1))
        growth = jnp.exp(jnp.where(masked, exponent, 0))
        return jnp.where(cos_w > 0, jnp.where(masked, 1 - self.lam * jnp.expm1(growth), 1), 0)
