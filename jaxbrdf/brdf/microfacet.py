"""Mirror facets: the reflectance of any distribution, Fresnel and shadowing term."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.brdf.base import AbstractBRDF, both_above, cosine_product
from jaxbrdf.directions import Direction, cos_theta, dot, half_vector, reflect
from jaxbrdf.fresnel import AbstractFresnel
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.shadowing import AbstractShadowing, Uncorrelated
from jaxbrdf.special import safe_divide


class Microfacet(AbstractBRDF):
    r"""A surface of mirror facets:

        f(wi, wo) = F(θ_d) D(h) G(wi, wo) / (4 cos θ_i cos θ_o),   h = (wi + wo) / ‖wi + wo‖

    Torrance & Sparrow 1967; Walter et al. 2007, eq. 20. Smith's shadowing with independent heights unless
    another is given. Sampled by mirroring wo at a facet that its distribution draws for wo.
    """

    ndf: AbstractNDF
    fresnel: AbstractFresnel
    shadowing: AbstractShadowing = Uncorrelated()

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        h = half_vector(wi, wo)
        D = self.ndf(h)
        F = self.fresnel(dot(wi, h))
        G = self.shadowing(self.ndf, wi, wo)
        return jnp.where(both_above(wi, wo), F * D * G / (4 * cosine_product(wi, wo)), 0)

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        return sample_mirrored(self.ndf, u, wo)

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return mirrored_density(self.ndf, wi, wo)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return typical_reflectance(self.fresnel, wo)


def sample_mirrored(ndf: AbstractNDF, u: Float[Array, "... 2"], wo: Direction) -> Direction:
    """wo mirrored at a facet drawn for it."""
    return reflect(wo, ndf.sample_facing(u, wo))


def mirrored_density(ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """The density of `sample_mirrored`: that of the facet h over dω_i / dω_h = 4 (wo·h)."""
    h = half_vector(wi, wo)
    return safe_divide(ndf.facing_density(h, wo), 4 * dot(wo, h))


def typical_reflectance(fresnel: AbstractFresnel, wo: Direction) -> Float[Array, "..."]:
    """A mean of |F| over what facets may see: at θ_o, where most do, and at four angles besides."""
    others = fresnel(jnp.array([0.1, 0.4, 0.7, 1.0], wo.dtype))
    return (jnp.abs(fresnel(cos_theta(wo))) + jnp.mean(jnp.abs(others))) / 2
