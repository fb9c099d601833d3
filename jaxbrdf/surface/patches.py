"""The distribution of normals in each part of a height map: how a surface differs from place to place."""

from collections.abc import Iterator
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbrdf.ndf.tabulated import TabulatedNDF, cell_area
from jaxbrdf.surface.heightfield import Heightfield, Lengths, pair
from jaxbrdf.surface.normals import known_slopes, slope_cells
from jaxbrdf.surface.plane_fit import checked_sigma

_SHARE = 0.99  # of the map's normals that the window holds along each axis
_LEAST = 1e-6  # half a window: float32 hardly tells nearer normals apart
_SLACK = 1e-6  # by which the last normal of the share lies inside, however it is rounded


class PatchNDFs(eqx.Module):
    """The distributions of a map's patches, row by row: patch k = i · columns + j, i counting along y.

    `tables` is a stack (B, N, N), `counts` (B,) how many normals are known in each patch: D's standard error
    in a cell is √(D / (count · dA)). `shape` is (rows, columns), B their product; `size`, `stride` and
    `pixel` are (x, y) in µm. Raises ValueError where their numbers of patches differ.
    """

    tables: TabulatedNDF
    counts: Int[Array, "..."] = eqx.field(converter=jnp.asarray)
    shape: tuple[int, int] = eqx.field(static=True)
    size: tuple[float, float] = eqx.field(static=True)
    stride: tuple[float, float] = eqx.field(static=True)
    pixel: tuple[float, float] = eqx.field(static=True)

    def __check_init__(self):
        numbers = len(self.tables.values), len(self.counts), self.shape[0] * self.shape[1]
        if len(set(numbers)) > 1:
            raise ValueError(
                "PatchNDFs: tables, counts and shape must be of one number of patches; found "
                + ", ".join(map(str, numbers))
            )

    @property
    def values(self) -> Float[Array, "B N N"]:
        """D in 1/sr: those of `tables`."""
        return self.tables.values

    @property
    def centres(self) -> Float[np.ndarray, "B 2"]:
        """Where the patches are, (x, y) in µm; the map's first pixel is at 0."""
        y, x = np.indices(self.shape).reshape(2, -1)
        first = (np.array(self.size) - self.pixel) / 2
        return first + np.stack([x, y], axis=-1) * self.stride

    def image(self, a: Array | np.ndarray) -> Array | np.ndarray:
        """An array with one entry for each patch, (B, ...), as an image, (rows, columns, ...).

        Row 0 is at y = 0. Raises ValueError for another number of entries.
        """
        if a.shape[:1] != self.counts.shape:
            raise ValueError(
                f"image takes one entry for each of the {len(self.counts)} patches; found shape {a.shape}"
            )
        return a.reshape(*self.shape, *a.shape[1:])


def patch_ndfs(
    heightfield: Heightfield,
    size: Lengths,
    stride: Lengths | None = None,
    *,
    sigma: float | None = None,
    cells: int = 65,
    extent: float | tuple[float, float] | None = None,
) -> PatchNDFs:
    r"""The distribution of normals in each patch of a map: small tables over one window of the disk.

        D = count / (n dA),   dA = 4 e_x e_y / N²,   n the number of all normals known in the patch

    Dong, Walter, Marschner & Greenberg 2015, sections 8 and 9 and figure 11. The normals are those of
    `filtered_normals` with `sigma`, of the whole map: patches have no borders of their own. `size` and
    `stride` are µm, one number or (x, y), rounded to whole pixels; the patches start at the first pixel, side
    by side unless there is a stride, and what is left at the far end, less than a patch, is dropped.

    A table has `cells` N on a side; `extent` is the window's (e_x, e_y). By default that is, along each axis,
    the half width that holds 99 % of the map's normals, at most 1: few normals in the tail would else make
    all cells large. Of a Trowbridge–Reitz (GGX) map it is 7 α, so that a cell of 65 is α/5; of a Beckmann one
    1.8 α, and α/18. Normals outside the window count in n: D is not biased, and Σ D dA ≤ 1. A patch without
    any normal is NaN, its count 0.

    Tables take 4 B N² bytes, twice that where JAX runs in float64. Not for use inside jit. Raises ValueError
    for a patch of less than 2 × 2 pixels or larger than the map, a stride of less than a pixel, an extent
    outside (0, 1], no cells, a sigma below the pixel size, and a map without a known normal.
    """
    x, y = (_Tiles.of(*along) for along in _along_axes(heightfield, size, stride))
    if cells < 1:
        raise ValueError(f"patch_ndfs: a table has at least one cell; found {cells}")
    slopes = known_slopes(heightfield, checked_sigma(heightfield, sigma))
    q, r, known = (np.asarray(a) for a in slopes)
    if not known.any():
        raise ValueError("no normal is known: too few heights were measured next to one another")
    window = _window(q[known], r[known]) if extent is None else _checked(extent)
    cell = np.asarray(slope_cells(*slopes, cells, jnp.asarray(window, slopes[0].dtype)))
    values, counts = _tables((cell[i, j] for i in y for j in x), len(y) * len(x), cells, window)
    return PatchNDFs(
        TabulatedNDF(jnp.asarray(values), window),
        jnp.asarray(counts),
        (len(y), len(x)),
        (x.size * heightfield.dx, y.size * heightfield.dy),
        (x.stride * heightfield.dx, y.stride * heightfield.dy),
        (heightfield.dx, heightfield.dy),
    )


@dataclass(frozen=True)
class _Tiles:
    """The patches along one axis, in pixels."""

    number: int
    size: int
    stride: int

    @classmethod
    def of(cls, axis: str, pixels: int, pixel: float, size: float, stride: float) -> "_Tiles":
        wide, step = np.rint(size / pixel), np.rint(stride / pixel)
        if not 2 <= wide <= pixels:
            raise ValueError(
                f"patch_ndfs: along {axis} a patch must be at least two pixels, {2 * pixel:g} µm, and at "
                f"most the map, {pixels * pixel:g} µm; found {size:g} µm"
            )
        if not 1 <= step < np.inf:
            raise ValueError(
                f"patch_ndfs: along {axis} the stride must be at least one pixel, {pixel:g} µm; found "
                f"{stride:g} µm"
            )
        return cls(1 + int((pixels - wide) // step), int(wide), int(step))

    def __len__(self) -> int:
        return self.number

    def __iter__(self) -> Iterator[slice]:
        return (slice(k * self.stride, k * self.stride + self.size) for k in range(self.number))


def _along_axes(heightfield: Heightfield, size: Lengths, stride: Lengths | None):
    """What `_Tiles.of` takes, of x and of y."""
    pixels, pixel = heightfield.z.shape[::-1], (heightfield.dx, heightfield.dy)
    return zip("xy", pixels, pixel, pair(size), pair(size if stride is None else stride), strict=True)


def _checked(extent: float | tuple[float, float]) -> tuple[float, float]:
    window = pair(extent)
    if not all(0 < half <= 1 for half in window):
        raise ValueError(
            f"patch_ndfs: extent must be greater than 0 and at most 1, the rim of the disk; found {extent}"
        )
    return window


def _window(q: np.ndarray, r: np.ndarray) -> tuple[float, float]:
    """The half widths within which most normals are."""
    length = np.sqrt(1 + q**2 + r**2)
    x, y = (float(np.quantile(np.abs(t) / length, _SHARE, method="higher")) for t in (q, r))
    return _rounded_up(x), _rounded_up(y)


def _rounded_up(half: float) -> float:
    return min(1.0, max(_LEAST, half * (1 + _SLACK)))


def _tables(
    patches: Iterator[np.ndarray], number: int, size: int, window: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """D (B, N, N) and the number of normals (B,), one patch after another in little memory."""
    values = np.empty((number, size, size), jnp.result_type(float))
    counts = np.empty(number, int)
    for k, patch in enumerate(patches):
        held = np.bincount(patch.ravel(), minlength=size**2 + 2)  # last those unknown and those outside
        counts[k] = patch.size - held[-2]
        density = held[:-2].reshape(size, size) / (max(counts[k], 1) * cell_area(size, window))
        values[k] = density if counts[k] else np.nan
    return values, counts
