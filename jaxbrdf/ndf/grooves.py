"""Grooves: a surface of two kinds of facets that lean against each other."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Domain, Parameter, parameter
from jaxbrdf.directions import NORMAL, Direction, rotate_y
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.gaussian_microfacets import GaussianMicrofacets


class VGrooves(AbstractNDF):
    r"""V-shaped grooves along y whose sides are tilted by ± angle, each rough with a Gaussian of width σ.

        D(m) = (D_G(R_y(−angle) m) + D_G(R_y(angle) m)) / (2 cos angle),   and σ(w) likewise

    D_G being `GaussianMicrofacets(sigma)`; Ashikhmin et al. 2000, section 6.2 (40°, σ = 0.1). The rougher
    facets of a steep side reach below the horizon, where D is what it is. Each side is drawn as n sees it.
    `angle` in [0, π/2) radians, `sigma` > 0; raises ValueError otherwise.
    """

    angle: Parameter = parameter(domain=Domain(0.0, 1.57))
    sigma: Parameter = parameter(domain=POSITIVE)

    @property
    def is_isotropic(self) -> bool:
        return False

    def _density(self, m: Direction) -> Float[Array, "..."]:
        return self._both_sides(GaussianMicrofacets(self.sigma)._density, m)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        return self._both_sides(GaussianMicrofacets(self.sigma)._projected_area, w)

    def _both_sides(self, function, w: Direction) -> Float[Array, "..."]:
        turned = function(rotate_y(w, -self.angle)) + function(rotate_y(w, self.angle))
        return turned / (2 * jnp.cos(self.angle))

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        angle = jnp.where(u[..., 0] < 0.5, self.angle, -self.angle)
        n = jnp.broadcast_to(jnp.array(NORMAL, u.dtype), (*u.shape[:-1], 3))
        rest = jnp.stack([2 * u[..., 0] % 1, u[..., 1]], axis=-1)
        return rotate_y(GaussianMicrofacets(self.sigma)._sample_visible(rest, rotate_y(n, -angle)), angle)
