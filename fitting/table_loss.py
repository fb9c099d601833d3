r"""What a fit to a tabulated distribution minimises: ½ Σ w² ℓ(D, T), T what a cell of the table holds.

Cells of the table all have the area dA on the disk. Cells in which T is NaN do not count.
"""

from abc import ABC, abstractmethod
from types import MappingProxyType
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

_SCALE = 10.0  # a hundred in all, of what is of order one: damping is made for that


class TableLoss(eqx.Module, ABC):
    """ℓ, and the weight that the quadratic next to it has, cell by cell."""

    name: ClassVar[str]

    @abstractmethod
    def scale(self, T: Float[Array, " K"], area: ArrayLike) -> Float[Array, ""]:
        """w of a table."""

    @abstractmethod
    def loss(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        """ℓ; 0 where T is NaN."""

    @abstractmethod
    def weight(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        """c for which d(½ℓ)/dD = c (D − T), and d²(½ℓ)/dD² is expected to be c; 0 where T is NaN."""

    @abstractmethod
    def curvature(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        """d²(½ℓ)/dD²; 0 where T is NaN."""

    def gram(
        self, D: Float[Array, " K"], T: Float[Array, " K"], J: Float[Array, "K n"], scale: Float[Array, " k"]
    ) -> Float[Array, "n+1 n+1"]:
        """Expected second derivatives, gradient and twice the value, for J = dD/dt: see `solve_grams`."""
        weight = scale**2 * self.weight(D, T)
        JJ, Jr = J.T @ (weight[:, None] * J), J.T @ (weight * difference(D, T))
        return bordered(JJ, Jr, jnp.sum(scale**2 * self.loss(D, T)))


def difference(D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
    """D − T; 0 where T is NaN."""
    return jnp.where(jnp.isfinite(T), D - T, 0)


def bordered(
    JJ: Float[Array, "n n"], Jr: Float[Array, " n"], rr: Float[Array, ""]
) -> Float[Array, "n+1 n+1"]:
    """[J r]ᵀ[J r] of its parts."""
    return jnp.block([[JJ, Jr[:, None]], [Jr[None, :], rr[None, None]]])


class AreaWeighted(TableLoss):
    """Σ (D − T)² dA, as a share of Σ T² dA: what is minimised is 50 times that."""

    name = "area-weighted L2"

    def scale(self, T: Float[Array, " K"], area: ArrayLike) -> Float[Array, ""]:
        squares = jnp.sum(jnp.where(jnp.isfinite(T), T, 0) ** 2)
        return _SCALE / jnp.sqrt(jnp.where(squares > 0, squares, 1))

    def loss(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        return difference(D, T) ** 2

    def weight(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        return jnp.isfinite(T).astype(D.dtype)

    def curvature(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        return self.weight(D, T)


class Likelihood(TableLoss):
    r"""KL = Σ (T log(T/D) − T + D) dA, for normals that were counted: what is minimised is 100 times that.

    n KL is what the log-likelihood of n normals lacks to its highest value, if the count in each cell of the
    table is Poisson distributed around n D dA. Normals that lie outside the table are no loss where T is a
    density of all of them. A D of 0 counts as one that is hardly more: normals where there should be none are
    a great loss, not none. Steps are those of Fisher's scoring. A T below 0 makes it NaN.
    """

    name = "likelihood"

    def scale(self, T: Float[Array, " K"], area: ArrayLike) -> Float[Array, ""]:
        return _SCALE * jnp.sqrt(jnp.asarray(area, T.dtype))

    def loss(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        known, filled = jnp.isfinite(T), jnp.isfinite(T) & (T != 0)
        log = jnp.log(jnp.where(filled, T / _positive(D), 1))
        return jnp.where(known, 2 * (jnp.where(filled, T * log, 0) - T + D), 0)

    def weight(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        return jnp.where(jnp.isfinite(T), 1 / _positive(D), 0)

    def curvature(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        return jnp.where(jnp.isfinite(T), T / _positive(D) ** 2, 0)


def _positive(D: Float[Array, " K"]) -> Float[Array, " K"]:
    """D, but so large that numbers can hold 1/D², and far less than any table holds."""
    return jnp.maximum(D, jnp.finfo(D.dtype).tiny ** 0.4)


TABLE_LOSSES = MappingProxyType({"l2": AreaWeighted(), "likelihood": Likelihood()})


def table_loss(name: str) -> TableLoss:
    """The loss of that name. Raises ValueError for an unknown one."""
    if name not in TABLE_LOSSES:
        raise ValueError(f"loss must be one of {', '.join(TABLE_LOSSES)}; found {name!r}")
    return TABLE_LOSSES[name]
