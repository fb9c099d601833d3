"""The perfectly diffuse reflectance."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import Parameter, parameter
from jaxbrdf.brdf.base import AbstractBRDF, both_above
from jaxbrdf.directions import Direction


class Lambertian(AbstractBRDF):
    """f = ρ / π: the same radiance in every direction. `albedo` ρ in [0, 1] (Lambert 1760)."""

    albedo: Parameter = parameter(linear=True)

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return jnp.where(both_above(wi, wo), self.albedo / jnp.pi, 0)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return jnp.broadcast_to(jnp.abs(self.albedo), wo.shape[:-1])
