r"""How fast is the Kirchhoff distribution of a height map? All directions at once, against the plain sum.

    python benchmarks/kirchhoff_speed.py

A random rough patch of 640 × 480 heights, 70 × 53 µm as in Dong et al. 2015, at λ_q = 0.555 µm. The rival is
the direct sum of their eq. 6 in numpy, one direction after another, with everything that does not depend on
the direction made before; it is timed on some directions, which say how far apart the two are as well. The
gradient is that of a weighted sum of the table by all heights. Compilation is apart.
"""

import argparse
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from jaxbrdf import Heightfield, gaussian_surface, kirchhoff_ndf
from jaxbrdf.ndf.tabulated import disk_cells

WAVELENGTH, SIZE, SHAPE, PIXEL = 0.555, 1025, (480, 640), 70 / 640
DIRECTIONS = 40


def seconds(work: Callable) -> float:
    begin = time.perf_counter()
    jax.block_until_ready(work())
    return time.perf_counter() - begin


def plain_sum(heightfield: Heightfield) -> Callable[[np.ndarray], float]:
    """D_K at one direction m, as a function of it."""
    z, d = np.asarray(heightfield.z, float), heightfield.dx
    a, b, c, e = z[:-1, :-1], z[:-1, 1:], z[1:, :-1], z[1:, 1:]
    mean, slope_x, slope_y = (a + b + c + e) / 4, (b + e - a - c) / (2 * d), (c + e - a - b) / (2 * d)
    x, y = d * np.arange(mean.shape[1])[None, :], d * np.arange(mean.shape[0])[:, None]
    scale = d**2 / (4 * np.pi**2 * mean.size)

    def at(m: np.ndarray) -> float:
        q_x, q_y, q_z = 4 * np.pi / WAVELENGTH * m
        wave = np.exp(-1j * (q_z * mean)) * np.exp(-1j * (q_x * x)) * np.exp(-1j * (q_y * y))
        return scale * abs(np.sum((q_z - q_x * slope_x - q_y * slope_y) * wave)) ** 2

    return at


def some_directions(max_angle: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Rows and columns of some cells within an angle, and how many there are."""
    m_z = disk_cells(SIZE)[2]
    cells = np.argwhere(m_z >= max(np.cos(max_angle), 1e-9))
    chosen = cells[np.random.default_rng(0).choice(len(cells), DIRECTIONS, replace=False)]
    return chosen[:, 0], chosen[:, 1], len(cells)


def row(table: Table, heightfield: Heightfield, degrees: float) -> None:
    """Times of ours and of the plain sum, their ratio a direction, and the largest relative difference."""
    angle = float(np.deg2rad(degrees))
    relief = float(np.ptp(heightfield.z))
    options = {"patch": np.inf, "max_angle": angle, "relief": relief}

    def whole(z):
        return kirchhoff_ndf(Heightfield(z, PIXEL, PIXEL), WAVELENGTH, **options).values

    weight = jax.random.normal(jax.random.key(1), (SIZE, SIZE), heightfield.z.dtype)
    forward, gradient = jax.jit(whole), jax.jit(jax.grad(lambda z: jnp.sum(weight * whole(z))))
    first, ours = seconds(lambda: forward(heightfield.z)), seconds(lambda: forward(heightfield.z))
    gradient(heightfield.z)
    backward = seconds(lambda: gradient(heightfield.z))
    rows, columns, count = some_directions(angle)
    at = plain_sum(heightfield)
    m = disk_cells(SIZE)[:, rows, columns].T
    begin = time.perf_counter()
    direct = np.array([at(direction) for direction in m])
    each = (time.perf_counter() - begin) / DIRECTIONS
    apart = np.max(np.abs(np.asarray(forward(heightfield.z))[rows, columns] / direct - 1))
    table.add_row(
        f"{degrees:.0f}°",
        str(heightfield.z.dtype),
        f"{count:,}",
        f"{first:.2f}",
        f"{ours:.2f}",
        f"{1000 * each:.1f}",
        f"{each * count / ours:,.0f}",
        f"{apart:.0e}",
        f"{backward / ours:.1f}",
    )


def main() -> None:
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    jax.config.update("jax_enable_x64", True)
    surface = gaussian_surface(jax.random.key(0), SHAPE, PIXEL, 0.5, 5.0)
    table = Table(
        "within",
        "precision",
        "directions",
        "first call, s",
        "warm, s",
        "plain sum, ms a direction",
        "times faster",
        "apart",
        "gradient / forward",
    )
    for degrees in (30.0, 90.0):
        for dtype in (np.float64, np.float32):
            row(table, Heightfield(np.asarray(surface.z, dtype), PIXEL, PIXEL), degrees)
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
