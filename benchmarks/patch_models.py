r"""Is the ellipsoid a better distribution than Beckmann's? Height maps, whole and in patches.

    python benchmarks/patch_models.py [FILES...] [--csv FILE]

Figure 12 of Dong et al. 2015: the ellipsoid "usually provides a better fit". FILES are measured height maps,
a plane being taken off; simulated ones of 1024 × 1024 points .5 µm apart come first:

    Gaussian     normally distributed heights of a Gaussian correlation: slopes are Gaussian, as Beckmann's
    exponential  the same of an exponential correlation: slopes are Gaussian whatever the correlation is
    pits         −exp(1.2 g) of a Gaussian g: its slopes are Gaussian times the depth, which varies as fast
    grooves      the same of a brushed g
    uneven       g exp(b) with b Gaussian of τ = 60 µm, wider than a patch: rough and smooth places

Normals are the filtered ones with σ = 1 µm or 1.5 pixels. The table of the whole map has 129 × 129 cells,
those of 16 × 16 patches have 65 × 65, both over the window that holds 99 % of the map's normals along each
axis. Of small maps there are fewer patches, 20 σ wide; maps whose normals are all within .01 are left out, as
fits look for no α below .001.

Distributions are fitted to each under L2, of which √(E² / Σ T² dA) is shown, and by likelihood, of which KL
is, in nats a normal. "noise" is the L2 error of the truth if normals were independent; KL has some
too, the same for all models. "A < B" is the share of patches that A fits better than B, and by how much.

Beckmann and GGX have two parameters. The ellipsoid has five: it is a GGX that may also be turned and skewed.
What it gains by that and what by its tail are told apart by two pairs of equally many parameters: GGX against
Beckmann, and the ellipsoid against the turned Beckmann, slopes of any Gaussian. Student's t is isotropic: its
tail is a second parameter, between GGX's and Beckmann's and heavier, but for no brushed surface.
"""

import argparse
import csv
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from rich.console import Console
from rich.table import Table

from data_loaders import read_heightfield
from fitting import fit_ndf_patches
from fitting.outcome import means_nothing
from jaxbrdf import (
    AbstractNDF,
    Beckmann,
    Ellipsoid,
    Heightfield,
    PatchNDFs,
    StudentT,
    TrowbridgeReitz,
    gaussian_surface,
    levelled,
    patch_ndfs,
)
from jaxbrdf.arrays import POSITIVE, Parameter, Range, parameter
from jaxbrdf.directions import Direction
from jaxbrdf.ndf.base import slopes
from jaxbrdf.ndf.tabulated import cell_area
from jaxbrdf.surface.plane_fit import checked_sigma

SHAPE, PIXEL = (1024, 1024), 0.5  # points, µm
SIDE, WIDTH = 16, 20  # the most patches along an axis, and how many σ they have at least
FLAT = 0.01  # an α of less than .001 is none that fits look for
LOSSES = ("l2", "likelihood")
ERRORS = {"l2": "relative L2 error", "likelihood": "KL, nats a normal"}
ROUND, BRUSHED = 4.0, (24.0, 4.0)  # τ, µm


class TurnedBeckmann(AbstractNDF):
    """Gaussian slopes of any mean and covariance: Beckmann's, turned by φ about the normal, then skewed."""

    alpha_x: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-3, 3.0, log=True))
    alpha_y: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-3, 3.0, log=True))
    phi: Parameter = parameter(fitted=Range(-jnp.pi, jnp.pi))
    mean_x: Parameter = parameter(fitted=Range(-1.0, 1.0))
    mean_y: Parameter = parameter(fitted=Range(-1.0, 1.0))

    @property
    def is_isotropic(self) -> bool:
        return False

    @classmethod
    def guesses(
        cls, m: Float[np.ndarray, "K 3"], D: Float[np.ndarray, " K"], weight: Float[np.ndarray, " K"]
    ) -> list[AbstractNDF]:
        """Of the same mean and covariance."""
        held, t = D * weight, m[:, :2] / m[:, 2:]
        mean = held @ t / held.sum()
        squares, axes = np.linalg.eigh(2 * (t - mean).T @ ((t - mean) * held[:, None]) / held.sum())
        alphas, (x, y) = np.sqrt(np.maximum(squares, 1e-6)), axes[:, 0]
        return [cls(*(jnp.asarray(number) for number in (*alphas, np.arctan2(y, x), *mean)))]

    def _density(self, m: Direction) -> Float[Array, "..."]:
        t_x, t_y, above = slopes(m)
        x, y, cos, sin = t_x - self.mean_x, t_y - self.mean_y, jnp.cos(self.phi), jnp.sin(self.phi)
        along, across = (cos * x + sin * y) / self.alpha_x, (cos * y - sin * x) / self.alpha_y
        exponent = 2 * jnp.log1p(t_x**2 + t_y**2) - along**2 - across**2
        return jnp.where(above, jnp.exp(exponent) / (jnp.pi * self.alpha_x * self.alpha_y), 0)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        raise NotImplementedError("fits do not ask for it")

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        raise NotImplementedError("fits do not ask for it")


def model(kind: Callable[..., AbstractNDF], *parameters: float) -> AbstractNDF:
    return kind(*(jnp.asarray(number) for number in parameters))


MODELS = {
    "Beckmann": model(Beckmann, 0.2, 0.2),
    "GGX": model(TrowbridgeReitz, 0.2, 0.2),
    "Student t": model(StudentT, 0.2, 3.0),
    "turned Beckmann": model(TurnedBeckmann, 0.2, 0.2, 0.0, 0.0, 0.0),
    "ellipsoid": model(Ellipsoid, 0.2, 0.2, 0.0, 0.0, 0.0),
}
PAIRS = (("GGX", "Beckmann"), ("ellipsoid", "turned Beckmann"), ("ellipsoid", "Beckmann"))


# Surfaces


def heights(seed: int, correlation: float | tuple[float, float], decay: str = "gaussian") -> np.ndarray:
    """Normally distributed with a standard deviation of 1."""
    return np.asarray(gaussian_surface(jax.random.key(seed), SHAPE, PIXEL, 1.0, correlation, decay).z)


def surfaces(files: Sequence[Path]) -> Iterator[tuple[str, Heightfield]]:
    """By name: the simulated ones, then the measured ones."""
    simulated = {
        "Gaussian, τ 4 µm": 0.4 * heights(0, ROUND),
        "Gaussian, τ 12 µm": 1.2 * heights(1, 12.0),
        "Gaussian, τ 24 × 4 µm": 0.4 * heights(2, BRUSHED),
        "exponential, τ 8 µm": 0.3 * heights(3, 8.0, "exponential"),
        "pits, τ 4 µm": -0.2 * np.exp(1.2 * heights(4, ROUND)),
        "grooves, τ 24 × 4 µm": -0.2 * np.exp(1.2 * heights(5, BRUSHED)),
        "uneven, τ 4 µm": 0.3 * heights(6, ROUND) * np.exp(0.7 * heights(7, 60.0)),
    }
    for name, z in simulated.items():
        yield name, Heightfield(z, PIXEL, PIXEL)
    for file in files:
        yield file.stem.split("_")[0], levelled(read_heightfield(file))


def whole(surface: Heightfield) -> PatchNDFs:
    """The one table of all."""
    return patch_ndfs(surface, surface.size[::-1], cells=129)


def patches(surface: Heightfield) -> PatchNDFs:
    """At most 16 × 16 of them, and none of them less than 20 σ wide."""
    least = WIDTH * checked_sigma(surface, None)
    width, height = (size / np.clip(size // least, 1, SIDE) for size in surface.size[::-1])
    return patch_ndfs(surface, (width, height))


# Fits


Errors = dict[tuple[str, str], np.ndarray]  # by model and loss: of each table


def fitted(tables: PatchNDFs) -> Errors:
    """The errors of each model with each loss, L2 or KL; NaN where there was nothing to fit to."""
    found = {}
    for name, start in MODELS.items():
        for loss in LOSSES:
            result = fit_ndf_patches(start, tables, loss=loss)
            cost = np.where(means_nothing(result.status), np.nan, result.cost)
            found[name, loss] = np.sqrt(cost / 50) if loss == "l2" else cost / 100
    return found


def noise(tables: PatchNDFs) -> float:
    """The median of √(Σ T / (n dA Σ T²)), which independent normals leave of L2."""
    known = np.asarray(tables.counts) > 0
    T, counts = np.asarray(tables.values)[known].reshape(known.sum(), -1), np.asarray(tables.counts)[known]
    area = cell_area(tables.values.shape[-1], tables.tables.extent)
    return float(np.median(np.sqrt(T.sum(1) / (counts * area * np.square(T).sum(1)))))


class Row(NamedTuple):
    """A line of what is printed, as it is kept: `better` is of two models' patches the share that the first
    fits better, and `gain` the median of what the error is less."""

    surface: str
    tables: int
    model: str
    loss: str
    error: float
    rival: str = ""
    better: float = np.nan
    gain: float = np.nan


def rows(surface: str, tables: PatchNDFs) -> Iterator[Row]:
    """Medians over the tables of each model, and pairs of models."""
    errors, count = fitted(tables), len(tables.counts)
    yield Row(surface, count, "noise", "l2", noise(tables))
    for loss in LOSSES:
        for name in MODELS:
            yield Row(surface, count, name, loss, float(np.nanmedian(errors[name, loss])))
        for one, other in PAIRS:
            less = errors[other, loss] - errors[one, loss]
            less = less[np.isfinite(less)]
            error, better = float(np.nanmedian(errors[one, loss])), float(np.mean(less > 0))
            yield Row(surface, count, one, loss, error, other, better, float(np.median(less)))


# What is printed


def table_of(found: Sequence[Row], loss: str, whole_map: bool) -> Table:
    """One line for each surface: the error of each model, and of pairs how often the first is the better."""
    chosen = [row for row in found if row.loss == loss and (row.tables == 1) == whole_map]
    pairs = [] if whole_map else [f"{one} < {other}" for one, other in PAIRS]
    title = f"{ERRORS[loss]}, {'whole maps' if whole_map else 'medians of patches'}"
    models = [*(["noise"] if loss == "l2" else []), *MODELS]
    table = Table("surface", "tables", *models, *pairs, title=title)
    for surface in dict.fromkeys(row.surface for row in chosen):
        own = [row for row in chosen if row.surface == surface]
        errors = [f"{row.error:.3f}" for row in own if not row.rival]
        better = [f"{100 * row.better:.0f} %, {row.gain:+.3f}" for row in own if row.rival and not whole_map]
        table.add_row(surface, str(own[0].tables), *errors, *better)
    return table


def measure(files: Sequence[Path], console: Console) -> Iterator[Row]:
    """Whole maps and their patches; flat ones are left out."""
    for name, surface in surfaces(files):
        tables = whole(surface)
        if min(tables.tables.extent) < FLAT:
            console.print(
                f"{name} is left out: 99 % of its normals are within {max(tables.tables.extent):.1g}"
            )
            continue
        yield from rows(name, tables)
        yield from rows(name, patches(surface))
        jax.clear_caches()  # compiled programs hold memory maps, of which Linux gives a process only so many


def write_csv(path: Path, found: Sequence[Row]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([Row._fields, *found])


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", type=Path, nargs="*", metavar="FILES", help="measured height maps")
    parser.add_argument("--csv", type=Path, help="write all numbers here")
    args = parser.parse_args()
    console = Console(width=150)
    if not args.files:
        console.print("no measured height maps are given: simulated ones only")
    found = list(measure(args.files, console))
    for whole_map in (True, False):
        for loss in LOSSES:
            console.print(table_of(found, loss, whole_map))
    if args.csv:
        write_csv(args.csv, found)


if __name__ == "__main__":
    main()
