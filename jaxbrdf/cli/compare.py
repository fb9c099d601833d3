"""`jaxbrdf compare`: many models against each measurement, in one table and in pictures."""

import csv
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from data_loaders.files import replacing
from fitting import LOSSES, catalogue
from jaxbrdf import AbstractBRDF, Comparison, FitResult, FitStatus, MeasuredBRDF
from jaxbrdf.cli import batch, comparison_pictures, numerics, report, sources
from jaxbrdf.cli.fit import table_to_fit
from jaxbrdf.preview import Appearance

_ERRORS = ("normalized_l2", "log_error", "cube_root_error")


@dataclass(frozen=True)
class Contender:
    """One model fitted to one material, or why it could not be: the result, and the seconds it took."""

    model: str
    result: FitResult | None
    seconds: float
    error: str = ""


@dataclass(frozen=True)
class CompareTask(batch.Task[MeasuredBRDF, list[Contender], dict[str, Any]]):
    """Fit every model to each file; with a folder `out`, write NAME.json and NAME.png there."""

    models: tuple[str, ...]
    loss: str
    out: Path | None = None
    force: bool = False
    verb = "comparing"

    def finished(self, path: Path) -> dict[str, Any] | None:
        file = self._files(path).get("json")
        if file is None or self.force or not (file.exists() and path.exists()):
            return None
        if file.stat().st_mtime_ns <= path.stat().st_mtime_ns:
            return None
        try:
            document = json.loads(file.read_text(encoding="utf-8"))
        except (ValueError, OSError):
            return None
        same = isinstance(document, dict) and self._identity(path).items() <= document.items()
        return document if same else None

    def read(self, path: Path) -> MeasuredBRDF:
        return table_to_fit(path, sources.load(path))

    def process(self, inputs: Sequence[MeasuredBRDF]) -> Sequence[list[Contender]]:
        by_model = [_fitted(model, inputs, self.loss) for model in self.models]
        return [list(contenders) for contenders in zip(*by_model, strict=True)]

    def save(self, path: Path, content: MeasuredBRDF, output: list[Contender]) -> dict[str, Any]:
        document = {
            "name": path.stem,
            "channels": sources.channels(content),
            **self._identity(path),
            "fits": _scores(content, output),
        }
        for kind, file in self._files(path).items():
            file.parent.mkdir(parents=True, exist_ok=True)
            with replacing(file) as scratch:
                if kind == "picture":
                    models = {c.model: _quick(c.result) for c in output if c.result and _usable(c.result)}
                    figure = comparison_pictures.material(content, models, document)
                    figure.savefig(scratch, format="png")
                else:
                    scratch.write_text(report.to_json(document), encoding="utf-8")
        return document

    def _identity(self, path: Path) -> dict[str, Any]:
        return {"source": str(path), "models": list(self.models), "loss": self.loss}

    def _files(self, path: Path) -> dict[str, Path]:
        """The picture, then the document: what it says is then all there."""
        if self.out is None:
            return {}
        name = path.stem.replace(":", "-")
        return {"picture": self.out / f"{name}.png", "json": self.out / f"{name}.json"}


def run(
    files: Sequence[Path],
    models: Sequence[str],
    loss: str = "l2",
    out: Path | None = None,
    as_json: bool = False,
    force: bool = False,
) -> int:
    """Compare models on every file, show the table on standard output, and return the exit status."""
    _refuse_nonsense(files, models, loss, out)
    numerics.prepare()
    task = CompareTask(tuple(models), loss, out, force)
    outcome = batch.run(files, task, Console(stderr=True), chunk=4)
    documents = [outcome.records[path] for path in files if path in outcome.records]
    if out is not None and documents:
        _write_summary(out, documents)
    if as_json:
        failed = [{"name": p.stem, "source": str(p), "error": text} for p, text in outcome.errors.items()]
        print(report.to_json([*documents, *failed]))
    elif documents:
        _show(documents)
    report.say_what_happened(outcome, len(files))
    return outcome.exit_status


def _refuse_nonsense(files: Sequence[Path], models: Sequence[str], loss: str, out: Path | None) -> None:
    unknown = [model for model in models if model not in catalogue()]
    if unknown or not models:
        known = ", ".join(catalogue())
        raise batch.Refused(f"--models {','.join(models)}: no such model {unknown}; there are: {known}")
    if loss not in (*LOSSES, "image"):
        raise batch.Refused(f"--loss {loss}: no such loss; there are: {', '.join(LOSSES)}, image")
    batch.one_stem_each(files)
    if out is None:
        return
    batch.writable_folder(out)
    written = [out / name for path in files for name in (f"{path.stem}.json", f"{path.stem}.png")]
    results = {path.resolve() for path in (*written, out / "comparison.csv", out / "comparison.png")}
    for path in files:
        if path.resolve() in results or path.stem == "comparison":
            raise batch.Refused(
                f"--out {out}: a result would overwrite {path}, or be taken for the summary comparison.*; "
                "name another folder, or rename the file"
            )


# Fitting and scoring


def _fitted(model: str, inputs: Sequence[MeasuredBRDF], loss: str) -> list[Contender]:
    """One contender for each input. A model that cannot be fitted to them is an entry that says why."""
    begin = time.perf_counter()
    try:
        results: list = catalogue()[model].fit(inputs, loss)
    except (ValueError, ArithmeticError) as error:
        if len(inputs) > 1:  # perhaps only one is at fault, or they share no grid
            return [contender for one in inputs for contender in _fitted(model, [one], loss)]
        return [Contender(model, None, time.perf_counter() - begin, str(error))]
    seconds = (time.perf_counter() - begin) / len(inputs)
    return [Contender(model, result, seconds) for result in results]


def _scores(measured: MeasuredBRDF, contenders: Sequence[Contender]) -> list[dict[str, Any]]:
    """What is to be said of each fit; lists have one number for each channel."""
    try:
        appearance = Appearance.of(measured)
    except ValueError:  # no channels that a picture could be made of
        appearance = None
    comparison = Comparison.of(measured)
    return [_score(comparison, appearance, contender) for contender in contenders]


def _score(comparison: Comparison, appearance: Appearance | None, contender: Contender) -> dict[str, Any]:
    about = {"model": contender.model, "seconds": contender.seconds}
    if contender.result is None:
        nothing = [float("nan")] * len(comparison.largest_albedo)
        return {**about, "error": contender.error, **dict.fromkeys(_ERRORS, nothing), "lab_difference": None}
    quick = _quick(contender.result)
    errors = comparison.errors(quick)
    return {
        **about,
        "recipe": contender.result.recipe,
        "status": [FitStatus(int(code)).name.lower() for code in np.atleast_1d(contender.result.status)],
        **{name: np.asarray(errors[name]).tolist() for name in _ERRORS},
        "lab_difference": None if appearance is None else float(appearance.difference(quick)),
        **_parameters(contender.result),
    }


def _parameters(result: FitResult) -> dict[str, Any]:
    """How many numbers a channel takes, and those that have a name."""
    paths, _ = jax.tree_util.tree_flatten_with_path(result.model)
    values = {jax.tree_util.keystr(path).lstrip("."): np.atleast_1d(leaf) for path, leaf in paths}
    named = {name: values[name].tolist() for name in result.parameters if name in values}
    channels = len(np.atleast_1d(result.status))
    count = len(named) or sum(value.size for value in values.values()) // channels
    return {"parameter_count": count, "parameters": named}


def _quick(result: FitResult) -> AbstractBRDF:
    return cast(AbstractBRDF, result.model).tabulated()


def _usable(result: FitResult) -> bool:
    """Whether any channel has a model that can be drawn."""
    nothing = (FitStatus.TOO_FEW_SAMPLES, FitStatus.NOT_FINITE)
    return not np.all(np.isin(result.status, nothing))


# Showing


def _show(documents: Sequence[Mapping[str, Any]]) -> None:
    """One row for each material and model; errors are means over the channels."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for name in ("material", "model"):
        table.add_column(name, overflow="fold")
    for name in ("L2<80°", "log<80°", "∛<80°", "ΔE", "numbers", "s"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("status")
    for document in documents:
        best = min((report.mean(fit["normalized_l2"]) for fit in document["fits"]), default=np.nan)
        for k, fit in enumerate(document["fits"]):
            material = Text(report.printable(document["name"]) if k == 0 else "")
            bold = "bold" if report.mean(fit["normalized_l2"]) == best else ""
            table.add_row(material, *_row(fit), style=bold, end_section=k == len(document["fits"]) - 1)
    report.wide_enough(Console()).print(table)


def _row(fit: Mapping[str, Any]) -> list[str]:
    errors = [report.number(report.mean(fit[name])) for name in _ERRORS]
    words = fit.get("error") or ", ".join(dict.fromkeys(s.replace("_", " ") for s in fit["status"]))
    count = fit.get("parameter_count")
    return [
        fit["model"],
        *errors,
        report.number(fit["lab_difference"]),
        "–" if count is None else str(count),
        report.number(fit["seconds"], ".2g"),
        words,
    ]


def _write_summary(out: Path, documents: Sequence[Mapping[str, Any]]) -> None:
    """comparison.csv of all materials and models, and of several materials comparison.png."""
    with (
        replacing(out / "comparison.csv") as scratch,
        scratch.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(["material", "model", "channel", "status", *_ERRORS, "lab_difference", "seconds"])
        for document in documents:
            for fit in document["fits"]:
                for c, channel in enumerate(document["channels"]):
                    status = fit["status"][c] if "status" in fit else fit["error"]
                    errors = [fit[name][c] for name in _ERRORS]
                    row = [document["name"], fit["model"], channel, status, *errors]
                    writer.writerow([*row, fit["lab_difference"], fit["seconds"]])
    if len(documents) > 1:
        with replacing(out / "comparison.png") as scratch:
            comparison_pictures.across(documents).savefig(scratch, format="png")
