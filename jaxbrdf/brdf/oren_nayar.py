"""The reflectance of rough matte surfaces."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import NON_NEGATIVE, POSITIVE, Parameter, Range, parameter
from jaxbrdf.brdf.base import AbstractBRDF, both_above
from jaxbrdf.directions import Direction, cos_theta


class OrenNayar(AbstractBRDF):
    r"""Diffuse V-grooves: brighter than Lambert's law towards the light and at the rim.

        f(wi, wo) = ρ/π (A + B max(0, cos(φ_i − φ_o)) sin α tan β),   α = max(θ_i, θ_o), β = min(θ_i, θ_o)
        A = 1 − σ² / (2 (σ² + constant)),   B = 0.45 σ² / (σ² + 0.09)

    Oren & Nayar 1994, "Generalization of Lambert's reflectance model", the simplified form. `sigma` σ ≥ 0,
    radians, is the standard deviation of the grooves' slope angle; 0 is `Lambertian`. `constant` > 0 is 0.57,
    which makes up for the interreflection that this form leaves out; 0.33 is the original. Raises ValueError
    for other values of both.

    The albedo is ρ (A + B g), g rising from 0 at normal to 1/2 at grazing incidence: at oblique incidence it
    exceeds ρ, for σ < 0.55 and by up to 4.5 % with 0.57, for σ < 0.33 and by up to 1.6 % with 0.33. f has no
    bound where both directions graze.
    """

    albedo: Parameter = parameter(linear=True)
    sigma: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(0.0, 1.5))
    constant: Parameter = parameter(domain=POSITIVE, default=0.57)

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        """cos(φ_i − φ_o) sin α tan β is the dot product of the tangential parts over the larger cosine."""
        sigma2 = self.sigma**2
        A = 1 - sigma2 / (2 * (sigma2 + self.constant))
        B = 0.45 * sigma2 / (sigma2 + 0.09)
        above = both_above(wi, wo)
        tangential = wi[..., 0] * wo[..., 0] + wi[..., 1] * wo[..., 1]
        larger_cos = jnp.where(above, jnp.maximum(cos_theta(wi), cos_theta(wo)), 1)
        retro = jnp.maximum(tangential, 0) / larger_cos
        return jnp.where(above, self.albedo / jnp.pi * (A + B * retro), 0)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return jnp.broadcast_to(jnp.abs(self.albedo), wo.shape[:-1])
