"""The reflectance of facets whose distribution, Fresnel term and masking are tables, of no given form."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import NON_NEGATIVE, Parameter, parameter
from jaxbrdf.brdf.base import AbstractBRDF, AbstractSum, both_above, cosine_product
from jaxbrdf.brdf.lambertian import Lambertian
from jaxbrdf.directions import Direction, cos_theta, dot, half_vector, reflect, to_spherical
from jaxbrdf.special import safe_arccos, safe_divide, safe_sqrt


def _table() -> Any:
    return parameter(rank=1, domain=NON_NEGATIVE)


class FreeFormBRDF(AbstractSum):
    r"""A diffuse term and one lobe of facets whose three factors are free functions of one angle each.

        f(wi, wo) = ρ_d / π + D(θ_h) F(θ_d) G1(θ_i) G1(θ_o) / (4 cos θ_i cos θ_o)

    Bagher, Snyder & Nowrouzezahrai 2016, with the 1/4 of `Microfacet`. `D` (H,) in 1/sr, `F` (E,) and `G1`
    (K,) ≥ 0 are piecewise linear between the nodes `theta_h`, `theta_d` and `theta` (radians, ascending) and
    constant beyond them; any of the tables and `rho_d` may carry one trailing axis of channels. Only the
    product means anything: `fitting.fit_factors` scales D to ∫ D cos θ dω = 1 and G1 to 1 at the normal.

    Sampled by half vectors drawn from D, and like a diffuse surface, in shares of the light of each part.
    """

    rho_d: Parameter = parameter(linear=True)
    theta_h: Parameter = _table()
    D: Parameter = _table()
    theta_d: Parameter = _table()
    F: Parameter = _table()
    theta: Parameter = _table()
    G1: Parameter = _table()

    @property
    def parts(self) -> tuple[AbstractBRDF, ...]:
        lobe = _Lobe(self.theta_h, self.D, self.theta_d, self.F, self.theta, self.G1)
        return Lambertian(self.rho_d), lobe


class _Lobe(AbstractBRDF):
    """The second term alone."""

    theta_h: Parameter = _table()
    D: Parameter = _table()
    theta_d: Parameter = _table()
    F: Parameter = _table()
    theta: Parameter = _table()
    G1: Parameter = _table()

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        h = half_vector(wi, wo)
        D = jnp.interp(to_spherical(h)[0], self.theta_h, self.D)
        F = jnp.interp(safe_arccos(dot(wi, h)), self.theta_d, self.F)
        G = self._masking(wi) * self._masking(wo)
        return jnp.where(both_above(wi, wo), D * F * G / (4 * cosine_product(wi, wo)), 0)

    def _masking(self, w: Direction) -> Float[Array, "..."]:
        """G1."""
        return jnp.interp(to_spherical(w)[0], self.theta, self.G1)

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        """wo mirrored at a half vector, of density ∝ D cos θ_h, D being the mean of each interval's ends."""
        sin2, cumulative = self._cumulative()
        s, phi = jnp.interp(u[..., 0], cumulative, sin2), 2 * jnp.pi * u[..., 1]
        sin = safe_sqrt(s)
        h = jnp.stack([sin * jnp.cos(phi), sin * jnp.sin(phi), safe_sqrt(1 - s)], axis=-1)
        return reflect(wo, h)

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        h = half_vector(wi, wo)
        sin2, cumulative = self._cumulative()
        interval = jnp.searchsorted(sin2, h[..., 0] ** 2 + h[..., 1] ** 2, side="right") - 1
        interval = jnp.clip(interval, 0, len(sin2) - 2)
        density = safe_divide(jnp.diff(cumulative), jnp.diff(sin2))[interval] * cos_theta(h) / jnp.pi
        return safe_divide(density, 4 * dot(wo, h))

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        """F where most facets meet the light, at θ_o, and its mean besides."""
        F = jnp.interp(to_spherical(wo)[0], self.theta_d, self.F)
        return (F + jnp.mean(self.F)) / 2 * jnp.sign(jnp.max(self.D))

    def _cumulative(self) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
        """sin²θ at 0, at the nodes and at π/2, and the probability of a smaller one; even without facets."""
        D = jnp.concatenate([self.D[:1], self.D, self.D[-1:]])
        ends = jnp.array([0, jnp.pi / 2], self.theta_h.dtype)
        sin2 = jnp.sin(jnp.concatenate([ends[:1], self.theta_h, ends[1:]])) ** 2
        share = (D[1:] + D[:-1]) * jnp.diff(sin2)
        share = jnp.where(jnp.sum(share) > 0, share, jnp.diff(sin2))
        cumulative = jnp.concatenate([jnp.zeros(1, D.dtype), jnp.cumsum(share)])
        return sin2, cumulative / cumulative[-1]
