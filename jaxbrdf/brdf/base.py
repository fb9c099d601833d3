"""What a reflectance is, and sums of reflectances."""

from abc import abstractmethod
from functools import reduce
from operator import add

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxbrdf.arrays import Parametric, per_channel
from jaxbrdf.directions import Direction, as_directions, cos_theta


class AbstractBRDF(Parametric):
    """A reflectance f(wi, wo) in 1/sr, without the cosine; sums of reflectances are reflectances.

    Directions are (..., 3); the result is (...), or (..., C) where parameters carry C channels. Raises
    ValueError for directions that are not unit vectors (outside jit).
    """

    def __call__(self, wi: ArrayLike, wo: ArrayLike) -> Float[Array, "..."]:
        """f(wi, wo), 1/sr; 0 where either direction is at or below the horizon."""
        return per_channel(type(self)._reflectance)(self, as_directions(wi, "wi"), as_directions(wo, "wo"))

    @abstractmethod
    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        """f for one channel."""

    def __add__(self, other: "AbstractBRDF") -> "Sum":
        return Sum((self, other))


class Sum(AbstractBRDF):
    """The sum of several reflectances; `a + b` makes one."""

    terms: tuple[AbstractBRDF, ...]

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return reduce(add, (term(wi, wo) for term in self.terms))


def both_above(wi: Direction, wo: Direction) -> Array:
    """Whether both directions are above the horizon, (...)."""
    return (cos_theta(wi) > 0) & (cos_theta(wo) > 0)


def cosine_product(wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """cos θ_i cos θ_o where both are above the horizon, and 1 where they are not, to divide by."""
    return jnp.where(both_above(wi, wo), cos_theta(wi) * cos_theta(wo), 1)
