r"""Where fits start: the local minima of the error over a grid of shapes.

The linear unknowns of every shape are solved for, so the grid covers all there is; its errors are those of
quadratic forms, made by a few matrix products for all lanes at once.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import minimum_filter

from fitting.least_squares import map_lanes, nonnegative_least_squares

_WITHIN = 2.0  # a minimum of more than this times the lane's lowest error is no start


def grid_minima(error: Float[np.ndarray, "L G"], dimensions: int, most: int = 3):
    """The lowest local minima of errors over a `unit_grid`: lanes (S,) and grid points (S,), lane by lane.

    At most `most` a lane; minima of more than twice a lane's lowest error are left out.
    """
    side = round(error.shape[1] ** (1 / dimensions))
    cube = error.reshape(len(error), *[side] * dimensions)
    lowest_around = minimum_filter(cube, size=(1, *[3] * dimensions), mode="nearest").reshape(error.shape)
    minima = np.where(error <= lowest_around, error, np.inf)
    lowest = np.argsort(minima, axis=1, kind="stable")[:, :most]
    near = np.take_along_axis(minima, lowest, axis=1) <= _WITHIN * error.min(axis=1, keepdims=True)
    return np.nonzero(near)[0], lowest[near]


def lowest_points(error: Float[np.ndarray, "L G"], most: int):
    """The lowest of errors over a grid, neighbours or not: lanes (S,) and points (S,), lane by lane."""
    lowest = np.argsort(error, axis=1, kind="stable")[:, :most]
    return np.repeat(np.arange(len(error)), lowest.shape[1]), lowest.ravel()


class Forms(eqx.Module):
    r"""Quadratic forms of the error ½ Σ w (f − m)², f = f_0 + x·φ: of what the lanes have in common with
    the grid's lobes. Rows and columns are φ, then what has no factor: f_0 − m of the base, f_0 of a lobe."""

    base: Float[np.ndarray, "L p p"]
    lobe: Float[np.ndarray, "L G q q"]
    both: Float[np.ndarray, "L G p q"]


def quadratic_forms(
    weight: Float[np.ndarray, "L N"], base: Float[np.ndarray, "L p N"], lobe: Float[np.ndarray, "G q N"]
) -> Forms:
    """The forms of L bases, each with its weights, and G lobes."""
    L, p, N = base.shape
    G, q, _ = lobe.shape
    weighted = weight[:, None, :] * base
    with np.errstate(all="ignore"):  # of lobes so sharp that they overflow, which are no start
        products = (lobe[:, :, None, :] * lobe[:, None, :, :]).reshape(G * q * q, N)
        both = weighted.reshape(L * p, N) @ lobe.reshape(G * q, N).T
        return Forms(
            weighted @ base.transpose(0, 2, 1),
            (weight @ products.T).reshape(L, G, q, q),
            both.reshape(L, p, G, q).transpose(0, 2, 1, 3),
        )


def least_errors(forms: Forms) -> Float[np.ndarray, "L G"]:
    """Σ w (f − m)² of each lane with each lobe, at the best x ≥ 0; infinite where it is no number."""
    error = map_lanes(_lane_errors, forms)
    return np.where(np.isfinite(error), error, np.inf)


def _lane_errors(forms: Forms, _=None):
    return jax.vmap(_least_error, (None, 0, 0))(forms.base, forms.lobe, forms.both)


def _least_error(base, lobe, both):
    M = jnp.block([[base, both], [both.T, lobe]])
    p, q = both.shape
    fixed = np.zeros(p + q)
    fixed[[p - 1, p + q - 1]] = 1
    linear = np.flatnonzero(fixed == 0)
    b = -M[linear] @ fixed
    x = nonnegative_least_squares(M[np.ix_(linear, linear)], b)
    total = fixed @ M @ fixed
    return jnp.maximum(total - x @ b, 1e-12 * base[-1, -1])


def lowest(cost: Float[np.ndarray, " S"], lane: Int[np.ndarray, " S"], count: int) -> Int[np.ndarray, " L"]:
    """The index of the lowest cost of each lane, (count,)."""
    order = np.lexsort((np.nan_to_num(cost, nan=np.inf), lane))
    return order[np.searchsorted(lane[order], np.arange(count))]
