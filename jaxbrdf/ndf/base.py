r"""What a normal distribution function (NDF) knows, and the projected area of an isotropic one.

An NDF is a density D(m) of facet normals m over solid angle, with ∫ D(m) (m·n) dm = 1 (signed). Its
*projected area* seen from w, σ(w) = ∫ (w·m)+ D(m) dm, is all that shadowing needs to know.
"""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import in_chunks, per_channel
from jaxbrdf.directions import Direction, cos_theta
from jaxbrdf.special import fold, gauss_legendre


class AbstractNDF(eqx.Module):
    """A distribution of facet normals: its density, its projected area, and how to draw from it.

    Directions are (..., 3); results are (...), or (..., C) where parameters carry C channels.
    """

    @abstractmethod
    def __call__(self, m: Direction) -> Float[Array, "..."]:
        """D(m), 1/sr; 0 for m below the horizon unless the distribution says otherwise."""

    @abstractmethod
    def projected_area(self, w: Direction) -> Float[Array, "..."]:
        """σ(w) = ∫ (w·m)+ D(m) dm, per unit of macro-surface. Never clipped: σ(w) ≥ (w·n)+."""

    @abstractmethod
    def sample(self, u: Float[Array, "... 2"]) -> Float[Array, "..."]:
        """A normal m with density D(m) (m·n), from u in [0, 1)²: (..., 2) to (..., 3), or (..., 3, C)."""


class AbstractIsotropicNDF(AbstractNDF):
    r"""A distribution of the polar angle alone, given by its slope density P22(x), x = tan²θ.

        D(m) = P22(tan²θ) / cos⁴θ above the horizon, 0 at and below it;   ∫_0^∞ P22(x) dx = 1/π
        σ(θ) = cos θ (1 + Λ(θ)),   Λ(θ) = ∫_{cot²θ}^∞ P22(x) (s − arctan s) dx,   s = √(x tan²θ − 1)

    Bagher et al. 2012, eq. 2 and 6, Brown's and Bourlier's double integral done once by hand. A
    distribution of this kind is one formula, `slope_density`, and two scales that place the nodes.
    """

    @abstractmethod
    def slope_density(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """P22(x) at x = tan²θ; parameters are scalars here."""

    @abstractmethod
    def slope_scales(self) -> tuple[Array, Array]:
        """(core, reach): the slopes tan θ below which P22 is flat and beyond which it is negligible."""

    @per_channel
    def __call__(self, m: Direction) -> Float[Array, "..."]:
        above = cos_theta(m) > jnp.finfo(m.dtype).tiny ** 0.25  # where 1 / cos⁴ is still a number
        sin2 = m[..., 0] ** 2 + m[..., 1] ** 2  # 1 − cos² would lose the digits that a sharp peak needs
        tan2 = jnp.where(above, sin2, 0) / jnp.where(above, cos_theta(m), 1) ** 2
        return jnp.where(above, self.slope_density(tan2) * (1 + tan2) ** 2, 0)

    @per_channel
    def projected_area(self, w: Direction) -> Float[Array, "..."]:
        return in_chunks(self._projected_area, cos_theta(w))

    def _projected_area(self, cos_w: Float[Array, ""]) -> Float[Array, ""]:
        """The integral above with cos θ · s = B sinh q, B² = cos²θ + core² sin²θ, and q ∝ r^{3/2}.

        sinh follows P22 through its decades; r^{3/2} gathers nodes where s − arctan s starts like s³.
        Below the horizon σ(−w) = σ(w) − w·n.
        """
        cos, below = fold(cos_w)
        core, reach = self.slope_scales()
        r, weights = gauss_legendre(48, cos_w.dtype)
        cos2 = cos**2
        sin2 = jnp.maximum(1 - cos2, 1e-12)  # towards the normal P22 is 0 before this matters
        B2 = cos2 + core**2 * sin2
        q_max = jnp.arcsinh(reach * jnp.sqrt(sin2 / B2))
        q, dq = q_max * r**1.5, q_max * (1.5 * r**0.5 * weights)
        s_cos = jnp.sqrt(B2) * jnp.sinh(q)
        dx_dq = jnp.sinh(2 * q) * B2 / sin2
        bracket = s_cos - cos * jnp.arctan2(s_cos, cos)
        integrand = self.slope_density((cos2 + s_cos**2) / sin2) * bracket * dx_dq
        return below + cos + jnp.sum(dq * integrand)
