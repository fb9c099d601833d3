r"""Which models can describe measured materials, and how well? All models against MERL and others.

    python benchmarks/merl_models.py FILES... [--csv FILE] [--plot FILE]

FILES are measured BRDFs in any format. Each model is fitted under L2, under the log error, and by the picture
of a lit sphere, which chooses among four losses ('image'); the recipes of the shifted gamma reflectance (sgd)
have a loss of their own. Beside them stand the parameters that the literature published for MERL's materials,
scored in the same way. Errors are means over the channels, over directions below 80°; ΔE is the mean CIE Lab
difference of a lit sphere. Every row is kept in the CSV file as it comes: run again, the script goes on.
"""

import argparse
import csv
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import track
from rich.table import Table

from data_loaders import published, read_brdf, to_rgb
from data_loaders.published_models import PUBLISHED
from fitting import catalogue, fit_losses
from fitting.catalogue import IMAGE_LOSSES, General
from jaxbrdf import AbstractBRDF, Comparison, FitResult, FitStatus, MeasuredBRDF, as_table
from jaxbrdf.preview import Appearance

CHUNK = 10  # materials fitted in one call
ERRORS = ("normalized_l2", "log_error", "cube_root_error", "lab")
COLUMNS = ("material", "model", "loss", *ERRORS, "seconds", "status")
Row = dict[str, str]


class Truth(NamedTuple):
    """A material, and what models are held against."""

    name: str
    comparison: Comparison
    appearance: Appearance

    def score(self, model: AbstractBRDF) -> dict[str, str]:
        """Errors as they stand in the CSV file; means over channels."""
        quick = model.tabulated()
        errors = {name: float(np.mean(values)) for name, values in self.comparison.errors(quick).items()}
        errors["lab"] = float(self.appearance.difference(quick))
        return {name: f"{error:.6g}" for name, error in errors.items()}


def status(codes: np.ndarray) -> str:
    """The worst status of a material's channels."""
    return FitStatus(int(np.max(codes))).name.lower()


def fitted(name: str, measured: Sequence[MeasuredBRDF]) -> dict[str, list[FitResult]]:
    """The fits of one model by loss, a result for each material."""
    entry = catalogue()[name]
    if isinstance(entry, General):
        results = fit_losses(entry.model, measured, IMAGE_LOSSES)
        several = dict(zip(IMAGE_LOSSES, results, strict=True))
        return {loss: [result[i] for i in range(len(measured))] for loss, result in several.items()}
    losses = {"free-form": ("l2", "log"), "sgd+lobe": ("l2",)}.get(name, ("own",))
    return {loss: entry.fit(measured, "l2" if loss == "own" else loss) for loss in losses}


def rows_of_models(name: str, measured: Sequence[MeasuredBRDF], truths: Sequence[Truth]) -> Iterator[Row]:
    """The rows of one model: under each loss that is shown, and of the fit that looks best."""
    begin = time.perf_counter()
    fits = fitted(name, measured)
    seconds = f"{(time.perf_counter() - begin) / len(measured) / len(fits):.3g}"
    for i, truth in enumerate(truths):
        shown = {loss: results[i] for loss, results in fits.items() if loss in ("l2", "log", "own")}
        if len(fits) == len(IMAGE_LOSSES):
            models = [fits[loss][i].model.tabulated() for loss in IMAGE_LOSSES]
            looks = [float(truth.appearance.difference(model)) for model in models]
            best = IMAGE_LOSSES[int(np.argmin(np.nan_to_num(looks, nan=np.inf)))]
            shown["image"] = fits[best][i]
        for loss, result in shown.items():
            row = {"material": truth.name, "model": name, "loss": loss, "seconds": seconds}
            yield {**row, **truth.score(result.model), "status": status(result.status)}


def rows_of_published(truth: Truth) -> Iterator[Row]:
    """The published parameters of a material, from whoever has some."""
    for name in PUBLISHED:
        try:
            model = published(name, truth.name)
        except ValueError:
            continue
        row = {"material": truth.name, "model": name, "loss": "published", "seconds": "", "status": ""}
        yield {**row, **truth.score(model)}


def read(path: Path) -> MeasuredBRDF:
    """A table of R, G and B; of three wavelengths the longest stands for R."""
    measured = read_brdf(path)
    if measured.wavelengths is not None and len(measured.wavelengths) > 3:
        measured = to_rgb(measured)
    table = as_table(measured)
    order = slice(None) if table.wavelengths is None else np.argsort(-table.wavelengths)
    return MeasuredBRDF(table.raw[..., order], table.scale[order], table.grid, name=path.stem)


def compute(files: Sequence[Path], target: Path, done: list[Row]) -> list[Row]:
    """The rows of all files; those that are not in the CSV file yet are appended to it."""
    ready = {row["material"] for row in done}
    if not target.exists():
        write(target, [])
    todo = [file for file in files if file.stem not in ready]
    for start in track(range(0, len(todo), CHUNK), description="materials", console=Console(stderr=True)):
        measured = [read(file) for file in todo[start : start + CHUNK]]
        truths = [Truth(m.name, Comparison.of(m), Appearance.of(m)) for m in measured]
        rows = [row for truth in truths for row in rows_of_published(truth)]
        for name in catalogue():
            rows += rows_of_models(name, measured, truths)
        with target.open("a", newline="") as file:
            csv.DictWriter(file, COLUMNS).writerows(rows)
        done += rows
    return done


def write(target: Path, rows: Sequence[Row]) -> None:
    with target.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)


class Errors:
    """The errors of all rows by (model, loss), each (materials,): NaN where a material has no such row."""

    def __init__(self, rows: Sequence[Row], materials: Sequence[str]):
        self.materials = list(materials)
        self.kinds = list(dict.fromkeys((row["model"], row["loss"]) for row in rows))
        self._rows = {(row["model"], row["loss"], row["material"]): row for row in rows}

    def __call__(self, model: str, loss: str, error: str) -> np.ndarray:
        found = [self._rows.get((model, loss, material)) for material in self.materials]
        return np.array([float(row[error]) if row and row[error] else np.nan for row in found])

    def count(self, model: str, loss: str) -> int:
        return sum((model, loss, material) in self._rows for material in self.materials)


def print_models(errors: Errors) -> None:
    """Medians over the materials."""
    table = Table("model", "loss", "materials", "L2", "log", "∛", "ΔE", "s", title="medians")
    for model, loss in errors.kinds:
        medians = [np.nanmedian(errors(model, loss, name)) for name in ERRORS]
        seconds = errors(model, loss, "seconds")
        words = "" if np.isnan(seconds).all() else f"{np.nanmedian(seconds):.2g}"
        table.add_row(model, loss, str(errors.count(model, loss)), *(f"{m:.3g}" for m in medians), words)
    Console(width=120).print(table)


def print_materials(errors: Errors, models: Sequence[tuple[str, str]]) -> None:
    """Normalized L2 of some models, one row for each material."""
    table = Table("normalized L2", *(f"{model} ({loss})" for model, loss in models))
    columns = [errors(model, loss, "normalized_l2") for model, loss in models]
    for i, name in enumerate(errors.materials):
        table.add_row(name, *(f"{column[i]:.3g}" for column in columns))
    Console(width=150).print(table)


# A claim: its words, the error, who is to be below, and whom.
Kind = tuple[str, str]
CLAIMS: list[tuple[str, str, Kind, list[Kind]]] = [
    ("our sgd below our Beckmann", "normalized_l2", ("sgd", "own"), [("beckmann", "l2")]),
    ("our GGX below our Beckmann", "normalized_l2", ("ggx", "l2"), [("beckmann", "l2")]),
    ("our sgd below our GGX", "normalized_l2", ("sgd", "own"), [("ggx", "l2")]),
    (
        "our sgd below Ngan's Cook–Torrance",
        "normalized_l2",
        ("sgd", "own"),
        [("ngan-cook-torrance", "published")],
    ),
    ("our sgd below the published", "normalized_l2", ("sgd", "own"), [("sgd", "published")]),
    ("our sgd below the published", "log_error", ("sgd", "own"), [("sgd", "published")]),
]
for _error, _loss in (("normalized_l2", "l2"), ("log_error", "log")):
    _cook_torrance = [(f"{who}", "published") for who in PUBLISHED if "cook-torrance" in who]
    CLAIMS += [
        ("our ABC below the published", _error, ("abc", _loss), [("abc", "published")]),
        ("our GGX below the published ABC", _error, ("ggx", _loss), [("abc", "published")]),
        ("our GGX below all published Cook–Torrance", _error, ("ggx", _loss), _cook_torrance),
        ("our ABC below all published Cook–Torrance", _error, ("abc", _loss), _cook_torrance),
        ("second lobe below sgd", _error, ("sgd+lobe", "l2"), [("sgd", "own")]),
        ("free form below sgd + lobe", _error, ("free-form", _loss), [("sgd+lobe", "l2")]),
    ]
CLAIMS += [
    (f"{model}: image below plain L2", "lab", (model, "image"), [(model, "l2")])
    for model in ("ward", "beckmann", "ggx", "student-t", "abc")
]


def print_claims(errors: Errors) -> None:
    """On how many materials one error is below another, and by what factor in the median."""
    table = Table("claim", "error", "materials", "median ratio", "ten times below")
    for words, name, ours, theirs in CLAIMS:
        mine = errors(*ours, name)
        rivals = np.array([errors(*kind, name) for kind in theirs])
        known = np.isfinite(mine) & np.isfinite(rivals).any(axis=0)
        if not known.any():
            continue
        ratio = mine[known] / np.nanmin(rivals[:, known], axis=0)
        held = f"{np.sum(ratio < 1 - 1e-6)} of {known.sum()}"
        table.add_row(words, name, held, f"{np.median(ratio):.3g}", str(np.sum(ratio <= 0.1)))
    Console(width=120).print(table)


def plot(errors: Errors, path: Path) -> None:
    """Normalized L2 against materials, from smooth to rough as the error of Beckmann has it."""
    shown = [
        ("ngan-cook-torrance", "published"),
        ("sgd", "published"),
        ("beckmann", "l2"),
        ("ggx", "l2"),
        ("abc", "l2"),
    ]
    shown += [("sgd", "own"), ("sgd+lobe", "l2"), ("free-form", "l2")]
    figure = Figure(figsize=(max(6, 0.14 * len(errors.materials) + 2.5), 5.5), dpi=110, layout="constrained")
    ax = figure.subplots()
    order = np.argsort(-errors("beckmann", "l2", "normalized_l2"), kind="stable")
    for model, loss in (kind for kind in shown if kind in errors.kinds):
        ax.plot(
            errors(model, loss, "normalized_l2")[order],
            ".-",
            linewidth=0.8,
            markersize=4,
            label=f"{model} ({loss})",
        )
    ax.set(yscale="log", ylabel="normalized L2 below 80°, mean over channels", xlim=(-0.7, len(order) - 0.3))
    ax.set_xticks(range(len(order)), [errors.materials[i] for i in order], rotation=90, fontsize=6)
    ax.grid(axis="y", color="0.92")
    figure.legend(loc="outside right upper", frameon=False)
    figure.savefig(path)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="+", type=Path, help="measured BRDFs")
    parser.add_argument("--csv", type=Path, default=Path("merl_models.csv"), help="where rows are kept")
    parser.add_argument("--plot", type=Path, help="draw errors against materials here")
    args = parser.parse_args()
    done = []
    if args.csv.exists():
        with args.csv.open(newline="") as file:
            done = list(csv.DictReader(file))
    rows = compute(args.files, args.csv, done)
    errors = Errors(rows, [file.stem for file in args.files])
    print_models(errors)
    print_claims(errors)
    if len(args.files) <= 20:
        print_materials(
            errors,
            [
                ("beckmann", "l2"),
                ("ggx", "l2"),
                ("abc", "l2"),
                ("sgd", "own"),
                ("sgd+lobe", "l2"),
                ("free-form", "l2"),
            ],
        )
    if args.plot:
        plot(errors, args.plot)


if __name__ == "__main__":
    main()
