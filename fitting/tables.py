"""Tabulated distributions as fits see them: some at a time, the cells of the disk in a row."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbrdf.arrays import channel_count
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.tabulated import TabulatedNDF, cell_area, disk_cells

FEWEST = 8  # cells that hold something
_AT_ONCE = 2048  # tables, unless more are made of each


class Cells(NamedTuple):
    """The cells of a table's grid that lie in the disk: their normals, and the area of each on the disk."""

    m: Float[np.ndarray, "K 3"]
    area: float


def cells_of(table: TabulatedNDF) -> Cells:
    """The cells that a table, or a stack of them, has in the disk."""
    n = table.values.shape[-1]
    m = disk_cells(n, table.extent).reshape(3, -1)
    return Cells(m.T[m[2] > 0], cell_area(n, table.extent))


def in_parts(table: TabulatedNDF, at_once: int = _AT_ONCE) -> Iterator[Float[np.ndarray, "B K"]]:
    """The values of a stack of tables in the cells of `cells_of`, a part of the stack at a time."""
    n = table.values.shape[-1]
    inside = disk_cells(n, table.extent)[2].ravel() > 0
    stack = np.asarray(table.values).reshape(-1, n * n)
    for start in range(0, len(stack), at_once):
        part = stack[start : start + at_once]
        yield part if inside.all() else part[:, inside]


def check(model: AbstractNDF, table: TabulatedNDF) -> None:
    """Raises ValueError for a model or a table with channels, and for a stack of none."""
    shape = table.values.shape
    if 0 in shape:
        raise ValueError(f"a distribution is fitted to one table or more; found values of shape {shape}")
    if channel_count(model) is not None or shape[-1] != shape[-2]:
        raise ValueError(
            "a distribution is fitted to tables (N, N) or (B, N, N), both without channels: fit each channel "
            f"apart; found tables of shape {shape}"
        )
