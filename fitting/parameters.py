"""From the unbounded numbers that a solver moves to a distribution whose parameters stay in their ranges."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.arrays import Range, fitted_ranges
from jaxbrdf.ndf.base import AbstractNDF


class ShapeSpace(eqx.Module):
    r"""The n shape parameters of one class of distributions, as numbers t: [0, 1]ⁿ is their declared range.

    t runs evenly over the range, or over its logarithm. A solver may step outside: t is clipped, so that a
    bound can be reached and stayed on; the derivative there is zero.
    """

    ndf_class: type = eqx.field(static=True)

    def __check_init__(self):
        if not (1 <= len(self.ranges) <= 2 and self.ndf(jnp.full(len(self.ranges), 0.5)).is_isotropic):
            raise ValueError(
                f"{self.ndf_class.__name__} cannot be fitted to an isotropic table: expected an isotropic "
                "distribution with one or two parameters declared as parameter(fitted=Range(...))"
            )

    @property
    def ranges(self) -> dict[str, Range]:
        return fitted_ranges(self.ndf_class)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.ranges)

    def ndf(self, t: Float[Array, "... n"]) -> AbstractNDF:
        """The distribution at t, with parameters of shape (...)."""
        u = jnp.clip(t, 0, 1)
        return self.ndf_class(
            **{name: value_at(r, u[..., k]) for k, (name, r) in enumerate(self.ranges.items())}
        )

    def shape_of(self, ndf: AbstractNDF) -> Float[Array, "... n"]:
        """The t of a distribution: undoes `ndf`; parameters (...) to (..., n)."""
        shares = [share_of(r, jnp.asarray(getattr(ndf, name))) for name, r in self.ranges.items()]
        return jnp.stack(jnp.broadcast_arrays(*shares), axis=-1)

    def values(self, t: Float[Array, " n"]) -> Float[Array, " n"]:
        """The parameters at t, in the order of `names`."""
        ndf = self.ndf(t)
        return jnp.stack([getattr(ndf, name) for name in self.names])

    def slopes(self, t: Float[Array, " n"]) -> Float[Array, " n"]:
        """d parameter / dt; 0 on a bound."""
        inside = (t > 0) & (t < 1)
        return jnp.where(inside, jnp.diagonal(jax.jacfwd(self.values)(t)), 0)

    def grid(self, points: int) -> np.ndarray:
        """About `points` shapes t evenly over [0, 1]ⁿ, none of them on a bound: (G, n)."""
        return unit_grid(points, len(self.names))


def unit_grid(points: int, dimensions: int) -> np.ndarray:
    """About `points` points evenly over [0, 1]ⁿ, none on a bound: (G, n); the last axis runs first."""
    side = round(points ** (1 / dimensions))
    return combinations(*[(np.arange(side) + 0.5) / side] * dimensions)


def combinations(*axes: np.ndarray) -> np.ndarray:
    """All combinations of the axes' values, (product of lengths, number of axes)."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def value_at(r: Range, u):
    """The number at the share u of a range."""
    low, high = r.low - r.pole, r.high - r.pole
    return r.pole + low * (high / low) ** u if r.log else r.low + (r.high - r.low) * u


def share_of(r: Range, value):
    """The share of a range at which a number lies: undoes `value_at`."""
    low, high = r.low - r.pole, r.high - r.pole
    return jnp.log((value - r.pole) / low) / np.log(high / low) if r.log else (value - r.low) / (high - low)
