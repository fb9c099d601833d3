r"""Fits of any distribution of normals to a tabulated one.

    E² = Σ_cells (D(m) − T)² dA,   dA = (2/N)²

over the cells of the unit disk, empty ones too: they say where no normals are. Starts are tried at some of
the cells, drawn by what they hold; the best is refined at all.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fitting.covariance import sandwich
from fitting.least_squares import LaneSolutions, map_lanes, solve_lanes
from fitting.model_space import ModelSpace, model_space
from fitting.outcome import Outcome, means_nothing, statuses, warn_of_float32
from fitting.parameters import unit_grid
from fitting.starts import grid_minima
from jaxbrdf.arrays import channel_count
from jaxbrdf.fit_result import FitResult
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.tabulated import TabulatedNDF, disk_cells
from jaxbrdf.special import safe_divide

_SOME = 16384  # cells at which starts are tried
_GRID = 256  # shapes to start from
_FEWEST = 8  # cells that hold something
_EDGE = 1e-4  # shares of a range nearer than this to its end are on the bound


class Cells(NamedTuple):
    """Cells of a table: their normals, √dA so scaled that the table alone has Σ r² = 100, and values."""

    m: Float[np.ndarray, "K 3"]
    root: Float[np.ndarray, " K"]
    values: Float[np.ndarray, " K"]

    def some(self) -> "Cells":
        """Some of them, half drawn evenly and half by what they hold, and weighed by how rarely."""
        count = len(self.values)
        if count <= _SOME:
            return self
        held = self.root**2 * self.values**2 + 1e-300  # evenly where nothing is held at all
        chance = 0.5 / count + 0.5 * held / held.sum()
        rows = np.sort(np.random.default_rng(0).choice(count, _SOME, p=chance / chance.sum()))
        return Cells(self.m[rows], self.root[rows] / np.sqrt(_SOME * chance[rows]), self.values[rows])


def fit_ndf(
    model: AbstractNDF, table: TabulatedNDF, *, fixed: tuple[str, ...] = (), starts: int = 3
) -> FitResult:
    r"""Fit a distribution to a table, (N, N), or to each of a stack, (B, N, N), by area-weighted L2.

    `model` is any distribution whose parameters have values: these are one start; others are what its class
    makes of the table (`AbstractNDF.guesses`) and up to `starts` minima over a grid of its shapes. Sought are
    the parameters with a declared range, within it, but for those named in `fixed`. Cells that are NaN do not
    count. The result has leaves () or (B,); `residuals` are D − T in the cells of the disk, row by row, NaN
    where the table has none, `cost` is 50 E² / Σ T² dA; `covariance` is the sandwich estimate.

    Raises ValueError for a model with channels, for a table with channels, a name in `fixed` that fits none,
    and a model without unknowns. A table that cannot be fitted is a status.
    """
    tables = np.asarray(table.values)
    if channel_count(model) is not None or tables.shape[-1] != tables.shape[-2]:
        raise ValueError("fit_ndf takes one distribution and tables without channels: fit each channel apart")
    warn_of_float32()
    space, given, _ = model_space(model, fixed)
    stack = tables.reshape(-1, *tables.shape[-2:])
    found = [_fit_table(space, given, values, table.extent, starts) for values in stack]
    together = Outcome(*[np.stack(part) for part in zip(*found, strict=True)])
    if tables.ndim == 2:
        together = Outcome(*[part.reshape(part.shape[1:]) for part in together])
    else:
        model = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (len(stack), *jnp.shape(leaf))), model)
    numbers, status, cost, steps, covariance, residuals = together
    fitted = space.fitted(model, jnp.asarray(numbers))
    return FitResult(fitted, status, cost, steps, covariance, residuals, space.names, "area-weighted L2")


def _fit_table(
    space: ModelSpace, given: np.ndarray, values: np.ndarray, extent: tuple[float, float], starts: int
) -> Outcome:
    m = disk_cells(len(values), extent).reshape(3, -1)
    inside = m[2] > 0
    held = values.reshape(-1)[inside]
    known = np.isfinite(held)
    total = np.sum(np.where(known, held, 0) ** 2)
    root = np.where(known, 10 / np.sqrt(total if total > 0 else 1), 0)
    cells = Cells(m.T[inside], root, np.where(known, held, 0))
    found = _minimum(space, given, cells, starts)
    numbers, covariance, residuals = (part[0] for part in map_lanes(_describe, found.t, (space, cells)))
    code = statuses(
        enough=np.array([np.sum(cells.values > 0) >= _FEWEST]),
        finite=np.isfinite(found.cost) & np.all(np.isfinite(numbers)),
        no_lobe=np.array([False]),
        converged=found.converged,
        on_bound=np.any((found.t < _EDGE) | (found.t > 1 - _EDGE), axis=1),
    )
    numbers = np.where(means_nothing(code), np.nan, numbers)
    residuals = np.where(known, residuals, np.nan)
    return Outcome(numbers, code[0], found.cost[0], found.steps[0], covariance, residuals)


def _minimum(space: ModelSpace, given: np.ndarray, cells: Cells, starts: int) -> LaneSolutions:
    """The lowest minimum that the starts lead to, of one lane."""
    few = cells.some()
    u = np.concatenate([given, _guesses(space, few), _grid_starts(space, few, starts)])
    tried = solve_lanes(_residual, np.clip(u, 0, 1), np.zeros(len(u)), (space, few), (0, 1), tolerance=1e-3)
    best = np.argmin(np.nan_to_num(tried.cost, nan=np.inf))
    found = solve_lanes(_residual, tried.t[[best]], np.zeros(1), (space, cells), (0, 1))
    return eqx.tree_at(lambda f: f.steps, found, found.steps + tried.steps[best])


def _guesses(space: ModelSpace, cells: Cells) -> np.ndarray:
    """What the distribution's own class makes of a table, as shares of the ranges (S, n)."""
    prototype = space.prototype
    assert isinstance(prototype, AbstractNDF)
    models = type(prototype).guesses(cells.m, cells.values, cells.root**2)
    return np.array([space.shares_of(model) for model in models]).reshape(-1, len(space.shapes))


def _grid_starts(space: ModelSpace, cells: Cells, most: int) -> np.ndarray:
    grid = unit_grid(_GRID, len(space.shapes))
    errors = np.asarray(_errors(grid, space, cells))
    return grid[grid_minima(np.where(np.isfinite(errors), errors, np.inf)[None], len(space.shapes), most)[1]]


@eqx.filter_jit
def _errors(grid, space: ModelSpace, cells: Cells):
    def error(u):
        return jnp.sum(_residual(u, (0, (space, cells))) ** 2)

    return jax.lax.map(error, jnp.asarray(grid))


def _residual(u, args):
    _, (space, cells) = args
    return cells.root * (_density(u, space, cells.m) - cells.values)


def _density(u, space: ModelSpace, m) -> Float[Array, " K"]:
    return space.model(u, jnp.zeros(0), [])._density(m)


def _describe(u, shared):
    """The parameters, their covariance, and D − T."""
    space, cells = shared
    slope = jnp.where((u < _EDGE) | (u > 1 - _EDGE), 0, safe_divide(1.0, space.slopes(u)))
    difference = _density(u, space, cells.m) - cells.values
    jacobian = jax.jacfwd(_density)(u, space, cells.m) * slope[None, :]
    return space.shape_values(u), sandwich(jacobian, difference, cells.root**2), difference
