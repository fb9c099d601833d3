"""The problems that make up one fit, side by side: every loss with every channel of every material."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from fitting.least_squares import map_lanes
from fitting.losses import Loss, normalised
from fitting.model_space import ModelSpace
from fitting.observations import Observations

_FEWEST = 8  # valid samples


class Lanes(eqx.Module):
    """L problems: every loss with every channel of every material.

    Values are 0 where the weight is 0; `projected` are the weights of the linearised loss, `weight` those of
    the loss itself, scaled so that no reflectance at all has ½ Σ r² = 50. `own` are the fixed parameters that
    differ from channel to channel.
    """

    values: Float[np.ndarray, "L N"]
    projected: Float[np.ndarray, "L N"]
    weight: Float[np.ndarray, "L N"]
    loss: Loss
    own: list[np.ndarray]
    enough: Bool[np.ndarray, " L"]

    def thinned(self, rows: np.ndarray) -> "Lanes":
        """The same problems at some of the pairs."""
        share = self.values.shape[1] / len(rows)
        parts = self.values[:, rows], share * self.projected[:, rows], share * self.weight[:, rows]
        return Lanes(*parts, self.loss, self.own, self.enough)


class Shared(eqx.Module):
    """What all lanes have in common."""

    space: ModelSpace
    wi: Float[Array, "N 3"]
    wo: Float[Array, "N 3"]

    def first_lobes(self, count: int) -> "Shared":
        return Shared(self.space.first_lobes(count), self.wi, self.wo)

    def thinned(self, rows: np.ndarray) -> "Shared":
        return Shared(self.space, self.wi[rows], self.wo[rows])

    def features(self, u, own):
        return self.space.features(u, own, self.wi, self.wo)


class LaneFit(NamedTuple):
    """Of each lane: shape u, linear unknowns x, steps taken, whether it converged, spread of residuals."""

    u: Float[np.ndarray, "L n"]
    x: Float[np.ndarray, "L k"]
    steps: Int[np.ndarray, " L"]
    converged: Bool[np.ndarray, " L"]
    spread: Float[np.ndarray, " L"]


def make_lanes(seen: Observations, losses: Sequence[Loss], max_angle: float, own: list[np.ndarray]) -> Lanes:
    B, C, N = seen.values.shape
    cos_i, cos_o = seen.wi[:, 2], seen.wo[:, 2]
    values = np.tile(seen.values.reshape(B * C, N), (len(losses), 1))
    near = (cos_i > np.cos(max_angle)) & (cos_o > np.cos(max_angle)) & (seen.measure > 0)
    used = np.isfinite(values) & near[None, :]
    values = np.where(used, values, 0)
    loss = jax.tree.map(lambda *leaves: np.repeat(np.stack(leaves), B * C), *losses)
    slope, transformed, share = map_lanes(_of_loss, (values, loss), (cos_i, cos_o))
    weight = np.where(used, share * seen.measure[None, :], 0)
    return Lanes(
        values,
        normalised(weight * slope**2, values),
        normalised(weight, transformed),
        loss,
        [np.tile(leaf, (len(losses) * B, *[1] * (leaf.ndim - 1))) for leaf in own],
        (used.sum(axis=1) >= _FEWEST) & np.any(values > 0, axis=1),
    )


def _of_loss(lane, cosines):
    (values, loss), (cos_i, cos_o) = lane, cosines
    share = jnp.broadcast_to(loss.weight(cos_i, cos_o), values.shape)
    return loss.slope(values, cos_i), loss.transformed(values, cos_i), share
