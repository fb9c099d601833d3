r"""What a fit to a tabulated distribution minimises: ½ Σ r², with r a function of D and the table's T.

Cells of the table all have the area dA on the disk. Cells in which T is NaN do not count.
"""

from abc import ABC, abstractmethod
from types import MappingProxyType
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.special import safe_divide

_NEAR = 1e-3  # |T/D − 1| below which the deviance is its series
_HARDLY = 0.75  # the power of the smallest number, for T/D to be one
_SCALE = 10.0  # residuals are scaled to the order of a hundred in all, which damping is made for


class TableLoss(eqx.Module, ABC):
    """Residuals and their derivatives, cell by cell."""

    name: ClassVar[str]

    @abstractmethod
    def scale(self, T: Float[np.ndarray, "B K"], dA: float) -> Float[np.ndarray, " B"]:
        """What the residuals of each table are multiplied by."""

    @abstractmethod
    def residual_and_slope(
        self, D: Float[Array, " K"], T: Float[Array, " K"]
    ) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
        """r and dr/dD, both 0 where T is NaN."""

    @abstractmethod
    def weight(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        """w for which the derivatives of ½ Σ r² are those of ½ Σ w (D − T)²; 0 where T is NaN."""

    def residual(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        """r, differentiable by D."""
        return _with_slope(self, D, T)


@jax.custom_jvp
def _with_slope(loss, D, T):
    return loss.residual_and_slope(D, T)[0]


@_with_slope.defjvp
def _(primals, tangents):
    r, slope = primals[0].residual_and_slope(*primals[1:])
    return r, slope * tangents[1]


class AreaWeighted(TableLoss):
    """Σ (D − T)² dA, as a share of Σ T² dA: ½ Σ r² is 50 times that."""

    name = "area-weighted L2"

    def scale(self, T: Float[np.ndarray, "B K"], dA: float) -> Float[np.ndarray, " B"]:
        squares = np.nansum(np.square(T, dtype=float), axis=1)
        return _SCALE / np.sqrt(np.where(squares > 0, squares, 1))

    def residual_and_slope(
        self, D: Float[Array, " K"], T: Float[Array, " K"]
    ) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
        return jnp.where(jnp.isfinite(T), D - T, 0), self.weight(D, T)

    def weight(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        return jnp.isfinite(T).astype(D.dtype)


class Likelihood(TableLoss):
    r"""KL = Σ (T log(T/D) − T + D) dA, for normals that were counted: ½ Σ r² is 100 times that.

    n KL is what the log-likelihood of n normals lacks to its highest value, if the count in each cell of the
    table is Poisson distributed around n D dA; the residuals are those of the deviance. Normals that lie
    outside the table are no loss where T is a density of all of them. A T below 0 makes r NaN.
    """

    name = "likelihood"

    def scale(self, T: Float[np.ndarray, "B K"], dA: float) -> Float[np.ndarray, " B"]:
        return np.full(len(T), _SCALE * np.sqrt(dA))

    def residual_and_slope(
        self, D: Float[Array, " K"], T: Float[Array, " K"]
    ) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
        """r = −sign(e) √(2 D h), h = y log y − e, e = y − 1, y = T/D; h = e²/2 − e³/6 + … near 0.

        A D that is 0 counts as one that is hardly more: normals where there should be none are a great loss.
        """
        known, D = jnp.isfinite(T), jnp.maximum(D, jnp.finfo(D.dtype).tiny ** _HARDLY)
        y = jnp.where(known, safe_divide(T, D), 1)
        e = y - 1
        near = jnp.abs(e) < _NEAR
        filled = y != 0
        h = jnp.where(filled, y * jnp.log(jnp.where(filled, y, 1)), 0) - e
        h = jnp.where(near, e * e * (1 / 2 - e / 6 + e * e / 12), h)
        root, root_D = jnp.sqrt(2 * jnp.where(h == 0, 1, h)), jnp.sqrt(D)
        slope = jnp.where(near, 1 + e / 6, jnp.abs(e) / root)
        return (
            jnp.where(h == 0, 0, -jnp.sign(e) * root * root_D),
            jnp.where(known, safe_divide(slope, root_D), 0),
        )

    def weight(self, D: Float[Array, " K"], T: Float[Array, " K"]) -> Float[Array, " K"]:
        """1/D, the information that a cell is expected to give."""
        return jnp.where(jnp.isfinite(T), safe_divide(1.0, D), 0)


TABLE_LOSSES = MappingProxyType({"l2": AreaWeighted(), "likelihood": Likelihood()})


def table_loss(name: str) -> TableLoss:
    """The loss of that name. Raises ValueError for an unknown one."""
    if name not in TABLE_LOSSES:
        raise ValueError(f"loss must be one of {', '.join(TABLE_LOSSES)}; found {name!r}")
    return TABLE_LOSSES[name]
