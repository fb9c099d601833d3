r"""What a normal distribution function (NDF) knows, and the projected area of an isotropic one.

An NDF is a density D(m) of facet normals m over solid angle, with ∫ D(m) (m·n) dm = 1 (signed). Its
*projected area* seen from w, σ(w) = ∫ (w·m)+ D(m) dm, is all that shadowing needs to know.

A distribution is written as three formulas for scalar parameters, `_density`, `_projected_area` and
`_sample`; the classes here check directions and serve channels.
"""

from abc import abstractmethod
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from jaxbrdf.arrays import Parametric, in_chunks, per_channel
from jaxbrdf.directions import (
    NORMAL,
    Direction,
    above_horizon,
    as_directions,
    as_floats,
    cos_theta,
    dot,
    safe_normalize,
)
from jaxbrdf.special import fold, gauss_legendre, safe_divide


class AbstractNDF(Parametric):
    """A distribution of facet normals: its density, its projected area, and how to draw from it.

    Directions are (..., 3); results are (...), or (..., C) where parameters carry C channels. Raises
    ValueError for directions that are not unit vectors (outside jit, where their values are at hand).
    """

    closed_form_area: ClassVar[bool] = False  # whether σ(w) is as cheap as D(m): a table then gains nothing

    def __call__(self, m: ArrayLike) -> Float[Array, "..."]:
        """D(m), 1/sr; 0 for m at and below the horizon unless the distribution says otherwise."""
        return per_channel(type(self)._density)(self, as_directions(m, "m"))

    def projected_area(self, w: ArrayLike) -> Float[Array, "..."]:
        """σ(w) = ∫ (w·m)+ D(m) dm, per unit of macro-surface; never clipped."""
        return per_channel(type(self)._projected_area)(self, as_directions(w, "w"))

    def sample(self, u: ArrayLike) -> Float[Array, "..."]:
        """A normal m of density D(m) (m·n)+ / σ(n), from u in [0, 1)²: (..., 2) to (..., 3), or (..., 3, C).

        σ(n) = 1 where no facet looks below the horizon.
        """
        return per_channel(type(self)._sample)(self, as_floats(u, "u", "points of [0, 1)²", 2))

    def sample_facing(self, u: Float[Array, "... 2"], w: Direction) -> Direction:
        """A normal worth drawing for light that leaves along w, for each u and w; these have one shape.

        For scalar parameters: what a reflectance is sampled by. The plain normals of `sample`, unless the
        distribution knows better; then some may face away from w.
        """
        return self._sample(u)

    def facing_density(self, m: Direction, w: Direction) -> Float[Array, "..."]:
        """The density of `sample_facing`, 1/sr."""
        n = jnp.array(NORMAL, m.dtype)
        return self._density(m) * jnp.maximum(cos_theta(m), 0) / self._projected_area(n)

    @classmethod
    def guesses(
        cls, m: Float[np.ndarray, "K 3"], D: Float[np.ndarray, " K"], weight: Float[np.ndarray, " K"]
    ) -> "list[AbstractNDF]":
        """Distributions of the class near a measured one, for a fit to start from; none unless it knows some.

        D in 1/sr was measured at the normals m; `weight` is in proportion to what each stands for.
        """
        return []

    @property
    @abstractmethod
    def is_isotropic(self) -> bool:
        """Whether D depends on the polar angle alone."""

    @abstractmethod
    def _density(self, m: Direction) -> Float[Array, "..."]:
        """D(m)."""

    @abstractmethod
    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        """σ(w)."""

    @abstractmethod
    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        """A normal for each u."""


class AbstractVisibleNDF(AbstractNDF):
    """A distribution that also draws the normals that a direction sees."""

    def sample_visible(self, u: ArrayLike, w: ArrayLike) -> Float[Array, "..."]:
        """A normal m of density (w·m)+ D(m) / σ(w), from u in [0, 1)², (..., 2), and w (..., 3), broadcast.

        The result is (..., 3), or (..., 3, C).
        """
        u, w = as_floats(u, "u", "points of [0, 1)²", 2), as_directions(w, "w")
        shape = jnp.broadcast_shapes(u.shape[:-1], w.shape[:-1])
        u = jnp.broadcast_to(u, (*shape, 2))
        w = w if w.ndim == 1 else jnp.broadcast_to(w, (*shape, 3))
        return per_channel(type(self)._sample_visible)(self, u, w)

    def sample_facing(self, u: Float[Array, "... 2"], w: Direction) -> Direction:
        return self._sample_visible(u, w)

    def facing_density(self, m: Direction, w: Direction) -> Float[Array, "..."]:
        return safe_divide(self._density(m) * jnp.maximum(dot(w, m), 0), self._projected_area(w))

    @abstractmethod
    def _sample_visible(self, u: Float[Array, "... 2"], w: Direction) -> Direction:
        """A normal for each u, as w sees them: w has the leading shape of u, or is one direction for all."""


class AbstractIsotropicNDF(AbstractNDF):
    r"""A distribution of the polar angle alone, given by its slope density P22(x), x = tan²θ.

        D(m) = P22(tan²θ) / cos⁴θ above the horizon, 0 at and below it;   ∫_0^∞ P22(x) dx = 1/π
        σ(θ) = cos θ (1 + Λ(θ)),   Λ(θ) = ∫_{cot²θ}^∞ P22(x) (s − arctan s) dx,   s = √(x tan²θ − 1)

    Bagher et al. 2012, eq. 2 and 6, Brown's and Bourlier's double integral done once by hand. A
    distribution of this kind is one formula, `slope_density`, two scales that place the nodes, and `_sample`.
    """

    @property
    def is_isotropic(self) -> bool:
        return True

    @abstractmethod
    def slope_density(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """P22(x) at x = tan²θ; parameters are scalars here."""

    @abstractmethod
    def slope_scales(self) -> tuple[Array, Array]:
        """(core, reach): the slopes tan θ below which P22 is flat and beyond which it is negligible."""

    def _density(self, m: Direction) -> Float[Array, "..."]:
        t_x, t_y, above = slopes(m)
        tan2 = t_x**2 + t_y**2
        return jnp.where(above, self.slope_density(tan2) * (1 + tan2) ** 2, 0)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        return in_chunks(self._area_at, cos_theta(w))

    def _area_at(self, cos_w: Float[Array, ""]) -> Float[Array, ""]:
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


def one_each(u: Float[Array, "... 2"], w: Direction) -> Direction:
    """w for each u, (..., 3)."""
    return jnp.broadcast_to(w, (*u.shape[:-1], 3))


def slopes(m: Direction) -> tuple[Float[Array, "..."], Float[Array, "..."], Bool[Array, "..."]]:
    """(m_x/m_z, m_y/m_z, above): 0, 0 and False for m at or below the horizon.

    tan²θ from these keeps the digits of a sharp peak that 1 − cos²θ would lose.
    """
    above = above_horizon(cos_theta(m))
    cos = jnp.where(above, cos_theta(m), 1)
    return jnp.where(above, m[..., 0], 0) / cos, jnp.where(above, m[..., 1], 0) / cos, above


def from_slopes(t_x: Float[Array, "..."], t_y: Float[Array, "..."]) -> Direction:
    """The normal (t_x, t_y, 1) / √(1 + t_x² + t_y²): undoes `slopes`."""
    return safe_normalize(jnp.stack([t_x, t_y, jnp.ones_like(t_x)], axis=-1))


def pick(
    weights: Float[Array, "... n"], u: Float[Array, "..."]
) -> tuple[Int[Array, "..."], Float[Array, "..."]]:
    """An index drawn by u in [0, 1) with probability ∝ weights, and where u lies in its share, in [0, 1)."""
    cumulative = jnp.cumsum(weights, axis=-1)
    target = u * cumulative[..., -1]
    index = jnp.minimum(jnp.sum(cumulative <= target[..., None], axis=-1), weights.shape[-1] - 1)
    upper = jnp.take_along_axis(cumulative, index[..., None], axis=-1)[..., 0]
    share = jnp.take_along_axis(weights, index[..., None], axis=-1)[..., 0]
    below_one = 1 - jnp.finfo(u.dtype).epsneg
    return index, jnp.clip(1 - safe_divide(upper - target, share), 0, below_one)
