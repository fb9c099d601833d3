r"""Densities over the unit square, bilinear between the nodes of a table, and the maps that flatten them.

A family of S tables (S, M, N) belongs to S values of a parameter; between those the tables are mixed
linearly. `corners` are the tables to be mixed at each point: pairs of an index and a weight, of the points'
shape. The first coordinate of a point runs along a table's rows (N nodes), the second across them (M nodes).

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
Point = Float[Array, "... 2"]


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


def interpolate(table: Float[Array, "S M N"], corners: Corners, point: Point) -> Float[Array, "..."]:
    """The tables at a point of the square, mixed."""
    (column, x), (row, y) = (_cell(point[..., k], table.shape[2 - k]) for k in (0, 1))
    v = _mix(_cells(table), corners, row, column)
    return (1 - y) * ((1 - x) * v[0] + x * v[1]) + y * ((1 - x) * v[2] + x * v[3])


def flatten(warp: SquareWarp, corners: Corners, point: Point) -> tuple[Point, Float[Array, "..."]]:
    """Where the map takes a point, so that points of this density become evenly distributed; the density."""
    rows, columns = warp.density.shape[1:]
    (column, x), (row, y) = (_cell(point[..., k], n) for k, n in ((0, columns), (1, rows)))
    packed = jnp.concatenate([_cells(warp.density), _pairs_across(warp.along)], axis=-1)
    v00, v10, v01, v11, before_0, before_1 = _mix(packed, corners, row, column)
    whole_0, whole_1, below = _mix(_rows(warp), corners, row)
    left, right = (1 - y) * v00 + y * v01, (1 - y) * v10 + y * v11
    within = x * (left + x / 2 * (right - left)) / (columns - 1)
    first = safe_divide((1 - y) * before_0 + y * before_1 + within, (1 - y) * whole_0 + y * whole_1)
    second = below + y * (whole_0 + y / 2 * (whole_1 - whole_0)) / (rows - 1)
    return jnp.stack([first, second], axis=-1), (1 - x) * left + x * right


def unflatten(warp: SquareWarp, corners: Corners, u: Point) -> tuple[Point, Float[Array, "..."]]:
    """The point that `flatten` takes to u, and the density there: evenly distributed u give such points."""
    rows, columns = warp.density.shape[1:]

    def below(row):
        return _mix(warp.across[..., None], corners, row)[0]

    row = _last_below(below, u[..., 1], rows)
    whole_0, whole_1, start = _mix(_rows(warp), corners, row)
    y = _solve(whole_0, whole_1, (u[..., 1] - start) * (rows - 1))
    target = u[..., 0] * ((1 - y) * whole_0 + y * whole_1)
    between = _pairs_across(jnp.pad(warp.along, ((0, 0), (0, 0), (0, 1))))

    def before(column):
        lower, upper = _mix(between, corners, row, column)
        return (1 - y) * lower + y * upper

    column = _last_below(before, target, columns)
    v00, v10, v01, v11 = _mix(_cells(warp.density), corners, row, column)
    left, right = (1 - y) * v00 + y * v01, (1 - y) * v10 + y * v11
    x = _solve(left, right, (target - before(column)) * (columns - 1))
    point = jnp.stack([(column + x) / (columns - 1), (row + y) / (rows - 1)], axis=-1)
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


def _cells(table: Float[Array, "S M N"]) -> Float[Array, "S m n 4"]:
    """The four corners of each cell side by side: one run of memory is read faster than four numbers."""
    return jnp.stack([table[:, :-1, :-1], table[:, :-1, 1:], table[:, 1:, :-1], table[:, 1:, 1:]], axis=-1)


def _pairs_across(along: Float[Array, "S M N"]) -> Float[Array, "S m n 2"]:
    return jnp.stack([along[:, :-1, :-1], along[:, 1:, :-1]], axis=-1)


def _rows(warp: SquareWarp) -> Float[Array, "S m 3"]:
    """Of each row of cells the integrals along its two rows of nodes, and what is below it."""
    whole = warp.along[..., -1]
    return jnp.stack([whole[:, :-1], whole[:, 1:], warp.across[:, :-1]], axis=-1)


def _mix(packed: Float[Array, "S *cells k"], corners: Corners, *index: Int[Array, "..."]) -> list[Array]:
    """The numbers at a cell of the tables, mixed over `corners`: k arrays of the index's shape."""
    mixed = reduce(add, (packed[(table, *index)] * weight[..., None] for table, weight in corners))
    return [mixed[..., k] for k in range(packed.shape[-1])]


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
