"""Sun's reflectance of rough metals, as usual and as printed."""

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Parameter, Range, parameter, per_channel
from jaxbrdf.brdf.base import AbstractBRDF, AbstractSum, both_above
from jaxbrdf.brdf.microfacet import Microfacet
from jaxbrdf.directions import Direction, as_directions, cos_theta, dot, half_vector, same_rank
from jaxbrdf.fresnel import AbstractFresnel
from jaxbrdf.ndf.beckmann import Beckmann
from jaxbrdf.shadowing import FreeTravel
from jaxbrdf.special import safe_divide


class RoughMetal(AbstractSum):
    r"""A metal surface of Gaussian heights: `Microfacet(Beckmann(2 / s), fresnel, FreeTravel(s))`.

        f(wi, wo) = F(θ_d) s² exp(−s² tan²θ_h / 4) Γ_0(θ_i) Γ_0(θ_o) / (16 π cos⁴θ_h cos θ_i cos θ_o)

    Sun 2002, section 3, made a usual reflectance: his own ρ, `as_printed`, is another
    quantity. `smoothness` s = τ/σ > 0 is the correlation length of the heights over their rms, else
    ValueError; `fresnel` is the metal's, such as `Conductor(eta, kappa)`.
    """

    smoothness: Parameter = parameter(domain=POSITIVE, fitted=Range(0.5, 1e3, log=True))
    fresnel: AbstractFresnel  # type: ignore[misc]  # `parameter()` is no default: both are required

    @property
    def parts(self) -> tuple[AbstractBRDF, ...]:
        return (Microfacet(self.ndf, self.fresnel, FreeTravel(self.smoothness)),)

    @property
    def ndf(self) -> Beckmann:
        """The distribution of facets, Beckmann(2 / s): slopes of standard deviation √2 σ/τ (eq. 3.3.8)."""
        return Beckmann(2 / self.smoothness)

    def as_printed(self, wi: ArrayLike, wo: ArrayLike) -> Float[Array, "..."]:
        r"""ρ(wi, wo) of Sun 2002, eq. 3.5.3; (...), or (..., C).

            ρ = F(θ_d) s² exp(−s² tan²θ_h / 4) Γ_0(θ_i) Γ_0(θ_o) / (16 π cos³θ_h cos θ_d)
              = f cos θ_i · cos θ_h cos θ_o / cos θ_d

        The paper's dL_o = ρ L_i dω_i has no cosine (eq. 3.2.1), and its eq. 3.2.2 weighs facets by their
        share of the base plane, not by the area they show to wi and wo: hence the second factor. 0 where
        either direction is at or below the horizon. Raises ValueError for directions that are not unit
        vectors.
        """
        wi, wo = same_rank(as_directions(wi, "wi"), as_directions(wo, "wo"))
        return per_channel(RoughMetal._printed)(self, wi, wo)

    def _printed(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        h = half_vector(wi, wo)
        F, D, G = self.fresnel(dot(wi, h)), self.ndf(h), FreeTravel(self.smoothness)(self.ndf, wi, wo)
        rho = safe_divide(F * D * G * cos_theta(h), 4 * dot(wi, h))
        return jnp.where(both_above(wi, wo), rho, 0)
