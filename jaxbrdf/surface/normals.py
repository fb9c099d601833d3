r"""The distribution of a height map's normals: those of its facets, or of planes fitted around its points.

Each point of the map stands for dx · dy of the macro-surface, so that a count of normals is one of projected
area:  D = count / (n dA) in a cell of the disk, dA = (2/N)², and Σ D dA = 1 (Dong, Walter, Marschner &
Greenberg 2015, eq. 2 and section 5).
"""

from collections.abc import Callable, Iterable
from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbrdf.ndf.base import from_slopes
from jaxbrdf.ndf.tabulated import TabulatedNDF
from jaxbrdf.surface.heightfield import Heightfield
from jaxbrdf.surface.plane_fit import checked_sigma, plane_slopes

_SIZE = 1025


def facet_ndf(heightfield: Heightfield, size: int = _SIZE) -> TabulatedNDF:
    """The distribution of the facets: two triangles for each square of four points, weighed by area.

    Triangles with a missing corner are left out. `size` is N, odd for a cell at the normal itself. Detail
    below the wavelength counts fully here, which makes it wider than what reflects: see `filtered_ndf`.
    Raises ValueError where no triangle is whole.
    """
    return mean_ndf([heightfield], facet_cells, size)


def filtered_ndf(heightfield: Heightfield, sigma: float | None = None, size: int = _SIZE) -> TabulatedNDF:
    """The distribution of the normals of `filtered_normals` at the measured points.

    Dong et al. 2015, section 5. Raises ValueError as `filtered_normals`, and where no normal is known.
    """
    cells = partial(filtered_cells, sigma=checked_sigma(heightfield, sigma))
    return mean_ndf([heightfield], cells, size)


def filtered_normals(heightfield: Heightfield, sigma: float | None = None) -> Float[Array, "ny nx 3"]:
    r"""The normal at every pixel of the plane fitted to the heights around it, n ∝ (−∂z/∂x, −∂z/∂y, 1).

    Points weigh exp(−d²/2σ²) by their horizontal distance d, missing ones nothing. `sigma` σ is in µm: by
    default `default_sigma`, 1 µm or 1.5 pixels where these are coarser. Pixels that were not measured have a
    normal too; it is NaN where the weights of the points around do not spread enough to hold a plane (a
    determinant of their covariance below 1e-3 σ⁴): too few, or too nearly in a line. The slopes are linear
    in the heights. Raises ValueError for a sigma below the pixel size.
    """
    return _filtered_normals(heightfield, checked_sigma(heightfield, sigma))


Cells = Callable[[Heightfield, int], Int[np.ndarray, "..."]]


class NormalCounts:
    """How many normals fell into each cell of a table of `size` × `size`, over any number of maps.

    Only the counts are kept; every point of every map counts the same. `cells` is `facet_cells` or
    `filtered_cells`, or a `functools.partial` of it.
    """

    def __init__(self, cells: Cells, size: int = _SIZE):
        self._cells, self._size = cells, size
        self._counts = np.zeros(size * size, np.int64)

    def add(self, heightfield: Heightfield) -> int:
        """Counts the normals of one more map; returns how many there were."""
        cells = np.ravel(self._cells(heightfield, self._size))
        counts = np.bincount(cells, minlength=self._size**2 + 1)[:-1]
        self._counts += counts
        return int(counts.sum())

    def ndf(self) -> TabulatedNDF:
        """The distribution. Raises ValueError where nothing was counted."""
        total = self._counts.sum()
        if not total:
            raise ValueError("no normal is known: too few heights were measured next to one another")
        density = self._counts / (total * (2 / self._size) ** 2)
        return TabulatedNDF(density.reshape(self._size, self._size))


def mean_ndf(heightfields: Iterable[Heightfield], cells: Cells, size: int = _SIZE) -> TabulatedNDF:
    """The distribution of many maps, one after another in the memory of one; see `NormalCounts`."""
    counts = NormalCounts(cells, size)
    for heightfield in heightfields:
        counts.add(heightfield)
    return counts.ndf()


def facet_cells(heightfield: Heightfield, size: int) -> Int[np.ndarray, " n"]:
    """The cell of each triangle's normal in the flattened table; N² where a corner is missing."""
    return np.asarray(_facet_cells(heightfield, size))


def filtered_cells(
    heightfield: Heightfield, size: int, sigma: float | None = None
) -> Int[np.ndarray, "ny nx"]:
    """The cell of each pixel's filtered normal in the flattened table; N² where it is not to be counted."""
    return np.asarray(_filtered_cells(heightfield, size, checked_sigma(heightfield, sigma)))


@eqx.filter_jit
def known_slopes(
    heightfield: Heightfield, sigma: float
) -> tuple[Float[Array, "ny nx"], Float[Array, "ny nx"], Bool[Array, "ny nx"]]:
    """The slopes (q, r) of `plane_slopes` at every pixel, and where they count: where a height was measured
    and a plane was found."""
    q, r = plane_slopes(heightfield, sigma)
    return q, r, heightfield.valid & jnp.isfinite(q)


@eqx.filter_jit
def slope_cells(
    q: Float[Array, "..."],
    r: Float[Array, "..."],
    known: Bool[Array, "..."],
    size: int,
    extent: tuple[float, float] | Float[Array, "2"] = (1.0, 1.0),
) -> Int[Array, "..."]:
    """The cell of the normal of slopes (q, r) in the flattened table of a window of the disk; N² where it is
    not known, N² + 1 where it is outside the window. One program serves all extents that are arrays."""
    q, r = jnp.where(known, q, 0), jnp.where(known, r, 0)
    scale = size / (2 * jnp.sqrt(1 + q**2 + r**2))
    x, y = (t * scale / half for t, half in zip((q, r), extent, strict=True))
    column, row = (jnp.clip((size / 2 - t).astype(jnp.int32), 0, size - 1) for t in (x, y))
    cell = row * size + column
    for t, half in zip((x, y), extent, strict=True):
        cell = jnp.where((jnp.abs(t) > size / 2) & (half < 1), size * size + 1, cell)
    return jnp.where(known, cell, size * size)


@eqx.filter_jit
def _filtered_normals(heightfield: Heightfield, sigma: float) -> Float[Array, "ny nx 3"]:
    q, r = plane_slopes(heightfield, sigma)
    return from_slopes(-q, -r)


@eqx.filter_jit
def _facet_cells(heightfield: Heightfield, size: int):
    z, known = heightfield.z, heightfield.valid
    along_x, along_y = jnp.diff(z, axis=1) / heightfield.dx, jnp.diff(z, axis=0) / heightfield.dy
    square = known[:-1, :-1], known[:-1, 1:], known[1:, :-1], known[1:, 1:]
    lower = slope_cells(along_x[:-1], along_y[:, :-1], square[0] & square[1] & square[2], size)
    upper = slope_cells(along_x[1:], along_y[:, 1:], square[1] & square[2] & square[3], size)
    return jnp.concatenate([lower.ravel(), upper.ravel()])


@eqx.filter_jit
def _filtered_cells(heightfield: Heightfield, size: int, sigma: float):
    return slope_cells(*known_slopes(heightfield, sigma), size)
