"""What a reflectance is; sums and multiples of reflectances."""

from abc import abstractmethod
from functools import reduce
from operator import add

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxbrdf.arrays import Parameter, Parametric, channel_count, parameter, per_channel
from jaxbrdf.directions import (
    Direction,
    above_horizon,
    as_directions,
    as_floats,
    cos_theta,
    or_normal,
    same_rank,
)
from jaxbrdf.ndf.base import AbstractNDF, pick
from jaxbrdf.ndf.tabulated_area import tabulate_projected_area
from jaxbrdf.special import safe_divide, safe_sqrt


class AbstractBRDF(Parametric):
    """A reflectance f(wi, wo) in 1/sr, without the cosine; sums and multiples of them are reflectances too.

    Directions are (..., 3); the result is (...), or (..., C) where parameters carry C channels. Raises
    ValueError for directions that are not unit vectors (outside jit).

    A reflectance is written as `_reflectance` for scalar parameters. One that says no more is sampled like
    a diffuse surface; better are `_sample` with its `_pdf`, and `_weight`, by which sums choose.
    """

    __array_ufunc__ = None  # so that numpy leaves array * reflectance to __rmul__

    def __call__(self, wi: ArrayLike, wo: ArrayLike) -> Float[Array, "..."]:
        """f(wi, wo), 1/sr; 0 where either direction is at or below the horizon."""
        wi, wo = same_rank(as_directions(wi, "wi"), as_directions(wo, "wo"))
        return per_channel(type(self)._reflectance)(self, wi, wo)

    @property
    def anonymous(self) -> "AbstractBRDF":
        """The same without texts that say where it is from, for which jit would compile once more."""
        return self

    def tabulated(self) -> "AbstractBRDF":
        """The same, quick at millions of directions: projected areas that are integrals are looked up.

        To the accuracy of `tabulate_projected_area`; parameters must be plain numbers or channels of them.
        """

        def quick(node):
            if isinstance(node, AbstractNDF):
                return node if node.closed_form_area else tabulate_projected_area(node)
            return node.tabulated() if isinstance(node, AbstractBRDF) else node

        def is_part(node):
            return isinstance(node, AbstractNDF | AbstractBRDF) and node is not self

        return jax.tree.map(quick, self, is_leaf=is_part)

    def sample(self, u: ArrayLike, wo: ArrayLike) -> Float[Array, "... 3"]:
        """A direction wi for each wo, of density `pdf(wi, wo)`: (..., 3).

        `u` holds points of [0, 1)², (..., 2), or is a key of jax.random, which draws one for each wo. The
        mean of f cos θ_i / pdf is the albedo. One direction serves all channels: it is drawn for one of them,
        and each is as likely. Some directions may lie below the horizon, where nothing is reflected. For a wo
        below the horizon a direction is drawn as for the normal.
        """
        wo = or_normal(as_directions(wo, "wo"))
        u = _points(u, wo)
        shape = jnp.broadcast_shapes(u.shape[:-1], wo.shape[:-1])
        u, wo = jnp.broadcast_to(u, (*shape, 2)), jnp.broadcast_to(wo, (*shape, 3))
        count = channel_count(self)
        if count is None:
            return self._sample(u, wo)
        channel, u = pick_by_first(jnp.ones((*shape, count), u.dtype), u)
        each = per_channel(type(self)._sample)(self, u, wo)
        return jnp.take_along_axis(each, channel[..., None, None], axis=-1)[..., 0]

    def pdf(self, wi: ArrayLike, wo: ArrayLike) -> Float[Array, "..."]:
        """The density of `sample` at wi, 1/sr, (...): 0 where either direction is at or below the horizon.

        Over the hemisphere of wi it integrates to at most 1: the rest was drawn below the horizon.
        """
        wi, wo = jnp.broadcast_arrays(*same_rank(as_directions(wi, "wi"), as_directions(wo, "wo")))
        above = both_above(wi, wo)
        density = per_channel(type(self)._pdf)(self, or_normal(wi), or_normal(wo))
        if channel_count(self) is not None:
            density = jnp.mean(density, axis=-1)
        return jnp.where(above, density, 0)

    @abstractmethod
    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        """f for one channel."""

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        """A wi for each u and wo, of one leading shape, wo above the horizon."""
        return sample_cosine(u)

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        """The density of `_sample`, both directions above the horizon and of one shape."""
        return cos_theta(wi) / jnp.pi

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        """About the share of light that it reflects to wo, ≥ 0, and 0 only where it reflects nothing."""
        return jnp.ones_like(cos_theta(wo))

    def __add__(self, other: "AbstractBRDF") -> "Sum":
        return Sum((self, other))

    def __mul__(self, factor: ArrayLike) -> "Scaled":
        return Scaled(jnp.asarray(factor), self)

    __rmul__ = __mul__


class AbstractSum(AbstractBRDF):
    """A reflectance that is a sum of others, which it makes of its parameters.

    Sampled by drawing one of its parts, with a probability in proportion to their weights.
    """

    @property
    @abstractmethod
    def parts(self) -> tuple[AbstractBRDF, ...]:
        """The reflectances that are summed."""

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return reduce(add, (part._reflectance(wi, wo) for part in self.parts))

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        index, u = pick_by_first(self._shares(wo), u)
        each = jnp.stack([part._sample(u, wo) for part in self.parts])
        return jnp.take_along_axis(each, index[None, ..., None], axis=0)[0]

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        densities = jnp.stack([part._pdf(wi, wo) for part in self.parts], axis=-1)
        return jnp.sum(self._shares(wo) * densities, axis=-1)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return reduce(add, (part._weight(wo) for part in self.parts))

    def _shares(self, wo: Direction) -> Float[Array, "... n"]:
        """The probability of each part; all alike where none reflects anything."""
        weights = jnp.stack([part._weight(wo) for part in self.parts], axis=-1)
        total = jnp.sum(weights, axis=-1, keepdims=True)
        return jnp.where(total > 0, safe_divide(weights, total), 1 / len(self.parts))


class Sum(AbstractSum):
    """The sum of several reflectances; `a + b` makes one."""

    terms: tuple[AbstractBRDF, ...]

    @property
    def parts(self) -> tuple[AbstractBRDF, ...]:
        return self.terms


class Scaled(AbstractBRDF):
    """A reflectance times a `factor`, () or (C,); `factor * reflectance` makes one."""

    factor: Parameter = parameter(linear=True)
    brdf: AbstractBRDF  # type: ignore[misc]  # `parameter()` is no default

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return self.factor * self.brdf._reflectance(wi, wo)

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        return self.brdf._sample(u, wo)

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return self.brdf._pdf(wi, wo)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return jnp.abs(self.factor) * self.brdf._weight(wo)


def both_above(wi: Direction, wo: Direction) -> Array:
    """Whether both directions count as above the horizon, (...); see `above_horizon`."""
    return above_horizon(cos_theta(wi)) & above_horizon(cos_theta(wo))


def cosine_product(wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """cos θ_i cos θ_o where both are above the horizon, and 1 where they are not, to divide by."""
    return jnp.where(both_above(wi, wo), cos_theta(wi) * cos_theta(wo), 1)


def sample_cosine(u: Float[Array, "... 2"]) -> Direction:
    """A direction of density cos θ / π: a point of the unit disk, lifted."""
    r, phi = safe_sqrt(u[..., 0]), 2 * jnp.pi * u[..., 1]
    return jnp.stack([r * jnp.cos(phi), r * jnp.sin(phi), safe_sqrt(1 - u[..., 0])], axis=-1)


def pick_by_first(weights: Float[Array, "... n"], u: Float[Array, "... 2"]):
    """An index drawn by u_1 with probability ∝ weights, and u with what is left of u_1."""
    index, rest = pick(weights, u[..., 0])
    return index, jnp.stack([rest, u[..., 1]], axis=-1)


def _points(u: ArrayLike, wo: Direction) -> Float[Array, "... 2"]:
    """Points of the unit square: those given, or one for each wo drawn by the key that is given."""
    dtype = jnp.asarray(u).dtype
    if jnp.issubdtype(dtype, jax.dtypes.prng_key) or dtype == jnp.uint32:  # uint32: keys of the old style
        return jax.random.uniform(u, (*wo.shape[:-1], 2), wo.dtype)
    return as_floats(u, "u", "points of [0, 1)² (or be a key of jax.random)", 2)
