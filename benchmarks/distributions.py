r"""Which distribution of facets fits MERL best? The same procedure for each, as in Bagher et al. 2012, 6.3.

    python benchmarks/distributions.py FOLDER [--recipe slices+linear] [--csv FILE] [MATERIAL ...]

FOLDER holds MERL files (*.binary). Every isotropic distribution is fitted to each material and channel by
`fit_two_slice` and scored over the whole table: normalized L2 error over all angles, log error below 80°;
a material's errors are means over R, G, B. Shown are on how many materials a distribution's error is at
most that of the shifted gamma's, on how many it is the least of all, and the median ratio to the shifted
gamma's. Bagher et al. compare the shifted gamma, Beckmann and Trowbridge–Reitz (their Fig. 11).
"""

import argparse
import csv
import time
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from data_loaders import read_merl
from fitting import RECIPES, fit_two_slice
from jaxbrdf import (
    Beckmann,
    BlinnPhong,
    CookTorrance,
    Exponential,
    MeasuredBRDF,
    ShiftedGamma,
    StudentT,
    TrowbridgeReitz,
    compare,
    tabulate_projected_area,
)

CHUNK = 10  # materials fitted in one call
ANGLES = (np.pi / 2, np.deg2rad(80))
CLASSES = (ShiftedGamma, Beckmann, TrowbridgeReitz, StudentT, Exponential, BlinnPhong)
MEASURES = ("L2", "log")


def score(model: CookTorrance, measured: MeasuredBRDF) -> np.ndarray:
    """Means over channels of the normalized L2 error over all angles and of the log error below 80°, (2,)."""
    model = eqx.tree_at(lambda m: m.ndf, model, tabulate_projected_area(model.ndf))
    errors = compare(model, measured, ANGLES)
    return np.array([np.mean(errors["normalized_l2"][0]), np.mean(errors["log_error"][1])])


def errors_of(files: list[Path], recipe: str) -> tuple[np.ndarray, np.ndarray]:
    """Errors (distributions, materials, 2), and the seconds that the fits of each distribution took."""
    errors = np.zeros((len(CLASSES), len(files), 2))
    seconds = np.zeros(len(CLASSES))
    for start in track(range(0, len(files), CHUNK), description="materials", console=Console(stderr=True)):
        measured = [read_merl(file) for file in files[start : start + CHUNK]]
        for k, ndf in enumerate(CLASSES):
            begin = time.perf_counter()
            result = fit_two_slice(ndf, measured, recipe)
            seconds[k] += time.perf_counter() - begin
            scores = [score(result[i].model, m) for i, m in enumerate(measured)]
            errors[k, start : start + len(measured)] = scores
    return errors, seconds


def print_table(errors: np.ndarray, seconds: np.ndarray) -> None:
    headings = [f"{measure} {what}" for measure in MEASURES for what in ("≤ SGD's", "least", "median ratio")]
    table = Table("distribution", *headings, "fits, s")
    ratio = errors / errors[:1]
    least = np.argmin(errors, axis=0)
    for k, ndf in enumerate(CLASSES):
        cells = [
            cell
            for i in range(len(MEASURES))
            for cell in (
                "" if k == 0 else f"{np.sum(ratio[k, :, i] <= 1)} of {ratio.shape[1]}",
                f"{np.sum(least[:, i] == k)}",
                f"{np.median(ratio[k, :, i]):.3f}",
            )
        ]
        table.add_row(ndf.__name__, *cells, f"{seconds[k]:.1f}")
    Console(width=150).print(table)


def write_csv(path: Path, names: list[str], errors: np.ndarray) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["material", "distribution", "normalized_l2", "log_error_below_80"])
        for ndf, rows in zip(CLASSES, errors, strict=True):
            writer.writerows([name, ndf.__name__, *row] for name, row in zip(names, rows, strict=True))


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder of MERL files")
    parser.add_argument("materials", nargs="*", help="only these")
    parser.add_argument("--recipe", choices=RECIPES, default="slices+linear")
    parser.add_argument("--csv", type=Path, help="write every material's errors here")
    args = parser.parse_args()
    files = sorted(f for f in args.folder.glob("*.binary") if not args.materials or f.stem in args.materials)
    if not files:
        parser.error(f"no MERL files (*.binary) of these names in {args.folder}")
    errors, seconds = errors_of(files, args.recipe)
    print_table(errors, seconds)
    if args.csv:
        write_csv(args.csv, [f.stem for f in files], errors)


if __name__ == "__main__":
    main()
