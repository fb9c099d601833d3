r"""Fits of any distribution of normals to a tabulated one.

    E² = Σ_cells (D(m) − T)² dA,   dA the area of a cell on the disk

over the cells of the disk, empty ones too: they say where no normals are; or the likelihood of the normals
that were counted in them. Starts are tried at some of the cells, drawn by what they hold; the best is refined
at all.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fitting.covariance import sandwich
from fitting.least_squares import LaneSolutions, map_lanes, solve_grams
from fitting.model_space import ModelSpace, model_space
from fitting.outcome import Outcome, joined, means_nothing, statuses, warn_of_float32
from fitting.parameters import unit_grid
from fitting.starts import grid_minima, lowest, lowest_points
from fitting.table_loss import TableLoss, difference, table_loss
from fitting.tables import FEWEST, Cells, cells_of, check, in_parts
from jaxbrdf.fit_result import FitResult
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.tabulated import TabulatedNDF

_SOME = 16384  # cells at which starts are tried
_GRID = 256  # shapes to start from
_OF_MIXTURES = 4  # times as many starts: minima with parts exchanged lie close together on the grid
_EDGE = 1e-4  # shares of a range nearer than this to its end are on the bound


class Problem(NamedTuple):
    """What tables on one grid have in common, and the tables: `scale` is what their residuals are multiplied
    by, table by table, and cell by cell where these are drawn."""

    space: ModelSpace
    loss: TableLoss
    m: Float[np.ndarray, "K 3"]
    area: float
    values: Float[np.ndarray, "B K"]
    scale: Float[np.ndarray, "B k"]

    @property
    def lanes(self) -> tuple[np.ndarray, np.ndarray]:
        return self.values, self.scale

    @property
    def shared(self) -> tuple[ModelSpace, TableLoss, np.ndarray]:
        return self.space, self.loss, self.m

    def some(self) -> "Problem":
        """Some of the cells of a large table, half drawn evenly and half by what they hold, and weighed by
        how rarely."""
        count = len(self.m)
        if count <= _SOME or len(self.values) > 1:
            return self
        held = (
            np.nan_to_num(self.values[0]).astype(float) ** 2 + 1e-300
        )  # evenly where nothing is held at all
        chance = 0.5 / count + 0.5 * held / held.sum()
        rows = np.sort(np.random.default_rng(0).choice(count, _SOME, p=chance / chance.sum()))
        scale = self.scale / np.sqrt(_SOME * chance[rows])[None, :]
        return self._replace(m=self.m[rows], values=self.values[:, rows], scale=scale)


def fit_ndf(
    model: AbstractNDF,
    table: TabulatedNDF,
    *,
    loss: str = "l2",
    fixed: tuple[str, ...] = (),
    starts: int = 3,
) -> FitResult:
    r"""Fit a distribution to a table, (N, N), or to each of a stack, (B, N, N).

    `loss` is 'l2', E² above, or 'likelihood', for tables that are counts of normals: KL = Σ (T log(T/D) − T +
    D) dA, by which the log-likelihood of each normal is below its highest value. `model` is any distribution
    whose parameters have values: these are one start; others are what its class makes of the table
    (`AbstractNDF.guesses`) and up to `starts` minima over a grid of its shapes. Sought are the parameters
    with a declared range, within it, but for those named in `fixed`. Cells that are NaN do not count.

    Of a `Mixture` Σ s_i D_i the shares are sought too, all but the last, which is s_K = 1 − s_1 − …: they are
    "shares[0]", …, and kept by "shares" in `fixed`. Its parts come in no order. Its starts are the 4 `starts`
    lowest points of the grid, since minima with parts exchanged lie close together there.

    The result has leaves () or (B,); `residuals` are D − T in the cells of the disk, row by row, NaN where
    the table has none, `cost` is 50 E² / Σ T² dA, or 100 KL; `covariance` is the sandwich estimate. For many
    small tables `fit_ndf_patches` is faster.

    Raises ValueError for a model with channels, for a table with channels, an unknown loss, a name in `fixed`
    that fits none, and a model without unknowns. A table that cannot be fitted is a status.
    """
    check(model, table)
    warn_of_float32()
    space, given, _ = model_space(model, fixed)
    cells, minimised = cells_of(table), table_loss(loss)
    one_by_one = (row[None] for part in in_parts(table) for row in part)
    together = joined([fit_lanes(space, given, cells, row, minimised, starts) for row in one_by_one])
    if table.values.ndim == 2:
        together = Outcome(*[part.reshape(part.shape[1:]) for part in together])
    return as_result(model, space, together, minimised)


def as_result(model: AbstractNDF, space: ModelSpace, outcome: Outcome, loss: TableLoss) -> FitResult:
    """The record of a fit of one table, or of a stack."""
    fitted = space.fitted_each if np.ndim(outcome.status) else space.fitted
    return outcome.result(fitted(model, jnp.asarray(outcome.numbers)), space.names, loss.name)


def fit_lanes(
    space: ModelSpace, given: np.ndarray, cells: Cells, values: np.ndarray, loss: TableLoss, starts: int
) -> Outcome:
    """What came of each of some tables, (B, K)."""
    scale = np.asarray(jax.vmap(loss.scale, (0, None))(jnp.asarray(values, float), cells.area))
    problem = Problem(space, loss, *cells, values, scale[:, None])
    found = _minima(problem, given, starts)
    numbers, covariance, residuals = map_lanes(_describe, (found.t, values), problem.shared)
    code = statuses(
        enough=np.sum(values > 0, axis=1) >= FEWEST,
        finite=np.isfinite(found.cost) & np.all(np.isfinite(numbers), axis=1),
        no_lobe=np.zeros(len(values), bool),
        converged=found.converged,
        on_bound=np.any((found.t < _EDGE) | (found.t > 1 - _EDGE), axis=1),
    )
    numbers = np.where(means_nothing(code)[:, None], np.nan, numbers)
    return Outcome(numbers, code, found.cost, found.steps, covariance, residuals)


def _minima(problem: Problem, given: np.ndarray, starts: int) -> LaneSolutions:
    """The lowest minimum that the starts of each table lead to."""
    few = problem.some()
    lane, u = _starts(few, given, starts)
    lanes = [part[lane] for part in few.lanes]
    tried = solve_grams(_gram, np.clip(u, 0, 1), lanes, few.shared, (0, 1), tolerance=1e-3)
    best = lowest(tried.cost, lane, len(problem.values))
    found = solve_grams(_gram, tried.t[best], problem.lanes, problem.shared, (0, 1))
    return eqx.tree_at(lambda f: f.steps, found, found.steps + tried.steps[best])


def _starts(few: Problem, given: np.ndarray, most: int) -> tuple[Int[np.ndarray, " S"], np.ndarray]:
    """Where to start: tables (S,) and shares (S, n)."""
    n, count = len(few.space.shapes), len(few.values)
    grid = unit_grid(_GRID, n)
    errors = np.asarray(_errors(grid, few.shared, few.lanes)).T
    errors = np.where(np.isfinite(errors), errors, np.inf)
    if few.space.leaves_of_shares:
        lane, point = lowest_points(errors, _OF_MIXTURES * most)
    else:
        lane, point = grid_minima(errors, n, most)
    guesses = [_guesses(few, k) for k in range(count)]
    own = np.repeat(np.arange(count), [len(given) + len(guess) for guess in guesses])
    starts = [part for guess in guesses for part in (given, guess)]
    return np.append(own, lane), np.concatenate([*starts, grid[point]])


def _guesses(few: Problem, k: int) -> np.ndarray:
    """What the distribution's own class makes of a table, as shares of the ranges (S, n)."""
    prototype = few.space.prototype
    assert isinstance(prototype, AbstractNDF)
    weight = np.broadcast_to(few.scale[k] ** 2, len(few.m))
    models = type(prototype).guesses(few.m, np.nan_to_num(few.values[k]), weight)
    return np.array([few.space.shares_of(model) for model in models]).reshape(-1, len(few.space.shapes))


@eqx.filter_jit
def _errors(grid, shared, lanes):
    """What is minimised, of each shape of a grid with each table, (G, B)."""
    space, loss, m = shared

    def error(D, values, scale):
        return jnp.sum(scale**2 * loss.loss(D, values))

    def errors(u):
        return jax.vmap(error, (None, 0, 0))(_density(u, space, m), *lanes)

    return jax.lax.map(errors, jnp.asarray(grid))


def _gram(u, args):
    (values, scale), (space, loss, m) = args
    J, D = jax.jacfwd(lambda u: (_density(u, space, m),) * 2, has_aux=True)(u)
    return loss.gram(D, values, J, scale)


def _density(u, space: ModelSpace, m) -> Float[Array, " K"]:
    return space.model(u, jnp.zeros(0), [])._density(m)


def _describe(lane, shared):
    """The parameters, their covariance, and D − T."""
    (u, values), (space, loss, m) = lane, shared
    D = _density(u, space, m)
    by_u = jax.jacfwd(_density)(u, space, m)
    jacobian = space.by_parameters(by_u, u, (u < _EDGE) | (u > 1 - _EDGE))
    covariance = sandwich(jacobian, difference(D, values), loss.weight(D, values))
    return space.shape_values(u), covariance, D - values
