r"""How much of a measured surface does a direction see? Traced rays against Smith's masking.

    python benchmarks/visibility.py FILES... [--csv FILE] [--figure FILE]

For height maps, a quadratic being taken off, and directions along ±x and ±y (the mean of both), θ = 5° … 85°:

    points     the share of the map's points that is seen, as in Fig. 6 (left) of Dong et al. 2015
    facing     the same among those that face the direction: G1 if masking did not depend on the normal
    traced     the share of the area facing the direction, as it projects: `visibility`, the traced G1
    Smith      cos θ / σ of the map's facets, `facet_ndf`
    filtered   cos θ / σ of the planes around its points, `filtered_ndf`
    ellipsoid  cos θ / σ of the `Ellipsoid` that fits the table of facets best

For facets with half the map ahead of them, but "traced", which leaves out what `visibility` does. That traced
and Smith agree is no discovery: what is seen projects to cos θ, on an endless map. What facing differs from
traced by is how masking depends on the normal, which Smith's product G1(wi) D(h) leaves out.
"""

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from data_loaders import read_heightfield
from fitting import fit_ndf
from jaxbrdf import (
    AbstractNDF,
    Ellipsoid,
    Heightfield,
    facet_ndf,
    filtered_ndf,
    levelled,
    smith_G1,
    spherical,
    visibility,
    visible_facets,
)
from jaxbrdf.surface.facets import facets

THETA = np.arange(5, 90, 5)
SHOWN = (60, 75, 85)
COLUMNS = ("points", "facing", "traced", "Smith", "filtered", "ellipsoid")
Curves = dict[str, np.ndarray]


def directions(turns: tuple[int, int]) -> jax.Array:
    """(angles, 2, 3): at these quarter turns from x."""
    return spherical(np.radians(THETA)[:, None], np.array(turns)[None, :] * (np.pi / 2))


def counted(heightfield: Heightfield, w: jax.Array, turn: int) -> tuple[float, float]:
    """Shares of all facets, and of those that face w, that it sees; of those with half the map ahead."""
    of = facets(heightfield)
    rows, columns = (slice(n // 2) if turn < 2 else slice(n // 2, None) for n in of.known.shape)
    half = (slice(None), columns) if turn % 2 == 0 else (rows, slice(None))
    seen = np.asarray(visible_facets(heightfield, w))[half]
    known, facing = np.asarray(of.known)[half], np.asarray(of.towards(w) > 0)[half]
    return seen.sum() / known.sum(), seen.sum() / (known & facing).sum()


def curves(heightfield: Heightfield, ndfs: dict[str, AbstractNDF], turns: tuple[int, int]) -> Curves:
    w = directions(turns)
    shares = [[counted(heightfield, each[k], turn) for k, turn in enumerate(turns)] for each in w]
    points, facing = np.mean(shares, axis=1).T
    found = {"points": points, "facing": facing, "traced": np.mean(visibility(heightfield, w), axis=1)}
    return found | {name: np.mean(smith_G1(ndf, w), axis=1) for name, ndf in ndfs.items()}


def distributions(heightfield: Heightfield) -> dict[str, AbstractNDF]:
    table = facet_ndf(heightfield)
    start = Ellipsoid(*(np.array(v) for v in (0.2, 0.2, 0.0, 0.0, 0.0)))
    return {"Smith": table, "filtered": filtered_ndf(heightfield), "ellipsoid": fit_ndf(start, table).model}


def measure(paths: list[Path]) -> Iterator[tuple[str, Curves]]:
    for path in paths:
        heightfield = levelled(read_heightfield(path), degree=2)
        ndfs = distributions(heightfield)
        for axis, turns in (("x", (0, 2)), ("y", (1, 3))):
            yield f"{path.stem.split('_')[0]}, {axis}", curves(heightfield, ndfs, turns)


def print_table(results: dict[str, Curves]) -> None:
    table = Table("map, along", "θ", *COLUMNS)
    for name, found in results.items():
        for theta in SHOWN:
            (k,) = np.flatnonzero(theta == THETA)
            table.add_row(name, f"{theta}°", *(f"{found[column][k]:.3f}" for column in COLUMNS))
    Console(width=120).print(table)


def write_csv(path: Path, results: dict[str, Curves]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["map", "theta_degrees", *COLUMNS])
        for name, found in results.items():
            for k, theta in enumerate(THETA):
                writer.writerow([name, theta, *(found[column][k] for column in COLUMNS)])


def draw(path: Path, results: dict[str, Curves]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    columns = (len(results) + 1) // 2
    size = (2.8 * columns, 4.5)
    figure, axes = plt.subplots(2, columns, figsize=size, layout="constrained", squeeze=False)
    styles = {"points": ":", "facing": "--", "traced": "-", "Smith": ".", "ellipsoid": "-."}
    for axis, (name, found) in zip(axes.T.ravel(), results.items(), strict=False):
        for column, style in styles.items():
            axis.plot(THETA, found[column], style, label=column, linewidth=1, markersize=4)
        axis.set(title=name, xlim=(40, 90), ylim=(0.5, 1.02))
        axis.title.set_fontsize(8)
    axes[0, 0].legend(fontsize=7)
    figure.supxlabel("θ / degree", fontsize=9)
    figure.savefig(path, dpi=80, pil_kwargs={"optimize": True})


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", type=Path, nargs="+", metavar="FILES", help="height maps")
    parser.add_argument("--csv", type=Path, help="write all curves here")
    parser.add_argument("--figure", type=Path, help="write the picture here")
    args = parser.parse_args()
    results = dict(measure(args.files))
    print_table(results)
    if args.csv:
        write_csv(args.csv, results)
    if args.figure:
        draw(args.figure, results)


if __name__ == "__main__":
    main()
