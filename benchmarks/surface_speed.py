r"""How fast are the normals of a height map? Our banded products against the same sums by scipy.ndimage.

    python benchmarks/surface_speed.py [--repeat N] [--scans N]

Scans are simulated: 640 × 480 heights in float32, 0.11 µm apart as in Dong et al. 2015, or 0.35 µm; planes
are fitted with σ = 1 µm. The rival is scipy.ndimage at its best: one-dimensional Gaussian filters of orders
0, 1 and 2, which are sums of w, w u and w u², each pass shared by all sums that need it (5 passes where
nothing is missing, 14 where 3 % are), in float32 and cut off where ours are; once a scan at a time, and once
as many scans at a time as there are cores. Only its sums are timed, while ours end with normals; that both
give the same normals, border and all, is shown in the last column. Last, a data set is streamed: one table of
1025 × 1025 cells of all scans, the largest memory of the process, and by how much it grew after a tenth.
"""

import argparse
import os
import resource
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.ndimage import gaussian_filter1d

from jaxbrdf import Heightfield, filtered_normals, gaussian_surface, mean_ndf
from jaxbrdf.surface.normals import Cells, facet_cells, filtered_cells
from jaxbrdf.surface.plane_fit import REACH

SHAPE, SIGMA, MISSING = (480, 640), 1.0, 0.03
PIXELS = (0.11, 0.35)  # µm


def timed(function: Callable, repeat: int) -> tuple[float, object]:
    """The median seconds of `repeat` calls after a first one, and the last result."""
    function()
    seconds = []
    for _ in range(repeat):
        begin = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds)), result


def simulated(pixel: float, missing: float) -> Heightfield:
    """A rough scan, a share of whose heights is missing; None of them masked if it is 0."""
    z = np.asarray(gaussian_surface(jax.random.key(0), SHAPE, pixel, 0.3, 4.0).z, np.float32)
    mask = np.random.default_rng(1).random(SHAPE) >= missing if missing else None
    return Heightfield(z, pixel, pixel, mask)


# The rival: u is the distance in units of σ; a filter of order 1 gives Σ w u, of order 2 Σ w (u² − 1).


def sums(a: np.ndarray, power: int, axis: int, pixel: float) -> np.ndarray:
    """Σ w u^power a along an axis, but for what `power` 2 lacks; points outside the map weigh nothing."""
    options = {"mode": "constant", "truncate": REACH}
    return gaussian_filter1d(a, SIGMA / pixel, axis, power, **options) * np.float32((SIGMA / pixel) ** power)


def complete_sums(z: np.ndarray, pixel: float, weights: tuple) -> tuple[np.ndarray, ...]:
    """Slopes (q, r), in five passes; the sums of weights along each axis are the same for every scan."""
    (wx, ux, vx), (wy, uy, vy) = weights
    rows = sums(z, 0, 1, pixel)
    along = (sums(z, 1, 1, pixel) - ux * rows) / vx
    level = rows / wx
    q = sums(along, 0, 0, pixel) / wy[:, None]
    r = (sums(level, 1, 0, pixel) - uy[:, None] * sums(level, 0, 0, pixel)) / vy[:, None]
    return q, r


def axis_weights(pixel: float) -> tuple:
    """For x and y: Σ w, the mean of u, and Σ w (u − mean)²; all of them float32."""

    def of(n):
        w, wu, wuu = (sums(np.ones(n), power, 0, pixel) for power in range(3))
        wuu = wuu + w
        return tuple(a.astype(np.float32) for a in (w, wu / w, wuu - wu**2 / w))

    return of(SHAPE[1]), of(SHAPE[0])


def partial_sums(z: np.ndarray, c: np.ndarray, pixel: float) -> tuple[np.ndarray, ...]:
    """The nine sums of the normal equations in fourteen passes: 1, u, v, uu, uv, vv, then z, uz, vz."""
    c0, c1, c2 = (sums(c, power, 1, pixel) for power in range(3))
    z0, z1 = (sums(z, power, 1, pixel) for power in range(2))
    pairs = ((c0, 0), (c1, 0), (c0, 1), (c2, 0), (c1, 1), (c0, 2), (z0, 0), (z1, 0), (z0, 1))
    return tuple(sums(rows, power, 0, pixel) for rows, power in pairs)


def partial_slopes(moments: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """What is left to do with the nine sums, which is not timed."""
    w, *rest = (a.astype(float) for a in moments)
    u, v, uu, uv, vv, z, uz, vz = (a / w for a in rest)
    uu, uv, vv, uz, vz = uu + 1 - u**2, uv - u * v, vv + 1 - v**2, uz - u * z, vz - v * z
    det = uu * vv - uv**2
    return (uz * vv - vz * uv) / det, (vz * uu - uz * uv) / det


def rival(scan: Heightfield) -> tuple[Callable, Callable]:
    """The sums of a scan by scipy, and what makes slopes in units of σ of them."""
    z = np.asarray(scan.heights)
    if scan.mask is None:
        weights = axis_weights(scan.dx)
        return lambda: complete_sums(z, scan.dx, weights), lambda slopes: slopes
    c = np.asarray(scan.mask, np.float32)
    return lambda: partial_sums(z, c, scan.dx), partial_slopes


def degrees_apart(scan: Heightfield, normals: np.ndarray, slopes: tuple[np.ndarray, np.ndarray]) -> float:
    """The largest angle between our normals and those of the rival's slopes."""
    q, r = slopes
    theirs = np.stack([-q / SIGMA, -r / SIGMA, np.ones_like(q)], axis=-1)
    theirs /= np.linalg.norm(theirs, axis=-1, keepdims=True)
    return float(np.rad2deg(np.linalg.norm(normals - theirs, axis=-1)[np.asarray(scan.valid)].max()))


def compare_normals(pixel: float, missing: float, repeat: int) -> list[str]:
    """One row: scans a second of ours and theirs, ratios, and how far apart the normals are."""
    scan, cores = simulated(pixel, missing), os.cpu_count() or 1
    seconds, normals = timed(lambda: np.asarray(filtered_normals(scan, SIGMA)), repeat)
    theirs, finish = rival(scan)
    few = max(1, repeat // 3)
    one, moments = timed(theirs, few)
    with ThreadPoolExecutor(cores) as pool:
        many = timed(lambda: list(pool.map(lambda _: theirs(), range(cores))), few)[0] / cores
    return [
        f"{pixel:g}",
        f"{100 * missing:g} %",
        *(f"{1 / t:.1f}" for t in (seconds, one, many)),
        *(f"{t / seconds:.1f}" for t in (one, many)),
        f"{degrees_apart(scan, normals, finish(moments)):.0e}",
    ]


def peak() -> float:
    """The largest memory so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def stream(scan: Heightfield, count: int, marks: dict[int, float]) -> Iterator[Heightfield]:
    """So many different scans, one at a time; the memory is marked after a tenth, and at the end."""
    z, mask = np.asarray(scan.z), np.asarray(scan.valid)
    for k in range(count):
        if k == count // 10:
            marks[k] = peak()
        shift = (7 * k, 13 * k)
        yield Heightfield(np.roll(z, shift, (0, 1)), scan.dx, scan.dy, np.roll(mask, shift, (0, 1)))
    marks[count] = peak()


def time_data_set(name: str, cells: Cells, scan: Heightfield, count: int) -> list[str]:
    """One row: which table, seconds for all scans, and memory."""
    mean_ndf([scan], cells)  # compiles
    marks: dict[int, float] = {}
    begin = time.perf_counter()
    mean_ndf(stream(scan, count, marks), cells)
    seconds = time.perf_counter() - begin
    return [name, f"{seconds:.1f}", f"{marks[count]:.0f}", f"{marks[count] - marks[count // 10]:.0f}"]


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--repeat", type=int, default=30, help="timed calls of ours; scipy runs a third of them"
    )
    parser.add_argument("--scans", type=int, default=400, help="scans of the data set")
    args = parser.parse_args()
    console = Console(width=110)

    normals = Table(
        *("pixel, µm", "missing", "ours, scans/s", "scipy", "scipy, all cores", "ratio", "ratio, all cores"),
        "degrees apart",
        title=f"filtered normals of 640 × 480 heights, {os.cpu_count()} cores",
    )
    for pixel in PIXELS:
        for missing in (0.0, MISSING):
            normals.add_row(*compare_normals(pixel, missing, args.repeat))
    console.print(normals)

    data = Table(
        "", "seconds", "peak, MB", "growth, MB", title=f"{args.scans} scans, {100 * MISSING:g} % missing"
    )
    scan = simulated(PIXELS[0], MISSING)
    for name, cells in (("filtered NDF", filtered_cells), ("facet NDF", facet_cells)):
        data.add_row(*time_data_set(name, cells, scan, args.scans))
    console.print(data)


if __name__ == "__main__":
    main()
