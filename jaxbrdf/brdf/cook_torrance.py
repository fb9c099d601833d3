"""Cook–Torrance reflectance over any distribution, Fresnel and shadowing term."""

import jax.numpy as jnp

from jaxbrdf.arrays import Parameter, parameter
from jaxbrdf.brdf.base import AbstractBRDF, AbstractSum, Scaled
from jaxbrdf.brdf.lambertian import Lambertian
from jaxbrdf.brdf.microfacet import Microfacet
from jaxbrdf.fresnel import AbstractFresnel
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.shadowing import AbstractShadowing, Uncorrelated


class CookTorrance(AbstractSum):
    r"""A diffuse term and one lobe of mirror facets, in the normalisation of Bagher et al. 2012, eq. 1:

        f(wi, wo) = ρ_d / π + ρ_s / π · F(θ_d) D(h) G(wi, wo) / (cos θ_i cos θ_o)

    Mind the 1/π where the microfacet theory has 1/4 (see `Microfacet`): published ρ_s belong to this form,
    which reflects 4/π times the light of its facets.
    """

    rho_d: Parameter = parameter(linear=True)
    rho_s: Parameter = parameter(linear=True)
    ndf: AbstractNDF  # type: ignore[misc]  # `parameter()` is no default: all four are required
    fresnel: AbstractFresnel  # type: ignore[misc]
    shadowing: AbstractShadowing = Uncorrelated()

    @property
    def parts(self) -> tuple[AbstractBRDF, ...]:
        facets = Microfacet(self.ndf, self.fresnel, self.shadowing)
        return Lambertian(self.rho_d), Scaled(self.rho_s * (4 / jnp.pi), facets)
