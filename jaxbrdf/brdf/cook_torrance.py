"""Cook–Torrance reflectance over any distribution, Fresnel and shadowing term."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import Parameter, parameter
from jaxbrdf.brdf.base import AbstractBRDF, both_above, cosine_product
from jaxbrdf.directions import Direction, dot, half_vector
from jaxbrdf.fresnel import AbstractFresnel
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.shadowing import AbstractShadowing, Uncorrelated


class CookTorrance(AbstractBRDF):
    r"""A diffuse term and one lobe of mirror facets, in the normalisation of Bagher et al. 2012, eq. 1:

        f(wi, wo) = ρ_d / π + ρ_s / π · F(θ_d) D(h) G(wi, wo) / (cos θ_i cos θ_o)

    Mind the 1/π where the microfacet theory has 1/4: published ρ_s belong to this form.
    """

    rho_d: Parameter = parameter()
    rho_s: Parameter = parameter()
    ndf: AbstractNDF  # type: ignore[misc]  # `parameter()` is no default: all four are required
    fresnel: AbstractFresnel  # type: ignore[misc]
    shadowing: AbstractShadowing = Uncorrelated()

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        h = half_vector(wi, wo)
        D = self.ndf(h)
        F = self.fresnel(dot(wi, h))
        G = self.shadowing(self.ndf, wi, wo)
        f = (self.rho_d + self.rho_s * F * D * G / cosine_product(wi, wo)) / jnp.pi
        return jnp.where(both_above(wi, wo), f, 0)
