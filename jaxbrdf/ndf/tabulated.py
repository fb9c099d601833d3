"""A distribution given by its values on a grid over the unit disk."""

from collections.abc import Iterable
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbrdf.arrays import in_chunks, parameter
from jaxbrdf.directions import Direction
from jaxbrdf.ndf.base import AbstractNDF, AbstractVisibleNDF
from jaxbrdf.special import safe_divide, safe_sqrt


def _halves(extent: Iterable[float]) -> tuple[float, ...]:
    return tuple(float(half) for half in extent)


class TabulatedNDF(AbstractVisibleNDF):
    r"""A table of D over the unit disk of (m_x, m_y), or a window of it: each cell holds one value.

        values[i, j] = D  at  m_x = e_x ((2j+1)/N − 1),   m_y = e_y ((2i+1)/N − 1)

    `values` (N, N), or (N, N, C), in 1/sr; an odd N puts one cell on the normal. `extent` (e_x, e_y), each in
    (0, 1], is half of the window's sides: the whole disk by default, less for a narrow distribution, of which
    a small table of the disk would hold a few cells. A cell's solid angle is dA / cos θ with dA = 4 e_x e_y /
    N², so that Σ D dA = 1 for a normalised table (Dong et al. 2015, section 5); nothing is renormalised here.
    D is 0 outside the window, and cells whose centre lies outside the disk count as zero. A stack of tables,
    (B, N, N), is a batch: vmap over it; all have one window. Raises ValueError for values of another shape
    and another extent.
    """

    values: Float[Array, "..."] = parameter(rank=2)  # (N, N), (N, N, C); or a batch of them
    extent: tuple[float, float] = eqx.field(static=True, converter=_halves, default=(1.0, 1.0))

    def __check_init__(self):
        if len(self.extent) != 2 or not all(0 < half <= 1 for half in self.extent):
            raise ValueError(
                "TabulatedNDF: extent must be two numbers, each greater than 0 and at most 1; found "
                f"{self.extent}"
            )
        shape = self.values.shape
        if not any(a == b for a, b in pairwise(shape[:3])):
            raise ValueError(
                "TabulatedNDF: values must have shape (N, N) or (N, N, C), or (B, N, N) for a batch; found "
                f"{shape}"
            )

    @property
    def is_isotropic(self) -> bool:
        return False

    def _density(self, m: Direction) -> Float[Array, "..."]:
        n, e = self.values.shape[0], self.extent
        column, row = (jnp.clip((m[..., k] / e[k] + 1) * (n / 2), 0, n - 1).astype(int) for k in (0, 1))
        return jnp.where(self._in_window(m) & (m[..., 2] > 0), self._inside()[row, column], 0)

    def _in_window(self, m: Direction) -> Bool[Array, "..."]:
        """An axis of full extent holds everything, the last digit of a unit vector's length too."""
        inside = jnp.ones(m.shape[:-1], bool)
        for k, half in enumerate(self.extent):
            inside = inside & (jnp.abs(m[..., k]) <= half) if half < 1 else inside
        return inside

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        """σ(w) = Σ_cells (w·m)+ D dA / m_z, a few directions at a time."""
        m, weight = self._cells(), self._inside() * self._solid_angles()

        def area(x, y, z):
            cosine = x[..., None, None] * m[0] + y[..., None, None] * m[1] + z[..., None, None] * m[2]
            return jnp.sum(jnp.maximum(cosine, 0) * weight, axis=(-2, -1))

        return in_chunks(area, w[..., 0], w[..., 1], w[..., 2], size=max(1, 2**22 // weight.size))

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        """A cell with probability ∝ D dA, and a point in it: see `_draw`."""
        return self._draw(jnp.cumsum(self._inside().reshape(-1)), u)

    def _sample_visible(self, u: Float[Array, "... 2"], w: Direction) -> Direction:
        """A cell with probability ∝ (w·m)+ D dA / m_z, and a point in it: see `_draw`.

        Each direction costs a pass over the table: for many normals seen from one direction, give w as (3,).
        """
        m, weight = self._cells(), self._inside() * self._solid_angles()

        def cumulative(w):
            cosine = w[0] * m[0] + w[1] * m[1] + w[2] * m[2]
            return jnp.cumsum((jnp.maximum(cosine, 0) * weight).reshape(-1))

        if w.ndim == 1:
            return self._draw(cumulative(w), u)
        pairs = u.reshape(-1, 2), w.reshape(-1, 3)
        return jax.lax.map(lambda uw: self._draw(cumulative(uw[1]), uw[0]), pairs).reshape(w.shape)

    def sample_facing(self, u: Float[Array, "... 2"], w: Direction) -> Direction:
        """Plain normals: visible ones would cost a pass over the table for each w."""
        return self._sample(u)

    def facing_density(self, m: Direction, w: Direction) -> Float[Array, "..."]:
        return AbstractNDF.facing_density(self, m, w)

    def _draw(self, cumulative: Float[Array, " cells"], u: Float[Array, "... 2"]) -> Direction:
        """A cell by u_1, with what is left of u_1 and with u_2 evenly in the cell; near the rim the point is
        drawn back onto the disk. Borders of cells, where rounding may end in a neighbour, are left out."""
        n = self.values.shape[0]
        target = u[..., 0] * cumulative[-1]
        cell = jnp.clip(jnp.searchsorted(cumulative, target, side="right"), 0, n * n - 1)
        before = jnp.where(cell > 0, cumulative[cell - 1], 0)
        border = 4 * n * jnp.finfo(u.dtype).eps
        inside = border + (1 - 2 * border) * jnp.stack(
            [safe_divide(target - before, cumulative[cell] - before), u[..., 1]]
        )
        m_x = self.extent[0] * (2 * (cell % n + inside[0]) / n - 1)
        m_y = self.extent[1] * (2 * (cell // n + inside[1]) / n - 1)
        rim = jnp.maximum(safe_sqrt(m_x**2 + m_y**2), 1)
        m_x, m_y = m_x / rim, m_y / rim
        return jnp.stack([m_x, m_y, safe_sqrt(1 - m_x**2 - m_y**2)], axis=-1)

    def _cells(self) -> np.ndarray:
        return disk_cells(self.values.shape[0], self.extent).astype(self.values.dtype)

    def _inside(self) -> Float[Array, "N N"]:
        return jnp.where(self._cells()[2] > 0, self.values, 0)

    def _solid_angles(self) -> np.ndarray:
        m_z = self._cells()[2]
        area = cell_area(len(m_z), self.extent)
        return np.where(m_z > 0, area / np.where(m_z > 0, m_z, 1), 0)


def disk_cells(n: int, extent: tuple[float, float] = (1.0, 1.0)) -> np.ndarray:
    """The normals at the centres of a table's cells, (3, N, N); outside the disk m_z is 0."""
    centre = (2 * np.arange(n) + 1) / n - 1
    m_x, m_y = np.meshgrid(extent[0] * centre, extent[1] * centre)
    return np.stack([m_x, m_y, np.sqrt(np.maximum(1 - m_x**2 - m_y**2, 0))])


def cell_area(n: int, extent: tuple[float, float] = (1.0, 1.0)) -> float:
    """dA, what one cell of a table covers of the disk."""
    return (2 / n) ** 2 * (extent[0] * extent[1])
