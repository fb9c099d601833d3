"""How fast is the Kirchhoff distribution of a height map? Against the plain sum, and non-uniform FFTs.

    python benchmarks/kirchhoff_speed.py [--repeat N] [--csv FILE]

A Gaussian surface of 640 × 480 points over 70 × 52.5 µm, rms height 0.3 and correlation length 3 µm, at
λ_q = 0.555 µm: every cell of a 1025 × 1025 table within 30° of the normal, and over the whole disk. Rivals
are numpy's sum over the squares, timed on a few directions, and finufft (`pip install finufft`; left out
where it is missing) at 1e-9: its transform to any frequencies in space (type 3), and planar transforms
(type 1) at our Chebyshev nodes. Shown is the fastest of `--repeat` runs, compiled, and the largest relative
error of D among 20 random directions against the plain sum, dark ones between the speckles included.
"""

import argparse
import csv
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from evaluate import best_of
from rich.console import Console
from rich.table import Table

from jaxbrdf import Heightfield, kirchhoff_ndf

SIZE, WAVELENGTH, STEP = 1025, 0.555, 70 / 640
Q = 4 * np.pi / WAVELENGTH
ANGLES = {"within 30°": np.pi / 6, "the whole disk": np.pi / 2}


class Row(NamedTuple):
    """One way to compute D in all directions, in seconds; the plain sum has no error."""

    what: str
    directions: int
    seconds: float
    error: float | None


class Squares(NamedTuple):
    """Midpoints and slopes, flat."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    z_x: np.ndarray
    z_y: np.ndarray


def surface() -> np.ndarray:
    f_y, f_x = (np.fft.fftfreq(n, STEP) for n in (480, 640))
    noise = np.fft.fft2(np.random.default_rng(0).normal(size=(480, 640)))
    z = np.fft.ifft2(noise * np.exp(-((3 * np.pi) ** 2) * (f_y[:, None] ** 2 + f_x**2) / 2)).real
    return 0.3 * z / z.std()


def squares(z: np.ndarray) -> Squares:
    a, b, c, d = z[:-1, :-1], z[:-1, 1:], z[1:, :-1], z[1:, 1:]
    y, x = np.meshgrid(*(STEP * (np.arange(n) - (n - 1) / 2) for n in a.shape), indexing="ij")
    fields = x, y, (a + b + c + d) / 4, (b + d - a - c) / (2 * STEP), (c + d - a - b) / (2 * STEP)
    return Squares(*(np.ascontiguousarray(f.ravel()) for f in fields))


def cells(angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Row and column in the table of the directions within an angle, and q of each, (3, directions)."""
    centre = (2 * np.arange(SIZE) + 1) / SIZE - 1
    sin2 = centre[:, None] ** 2 + centre**2
    index = np.argwhere(sin2 <= np.sin(angle) ** 2)
    m_y, m_x = centre[index].T
    return index, Q * np.stack([m_x, m_y, np.sqrt(1 - m_x**2 - m_y**2)])


def distribution(F: np.ndarray, s: Squares) -> np.ndarray:
    return np.abs(F) ** 2 * STEP**2 / (4 * np.pi**2 * len(s.z))


def plain_sum(s: Squares, q: np.ndarray) -> float:
    flux = q[2] - q[0] * s.z_x - q[1] * s.z_y
    return distribution(np.sum(flux * np.exp(-1j * (q[0] * s.x + q[1] * s.y + q[2] * s.z))), s)


def strengths(s: Squares) -> np.ndarray:
    return np.stack([np.ones_like(s.z), s.z_x, s.z_y]).astype(complex)


def in_space(s: Squares, q: np.ndarray) -> np.ndarray:
    """D by three transforms of type 3."""
    import finufft

    flat, along_x, along_y = finufft.nufft3d3(s.x, s.y, s.z, strengths(s), *q, isign=-1, eps=1e-9)
    return distribution(q[2] * flat - q[0] * along_x - q[1] * along_y, s)


def planar(s: Squares, q: np.ndarray) -> np.ndarray:
    """D by three transforms of type 1 at each Chebyshev node of q_z."""
    import finufft

    reach = round(np.max(q[0]) * SIZE / (2 * Q))
    middle, half = (q[2].max() + q[2].min()) / 2, (q[2].max() - q[2].min()) / 2
    turn = np.pi * (np.arange(round(half * np.abs(s.z).max()) + 16) + 0.5)
    turn = turn / len(turn)
    plan = finufft.Plan(1, (2 * reach + 1, 2 * reach + 1), n_trans=3, eps=1e-9, isign=-1)
    plan.setpts(2 * Q / SIZE * s.x, 2 * Q / SIZE * s.y)
    column, row = (np.round(q[k] * SIZE / (2 * Q)).astype(int) + reach for k in (0, 1))
    total, weights = np.zeros(q.shape[1], complex), np.zeros(q.shape[1])
    for k, node in enumerate(middle + half * np.cos(turn)):
        flat, along_x, along_y = plan.execute(strengths(s) * np.exp(-1j * node * s.z))[:, column, row]
        weight = (-1) ** k * np.sin(turn[k]) / (q[2] - node)
        total += weight * (node * flat - q[0] * along_x - q[1] * along_y)
        weights += weight
    return distribution(total / weights, s)


def timed(what: str, run: Callable[[], np.ndarray], truth: dict[int, float], repeat: int) -> Row:
    values = run()
    error = max(abs(values[k] - D) / D for k, D in truth.items())
    return Row(what, len(values), best_of(repeat, run), error)


def rows(z: np.ndarray, name: str, angle: float, repeat: int) -> Iterator[Row]:
    s, (index, q) = squares(z), cells(angle)
    some = np.random.default_rng(1).choice(len(index), 20, replace=False)
    truth = {int(k): plain_sum(s, q[:, k]) for k in some}
    one = best_of(repeat, lambda: [plain_sum(s, q[:, k]) for k in some]) / len(some)
    yield Row(f"plain sum, {name}", len(index), one * len(index), None)
    for dtype in (jnp.float64, jnp.float32):
        h = Heightfield(jnp.asarray(z, dtype), STEP, STEP)

        def ours(h=h):
            return np.asarray(kirchhoff_ndf(h, WAVELENGTH, max_angle=angle).values)[tuple(index.T)]

        yield timed(f"ours, {h.z.dtype}", ours, truth, repeat)
    yield Row("ours, float64, with the gradient", len(index), gradient_seconds(z, angle, repeat), None)
    try:
        yield timed("finufft, type 1 at our nodes", lambda: planar(s, q), truth, repeat)
        yield timed("finufft, type 3", lambda: in_space(s, q), truth, repeat)
    except ImportError:
        return


def gradient_seconds(z: np.ndarray, angle: float, repeat: int) -> float:
    """Of Σ w D by all heights, and of its value."""
    weight = jnp.asarray(np.random.default_rng(2).random((SIZE, SIZE)))

    def total(z):
        return jnp.sum(weight * kirchhoff_ndf(Heightfield(z, STEP, STEP), WAVELENGTH, max_angle=angle).values)

    run = jax.value_and_grad(total)
    place = jnp.asarray(z)
    jax.block_until_ready(run(place))
    return best_of(repeat, lambda: jax.block_until_ready(run(place)))


def print_table(found: list[Row]) -> None:
    table = Table("", "directions", "s", "µs a direction", "plain sum / this", "largest error")
    plain = 0.0
    for row in found:
        each = 1e6 * row.seconds / row.directions
        plain = each if row.what.startswith("plain sum") else plain
        error = "" if row.error is None else f"{row.error:.0e}"
        table.add_row(
            row.what,
            f"{row.directions:,}",
            f"{row.seconds:.2f}",
            f"{each:.2f}",
            f"{plain / each:,.0f}",
            error,
        )
    Console().print(table)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--csv", type=Path, help="write the numbers here")
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    found = [row for name, angle in ANGLES.items() for row in rows(surface(), name, angle, args.repeat)]
    print_table(found)
    if args.csv:
        with args.csv.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([Row._fields, *found])


if __name__ == "__main__":
    main()
