r"""How near do our fits come to MERL? The three recipes against the parameters that the paper published.

    python benchmarks/merl_error.py [FOLDER] [--csv FILE] [MATERIAL ...]

FOLDER holds MERL files (*.binary). Shown are, per material, the mean over R, G, B of the normalized L2
error over all angles and of the log error below 80°, and below the table on how many materials each
recipe is at most the published error. The published parameters (Bagher et al. 2012, supplement) are
scored with their own masking (eq. 9); with exact masking they come out the same to three digits.
"""

import argparse
import csv
import time
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from data_loaders import published, read_merl
from fitting import RECIPES, fit_shifted_gamma
from jaxbrdf import MeasuredBRDF, ShiftedGammaBRDF, compare

CHUNK = 10  # materials fitted in one call
ANGLES = (np.pi / 2, np.deg2rad(80))


def score(model: ShiftedGammaBRDF, measured: MeasuredBRDF) -> np.ndarray:
    """(2, C): normalized L2 over all angles, log error below 80°."""
    errors = compare(model.tabulated(), measured, ANGLES)
    return np.stack([errors["normalized_l2"][0], errors["log_error"][1]])


def errors_of(files: list[Path]) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Errors by recipe, (materials, 2, C), and the seconds that each recipe's fits took."""
    errors: dict[str, list] = {name: [] for name in ("published", *RECIPES)}
    seconds = dict.fromkeys(RECIPES, 0.0)
    for start in track(range(0, len(files), CHUNK), description="materials", console=Console(stderr=True)):
        measured = [read_merl(file) for file in files[start : start + CHUNK]]
        errors["published"] += [score(published("sgd", m.name), m) for m in measured]
        for recipe in RECIPES:
            begin = time.perf_counter()
            result = fit_shifted_gamma(measured, recipe)
            seconds[recipe] += time.perf_counter() - begin
            errors[recipe] += [score(result[i].model, m) for i, m in enumerate(measured)]
    return {name: np.stack(rows) for name, rows in errors.items()}, seconds


def per_material(errors: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The mean over channels, (materials, 2)."""
    return {name: rows.mean(axis=2) for name, rows in errors.items()}


def print_table(names: list[str], means: dict[str, np.ndarray]) -> None:
    table = Table("material", *(f"L2 {name}" for name in means), *(f"log {name}" for name in means))
    for i, name in enumerate(names):
        numbers = [f"{means[recipe][i, k]:.4g}" for k in (0, 1) for recipe in means]
        table.add_row(name, *numbers)
    Console(width=150).print(table)


def print_summary(errors: dict[str, np.ndarray], seconds: dict[str, float]) -> None:
    means = per_material(errors)
    counts, ratios = ("L2 ≤ published", "log ≤ published"), ("median L2 ratio", "median log ratio")
    table = Table("recipe", *counts, *ratios, "channels whose L2 grew", "s")
    for before, recipe in zip((None, *RECIPES), RECIPES, strict=False):
        ratio = means[recipe] / means["published"]
        grew = errors[recipe][:, 0] > errors[before or recipe][:, 0] * (1 + 1e-6)
        table.add_row(
            recipe,
            *(f"{(ratio[:, k] <= 1).sum()} of {len(ratio)}" for k in (0, 1)),
            *(f"{np.median(ratio[:, k]):.3f}" for k in (0, 1)),
            f"{grew.sum()} of {grew.size}" if before else "",
            f"{seconds[recipe]:.1f}",
        )
    Console(width=150).print(table)


def write_csv(path: Path, names: list[str], errors: dict[str, np.ndarray]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["material", "channel", "recipe", "normalized_l2", "log_error_below_80"])
        for recipe, rows in errors.items():
            for name, row in zip(names, rows, strict=True):
                writer.writerows([name, "RGB"[c], recipe, *row[:, c]] for c in range(row.shape[1]))


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder of MERL files")
    parser.add_argument("materials", nargs="*", help="only these")
    parser.add_argument("--csv", type=Path, help="write every channel's errors here")
    args = parser.parse_args()
    files = sorted(f for f in args.folder.glob("*.binary") if not args.materials or f.stem in args.materials)
    if not files:
        parser.error(f"no MERL files (*.binary) of these names in {args.folder}")
    errors, seconds = errors_of(files)
    names = [f.stem for f in files]
    print_table(names, per_material(errors))
    print_summary(errors, seconds)
    if args.csv:
        write_csv(args.csv, names, errors)


if __name__ == "__main__":
    main()
