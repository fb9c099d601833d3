r"""Densities over the unit square, bilinear between the nodes of a table, and the maps that flatten them.

A family of S tables (S, M, N) belongs to S values of a parameter; between those the tables are mixed
linearly. `corners` are the tables to be mixed at each point: pairs of an index and a weight, of the points'
shape. A point is a pair of arrays: x runs along a table's rows (N nodes), y across them (M nodes).

The maps are Mitsuba's `Marginal2D`, which the parameterisation of Dupuy & Jakob 2018 is built on: a point's
second coordinate goes by the marginal density, its first by the density along its row.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from operator import add
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxbrdf.special import safe_divide, safe_sqrt

Corners = Sequence[tuple[Int[Array, "..."], Float[Array, "..."]]]
Point = tuple[Float[Array, "..."], Float[Array, "..."]]


class SquareWarp(NamedTuple):
    """A family of densities, each with what is below a node along its row, and below each row."""

    density: Float[Array, "S M N"]
    along: Float[Array, "S M N"]
    across: Float[Array, "S M"]


def square_warp(table: Float[Array, "S M N"]) -> SquareWarp:
    """The densities proportional to a table ≥ 0; where one is 0 everywhere, the even density."""
    table = jnp.where(jnp.any(table > 0, axis=(-2, -1), keepdims=True), table, 1)
    along = _running(table) / (table.shape[-1] - 1)
    across = _running(along[..., -1]) / (table.shape[-2] - 1)
    total = across[..., -1]
    return SquareWarp(table / total[:, None, None], along / total[:, None, None], across / total[:, None])


def once(point: Point) -> Point:
    """The same point, computed once: XLA would do it anew for each of the numbers that are read there."""
    together = jax.lax.optimization_barrier(jnp.stack(point))
    return together[0], together[1]


def interpolate(table: Float[Array, "S M N"], corners: Corners, point: Point) -> Float[Array, "..."]:
    """The tables at a point of the square, mixed."""
    (column, x), (row, y) = (_cell(point[k], table.shape[2 - k]) for k in (0, 1))
    v00, v10, v01, v11 = _of_cell(table, corners, row, column)
    return (1 - y) * ((1 - x) * v00 + x * v10) + y * ((1 - x) * v01 + x * v11)


def flatten(warp: SquareWarp, corners: Corners, point: Point) -> tuple[Point, Float[Array, "..."]]:
    """Where the map takes a point, so that points of this density become evenly distributed; the density."""
    rows, columns = warp.density.shape[1:]
    (column, x), (row, y) = _cell(point[0], columns), _cell(point[1], rows)
    v00, v10, v01, v11 = _of_cell(warp.density, corners, row, column)
    before_0, before_1 = (_mix(warp.along, corners, row + k, column) for k in (0, 1))
    whole_0, whole_1, below = _of_row(warp, corners, row)
    left, right = (1 - y) * v00 + y * v01, (1 - y) * v10 + y * v11
    within = x * (left + x / 2 * (right - left)) / (columns - 1)
    first = safe_divide((1 - y) * before_0 + y * before_1 + within, (1 - y) * whole_0 + y * whole_1)
    second = below + y * (whole_0 + y / 2 * (whole_1 - whole_0)) / (rows - 1)
    return (first, second), (1 - x) * left + x * right


def unflatten(warp: SquareWarp, corners: Corners, u: Point) -> tuple[Point, Float[Array, "..."]]:
    """The point that `flatten` takes to u, and the density there: evenly distributed u give such points."""
    rows, columns = warp.density.shape[1:]
    row = _last_below(lambda row: _mix(warp.across, corners, row), u[1], rows)
    whole_0, whole_1, start = _of_row(warp, corners, row)
    y = _solve(whole_0, whole_1, (u[1] - start) * (rows - 1))
    target = u[0] * ((1 - y) * whole_0 + y * whole_1)

    def before(column):
        lower, upper = (_mix(warp.along, corners, row + k, column) for k in (0, 1))
        return (1 - y) * lower + y * upper

    column = _last_below(before, target, columns)
    v00, v10, v01, v11 = _of_cell(warp.density, corners, row, column)
    left, right = (1 - y) * v00 + y * v01, (1 - y) * v10 + y * v11
    x = _solve(left, right, (target - before(column)) * (columns - 1))
    point = (column + x) / (columns - 1), (row + y) / (rows - 1)
    return point, (1 - x) * left + x * right


def _running(values: Float[Array, "..."]) -> Float[Array, "..."]:
    """The trapezoid rule from the first node to each, along the last axis, in steps of 1."""
    steps = jnp.cumsum((values[..., 1:] + values[..., :-1]) / 2, axis=-1)
    return jnp.concatenate([jnp.zeros_like(values[..., :1]), steps], axis=-1)


def _cell(x: Float[Array, "..."], nodes: int) -> tuple[Int[Array, "..."], Float[Array, "..."]]:
    """The cell between two of `nodes` nodes over [0, 1] in which x lies, and how far into it."""
    position = jnp.clip(x, 0, 1) * (nodes - 1)
    index = jnp.minimum(position.astype(jnp.int32), nodes - 2)
    return index, position - index


def _of_cell(table, corners: Corners, row, column) -> list[Array]:
    """The four corners of a cell, mixed: along the row first."""
    return [_mix(table, corners, row + j, column + i) for j in (0, 1) for i in (0, 1)]


def _of_row(warp: SquareWarp, corners: Corners, row) -> tuple[Array, Array, Array]:
    """The integrals along the two rows of nodes of a row of cells, and what is below it; mixed."""
    whole = warp.along[..., -1]
    return _mix(whole, corners, row), _mix(whole, corners, row + 1), _mix(warp.across, corners, row)


def _mix(table: Float[Array, "S ..."], corners: Corners, *index: Int[Array, "..."]) -> Float[Array, "..."]:
    """The tables' numbers at an index, mixed; read one by one, of which XLA makes one loop."""

    def read(t):
        at = reduce(lambda at, axis: at * axis[0] + axis[1], zip(table.shape[1:], index, strict=True), t)
        return table.reshape(-1).at[at].get(mode="clip")

    return reduce(add, (read(t) * weight for t, weight in corners))


def _last_below(cumulative: Callable, target: Float[Array, "..."], nodes: int) -> Int[Array, "..."]:
    """The last of the nodes, but for the final one, where an increasing function is below the target."""

    def halve(_, interval):
        low, high = interval
        middle = (low + high) // 2
        is_below = cumulative(middle) <= target
        return jnp.where(is_below, middle, low), jnp.where(is_below, high, middle)

    low = jnp.zeros_like(target, jnp.int32)
    steps = (nodes - 1).bit_length()
    return jax.lax.fori_loop(0, steps, halve, (low, jnp.full_like(low, nodes - 1)))[0]


def _solve(start: Float[Array, "..."], end: Float[Array, "..."], area: Float[Array, "..."]):
    """t in [0, 1] at which ∫_0^t of a line from `start` ≥ 0 to `end` ≥ 0 is `area`."""
    root = safe_sqrt(start**2 + 2 * area * (end - start))
    return jnp.clip(safe_divide(2 * area, start + root), 0, 1)
