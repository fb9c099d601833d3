r"""Fits to the whole table: the linear coefficients anew for a given lobe, or everything refined.

What is minimised balances two errors over an importance subsample of the table's cells, each in units of
the least that the two-slice lobe can reach:

    E_L2² / min E_L2² + κ · E_log² / min E_log²

E_L2 is the normalized L2 error, ruled by the mirror peak; E_log the error of log(1 + f cos θ_i) below 80°,
linearised at the measurement, which keeps the rest of the lobe honest. κ = 100 was chosen by trying 0 to
1000 on reconstructed MERL; where E_L2 would not fall below that of the recipe before, κ goes down to 0.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from fitting.cook_torrance import LobeSamples, lobe_samples, solve_linear
from fitting.least_squares import map_lanes, solve_lanes
from fitting.observations import Cells, choose_cells
from fitting.parameters import ShapeSpace
from jaxbrdf.brdf.measured import MeasuredBRDF
from jaxbrdf.directions import cos_theta
from jaxbrdf.quadrature import HalfDifferenceGrid
from jaxbrdf.special import safe_divide

_KAPPAS = (100.0, 10.0, 1.0, 0.0)
_GAIN = 0.97  # E_L2 must fall by more than the subsample's error, or the fit before is kept
_LIMIT = np.deg2rad(80)  # beyond this the logarithmic error does not look


class TableLanes(eqx.Module):
    """N cells of L channels, each a lane: values, and the weights of E_L2² and of the linearised E_log²."""

    values: Float[np.ndarray, "L N"]
    weight_l2: Float[np.ndarray, "L N"]
    weight_log: Float[np.ndarray, "L N"]


class TableFit(eqx.Module):
    """Of each lane: the shape t, the linear unknowns x, E_L2 and the weights minimised, and how it went."""

    t: Float[np.ndarray, "L n"]
    x: Float[np.ndarray, "L 4"]
    l2: Float[np.ndarray, " L"]
    weight: Float[np.ndarray, "L N"]
    steps: Int[np.ndarray, " L"]
    converged: Bool[np.ndarray, " L"]


class Subsample(eqx.Module):
    """The chosen cells of a grid, and the lobes of a family of distributions there."""

    cells: Cells
    samples: LobeSamples


def subsample(space: ShapeSpace, grid: HalfDifferenceGrid) -> Subsample:
    """About 8,000 cells; see `choose_cells`."""
    cells = choose_cells(grid)
    return Subsample(cells, lobe_samples(space, jnp.asarray(cells.wi), jnp.asarray(cells.wo)))


def table_lanes(chosen: Subsample, measured: list[MeasuredBRDF]) -> TableLanes:
    """One lane for each channel of each material; invalid cells weigh nothing."""
    values = np.concatenate([(m.raw[chosen.cells.cell] * m.scale).T for m in measured])
    valid = values >= 0
    values = np.where(valid, values, 0)
    cos_i, cos_o = np.asarray(cos_theta(chosen.samples.wi)), np.asarray(cos_theta(chosen.samples.wo))
    below_limit = (cos_i > np.cos(_LIMIT)) & (cos_o > np.cos(_LIMIT))
    slope = cos_i / (1 + values * cos_i)  # of log(1 + f cos θ_i) at the measurement
    return TableLanes(
        values,
        valid * chosen.cells.measure * cos_i * cos_o,
        valid * below_limit * chosen.cells.measure * slope**2,
    )


def refit_linear(chosen: Subsample, lanes: TableLanes, t, x) -> TableFit:
    """The best linear unknowns for lobes of shape t, with the largest κ that lets E_L2 fall below that of x.

    Where none does, x stays.
    """
    x, l2, weight = map_lanes(_linear, (t, x, lanes), chosen.samples)
    return TableFit(t, x, l2, weight, np.zeros(len(t), int), np.ones(len(t), bool))


def refine(chosen: Subsample, lanes: TableLanes, start: TableFit) -> TableFit:
    """Shape and linear unknowns by Levenberg–Marquardt, with the largest κ that lets E_L2 fall from start.

    Where none does, the start stays.
    """
    weights = map_lanes(_candidate_weights, (start.t, lanes), chosen.samples)
    best = start
    todo = np.arange(len(start.t))
    for k in range(len(_KAPPAS)):
        data = (lanes.values[todo], weights[todo, k])
        found = solve_lanes(_residual, start.t[todo], data, chosen.samples, (0, 1), tolerance=1e-5)
        x, l2 = map_lanes(_at_shape, (found.t, *data, lanes.weight_l2[todo]), chosen.samples)
        better = l2 <= _GAIN * start.l2[todo]
        fit = TableFit(found.t, x, l2, data[1], found.steps, found.converged)
        best = jax.tree.map(lambda old, new: _replaced(old, todo[better], new[better]), best, fit)  # noqa: B023
        todo = todo[~better]
        if not len(todo):
            break
    return best


def _replaced(array, where, values):
    array = array.copy()
    array[where] = values
    return array


def _linear(lane, samples):
    t, x_before, lanes = lane
    features = samples.features(samples.lobe(t))
    weights = _candidate_weights((t, lanes), samples)
    candidates = jax.vmap(solve_linear, (None, 0, None))(features, weights, lanes.values)
    candidates = jnp.concatenate([candidates, x_before[None]])
    errors = jax.vmap(lambda x: _l2(x @ features, lanes.values, lanes.weight_l2))(candidates)
    first = jnp.argmax(errors <= jnp.array([_GAIN] * len(_KAPPAS) + [1]) * errors[-1])
    return candidates[first], errors[first], weights[jnp.minimum(first, len(_KAPPAS) - 1)]


def _candidate_weights(lane, samples):
    """The weights of the balanced error for each κ, (κ, N); the units are what shape t can reach."""
    t, lanes = lane
    features = samples.features(samples.lobe(t))

    def in_units(weight):
        best = solve_linear(features, weight, lanes.values) @ features
        least = jnp.sum(weight * (best - lanes.values) ** 2)
        floor = 1e-8 * jnp.sum(weight * lanes.values**2)  # of data without noise
        return weight * safe_divide(100.0, least + floor)

    l2, log = in_units(lanes.weight_l2), in_units(lanes.weight_log)
    return jnp.stack([(l2 + kappa * log) / (1 + kappa) for kappa in _KAPPAS])


def _residual(t, args):
    (values, weight), samples = args
    features = samples.features(samples.lobe(t))
    return jnp.sqrt(weight) * (solve_linear(features, weight, values) @ features - values)


def _at_shape(lane, samples):
    """The linear unknowns that go with a shape, and their E_L2."""
    t, values, weight, weight_l2 = lane
    features = samples.features(samples.lobe(t))
    x = solve_linear(features, weight, values)
    return x, _l2(x @ features, values, weight_l2)


def _l2(f, values, weight):
    return jnp.sqrt(jnp.sum(weight * (f - values) ** 2))
