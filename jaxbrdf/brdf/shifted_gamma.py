"""The reflectance of Bagher, Soler & Holzschuch 2012."""

from jaxbrdf.arrays import POSITIVE, Domain, Parameter, Range, parameter
from jaxbrdf.brdf.base import AbstractBRDF, AbstractSum
from jaxbrdf.brdf.cook_torrance import CookTorrance
from jaxbrdf.fresnel import LinearSchlick
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.shifted_gamma import ShiftedGamma
from jaxbrdf.ndf.tabulated_area import tabulate_projected_area
from jaxbrdf.shadowing import AbstractShadowing, Uncorrelated


class ShiftedGammaBRDF(AbstractSum):
    r"""Cook–Torrance with the shifted gamma distribution and the linear Schlick term: 6 numbers a channel.

        f(wi, wo) = ρ_d / π + ρ_s / π · F(θ_d; F_0, F_1) D(h; α, p) G(wi, wo) / (cos θ_i cos θ_o)

    Bagher et al. 2012, eq. 1, 8 and 11. The masking is the exact one of Smith by default; give
    `shadowing=ShiftedGammaShadowing(lam, c, k)` for the paper's approximation.
    """

    rho_d: Parameter = parameter(linear=True)
    rho_s: Parameter = parameter(linear=True)
    alpha: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-5, 2.0, log=True))
    p: Parameter = parameter(domain=Domain(0.0, 50.0), fitted=Range(0.0, 3.0))
    f0: Parameter = parameter(fitted=Range(0.0, 1.0))
    f1: Parameter = parameter(fitted=Range(-1.0, 1.0))
    shadowing: AbstractShadowing = Uncorrelated()

    @property
    def parts(self) -> tuple[AbstractBRDF, ...]:
        return self.as_cook_torrance(self.ndf).parts

    @property
    def ndf(self) -> ShiftedGamma:
        """The distribution of facets, ShiftedGamma(alpha, p)."""
        return ShiftedGamma(self.alpha, self.p)

    @property
    def fresnel(self) -> LinearSchlick:
        """How much a facet reflects, LinearSchlick(f0, f1)."""
        return LinearSchlick(self.f0, self.f1)

    def tabulated(self) -> CookTorrance:
        return self.as_cook_torrance(tabulate_projected_area(self.ndf))

    def as_cook_torrance(self, ndf: AbstractNDF) -> CookTorrance:
        """The same reflectance over another distribution."""
        return CookTorrance(self.rho_d, self.rho_s, ndf, self.fresnel, self.shadowing)
