"""The minimum of every lane: lobes found one after another, then each loss minimised in all unknowns."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fitting.cook_torrance import solve_linear
from fitting.lanes import LaneFit, Lanes, Shared
from fitting.least_squares import map_lanes, solve_lanes, with_rows
from fitting.losses import Loss, spread
from fitting.parameters import unit_grid
from fitting.starts import grid_minima, least_errors, lowest, quadratic_forms
from jaxbrdf.directions import cos_theta
from jaxbrdf.special import safe_divide

_GRID = 256  # shapes of a lobe to start from
_ROUNDS = 4  # of a robust fit, between which the spread of its residuals is measured anew
_COARSE = 2048  # pairs at which minima are sought, before all are looked at
_ROUGH = 1e-3  # tolerance of a search whose end is refined
_FINE = 1e-4  # and of that where linear unknowns are solved for: it raised no cost of 150 by more than 5e-9
_DIM = 1e-2  # a linear unknown starts at this share of what it would be alone, at least


def best_fits(lanes: Lanes, shared: Shared, starts: int, given: np.ndarray) -> LaneFit:
    """The minimum of every lane's loss: sought at some of the pairs, then refined at all of them."""
    rows = some_pairs(lanes)
    if len(rows) == lanes.values.shape[1]:
        return _minimised(_find_lobes(lanes, shared, starts, given), lanes, shared)
    few, shared_few = lanes.thinned(rows), shared.thinned(rows)
    fit = _minimised(_find_lobes(few, shared_few, starts, given, _ROUGH), few, shared_few, _ROUGH)
    return _minimised(_refined(fit, lanes, shared), lanes, shared)


def some_pairs(lanes: Lanes) -> np.ndarray:
    """Some 2048 of the pairs, the same every time; all of them where a lane has hardly so many."""
    count = lanes.values.shape[1]
    fewest = np.min(np.sum(lanes.weight[lanes.enough] > 0, axis=1), initial=count)
    if fewest < 2 * _COARSE:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:_COARSE])


def _refined(fit: LaneFit, lanes: Lanes, shared: Shared) -> LaneFit:
    """The minimum of the linearised loss next to a fit; of lanes whose loss is another, the fit."""
    todo = np.flatnonzero(~_is_other(lanes))
    if not len(todo) or not fit.u.shape[1]:
        x = map_lanes(_linear_unknowns, (fit.u, lanes.values, lanes.projected, lanes.own), shared)
        return fit._replace(x=np.where(_is_other(lanes)[:, None], fit.x, x))
    data = (lanes.values[todo], lanes.projected[todo], [leaf[todo] for leaf in lanes.own])
    found = solve_lanes(
        projected_residual, fit.u[todo], data, shared, (0, 1), steps_a_round=6, rounds=20, tolerance=_FINE
    )
    x = map_lanes(_linear_unknowns, (found.t, *data), shared)
    parts = found.t, x, fit.steps[todo] + found.steps, found.converged, fit.spread[todo]
    return LaneFit(*[with_rows(old, todo, new) for old, new in zip(fit, parts, strict=True)])


def _is_other(lanes: Lanes) -> np.ndarray:
    """Whether a lane's loss is more than a weighted sum of squares of f − m."""
    return (lanes.loss.power != 1) | (lanes.loss.cutoff > 0)


# Lobes, one after another


def _find_lobes(
    lanes: Lanes, shared: Shared, starts: int, given: np.ndarray, tolerance: float = 1e-6
) -> LaneFit:
    """The minimum of the linearised loss."""
    count = len(lanes.enough)
    u, steps, converged = np.zeros((count, 0)), np.zeros(count, int), np.ones(count, bool)
    lobes = len(shared.space.lobes)
    for j in range(lobes):
        lane, start = lobe_starts(lanes, shared.first_lobes(j), shared.first_lobes(j + 1), u, starts)
        lane = np.append(lane, np.arange(count))
        start = np.concatenate([start, np.clip(given[:, : start.shape[1]], 0, 1)])
        data = (lanes.values[lane], lanes.projected[lane], [leaf[lane] for leaf in lanes.own])
        found = solve_lanes(
            projected_residual, start, data, shared.first_lobes(j + 1), (0, 1), tolerance=tolerance
        )
        best = lowest(found.cost, lane, count)
        u, converged = found.t[best], found.converged[best]
        steps = steps + found.steps[best]
    x = map_lanes(_linear_unknowns, (u, lanes.values, lanes.projected, lanes.own), shared)
    return LaneFit(u, x, steps, converged, np.ones(count))


def lobe_starts(lanes: Lanes, before: Shared, after: Shared, u: np.ndarray, most: int):
    """Where to start with one more lobe: lanes (S,) and shapes (S, n)."""
    term = after.space.lobes[len({unknown.term for unknown in before.space.shapes})]
    dimensions = sum(unknown.term == term for unknown in after.space.shapes)
    grid = unit_grid(_GRID, dimensions)
    base = map_lanes(_base_rows, (u, lanes.values, lanes.own), before)
    errors = np.empty((len(u), len(grid)))
    for rows in _alike(lanes.own, len(u)):
        own = [leaf[rows[0]] for leaf in lanes.own]
        lobe = _lobe_rows(grid, own, after, term)
        errors[rows] = least_errors(quadratic_forms(lanes.projected[rows], base[rows], np.asarray(lobe)))
    lane, point = grid_minima(errors, dimensions, most)
    return lane, np.concatenate([u[lane], grid[point]], axis=1)


def _alike(own: list[np.ndarray], count: int) -> list[np.ndarray]:
    """The lanes in groups whose own parameters are the same."""
    if not own:
        return [np.arange(count)]
    flat = np.concatenate([leaf.reshape(count, -1) for leaf in own], axis=1)
    _, group = np.unique(flat, axis=0, return_inverse=True)
    return [np.flatnonzero(group == g) for g in range(group.max() + 1)]


def _base_rows(lane, before: Shared):
    u, values, own = lane
    f_0, features = before.features(u, own)
    return jnp.concatenate([features, (f_0 - values)[None, :]])


@eqx.filter_jit
def _lobe_rows(grid, own, after: Shared, term: int):
    """(G, k + 1, N): φ of a lobe's linear unknowns and its f_0, for each shape of a grid."""
    others = len(after.space.shapes) - grid.shape[1]

    def rows(shape):
        u = jnp.concatenate([jnp.full(others, 0.5), shape])
        f_0, features = after.space.parts(u, own, after.wi, after.wo, [term])
        return jnp.concatenate([features, f_0[None, :]])

    return jax.lax.map(rows, jnp.asarray(grid), batch_size=16)


def projected_residual(u, args):
    """√w (f − m) at the best x ≥ 0."""
    (values, weight, own), shared = args
    f_0, features = shared.features(u, own)
    x = solve_linear(features, weight, values - f_0)
    return jnp.sqrt(weight) * (f_0 + x @ features - values)


def _linear_unknowns(lane, shared: Shared):
    u, values, weight, own = lane
    f_0, features = shared.features(u, own)
    return solve_linear(features, weight, values - f_0)


# The loss itself, where it is not a sum of squares of f − m


class LossLane(NamedTuple):
    """What the residual of a loss needs of a lane."""

    values: Float[Array | np.ndarray, "... N"]
    weight: Float[Array | np.ndarray, "... N"]
    loss: Loss
    spread: Float[Array | np.ndarray, "..."]
    scale: Float[Array | np.ndarray, "... k"]
    own: list


def _minimised(fit: LaneFit, lanes: Lanes, shared: Shared, tolerance: float = 1e-6) -> LaneFit:
    """The minimum of each lane's loss, from that of the linearised one."""
    todo = np.flatnonzero(_is_other(lanes))
    if not len(todo):
        return fit
    lanes = jax.tree.map(lambda leaf: leaf[todo], lanes)
    scale = map_lanes(_scales, (fit.u[todo], lanes.values, lanes.projected, lanes.own), shared)
    u, x, spreads = fit.u[todo], fit.x[todo], fit.spread[todo]
    steps, n = np.zeros(len(todo), int), fit.u.shape[1]
    high = np.append(np.ones(n), np.full(x.shape[1], np.inf))
    for _ in range(_ROUNDS if np.any(lanes.loss.cutoff > 0) else 1):
        r = map_lanes(_difference, (u, x, lanes.values, lanes.loss, lanes.own), shared)
        spreads = spread(r, lanes.weight > 0)
        data = LossLane(lanes.values, lanes.weight, lanes.loss, spreads, scale, lanes.own)
        start = np.concatenate([u, np.maximum(x / scale, _DIM)], axis=1)
        found = solve_lanes(_loss_residual, start, data, shared, (0, high), tolerance=tolerance)
        u, x = found.t[:, :n], scale * found.t[:, n:]
        steps += found.steps
    parts = u, x, fit.steps[todo] + steps, found.converged, spreads
    return LaneFit(*[with_rows(old, todo, new) for old, new in zip(fit, parts, strict=True)])


def _scales(lane, shared: Shared):
    """What each linear unknown would be alone; 1 where that is nothing."""
    u, values, weight, own = lane
    _, features = shared.features(u, own)
    alone = safe_divide(features @ (weight * values), features**2 @ weight)
    return jnp.where(alone > 0, alone, 1)


def _difference(lane, shared: Shared):
    """φ(f) − φ(m)."""
    u, x, values, loss, own = lane
    f_0, features = shared.features(u, own)
    cos_i = cos_theta(shared.wi)
    return loss.transformed(f_0 + x @ features, cos_i) - loss.transformed(values, cos_i)


def _loss_residual(t, args):
    lane, shared = args
    n = len(t) - len(lane.scale)
    return weighted_residual(t[:n], lane.scale * t[n:], lane, shared)


def weighted_residual(u, x, lane: LossLane, shared: Shared):
    r = _difference((u, x, lane.values, lane.loss, lane.own), shared)
    return jnp.sqrt(lane.weight) * lane.loss.robust_residual(r, jnp.asarray(lane.spread))
