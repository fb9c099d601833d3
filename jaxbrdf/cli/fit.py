"""The work of `jaxbrdf fit`: measured reflectance in; fitted models, their errors and pictures out."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from rich.console import Console

from data_loaders import DataError, fit_to_json, load_fit, read_brdf, save_fit
from data_loaders.files import replacing
from fitting import fit_shifted_gamma
from jaxbrdf import (
    AbstractBRDF,
    FitResult,
    MeasuredBRDF,
    as_table,
    compare,
)
from jaxbrdf.cli import batch, numerics, pictures, report, sources
from jaxbrdf.resampling import Reflectance

Fit = Callable[[Sequence[MeasuredBRDF], str], FitResult]  # a list of materials and a recipe to one batch

MODELS: dict[str, Fit] = {"shifted-gamma": fit_shifted_gamma}  # what --model knows

_LIMITS = {"": np.pi / 2, "_below_80": np.radians(80)}  # suffix of an error's name: largest angle used
_CHANNELS = 8  # of one material: a table of more fills the memory


@dataclass(frozen=True)
class Fitted:
    """One fitted material: the result, and the JSON document about it."""

    result: FitResult
    document: dict[str, Any]


@dataclass(frozen=True)
class FitTask(batch.Task[MeasuredBRDF, FitResult, Fitted]):
    """Fit one model to each file; write NAME.png, NAME.h5 and at last NAME.json into the folder `out`."""

    out: Path
    model: str
    recipe: str
    with_pictures: bool = True
    force: bool = False
    note: str = ""  # what the reader of document and picture must know about the data
    verb = "fitting"

    def finished(self, path: Path) -> Fitted | None:
        files = self.files(path)
        if self.force or not all(_newer(file, path) for file in files.values()):
            return None
        try:
            result = load_fit(files["fit"])
            document = json.loads(files["json"].read_text(encoding="utf-8"))
        except (DataError, ValueError, OSError):
            return None
        same = isinstance(document, dict) and self.identity(path).items() <= document.items()
        return Fitted(result, document | {"files": _as_text(files)}) if same else None

    def read(self, path: Path) -> MeasuredBRDF:
        return table_to_fit(path, read_brdf(path))

    def process(self, inputs: Sequence[MeasuredBRDF]) -> Sequence[FitResult]:
        results = MODELS[self.model](inputs, self.recipe)
        return [results[i] for i in range(len(inputs))]

    def save(self, path: Path, content: MeasuredBRDF, output: FitResult) -> Fitted:
        files = self.files(path)
        self.out.mkdir(parents=True, exist_ok=True)
        quick = cast(AbstractBRDF, output.model).tabulated()
        errors = score(quick, content)
        source = self.source(path)
        channels = {"channels": sources.channels(content)}
        document = {
            "name": path.stem,
            **channels,
            **fit_to_json(output, source),
            **self.identity(path),
            **errors,
        }
        if self.with_pictures:
            figure = pictures.material(content, quick, path.stem, errors["normalized_l2"], self.note)
            with replacing(files["picture"]) as scratch:
                figure.savefig(scratch, format="png")
        save_fit(files["fit"], output, source)
        with replacing(files["json"]) as scratch:
            scratch.write_text(report.to_json(document), encoding="utf-8")
        return Fitted(output, document | {"files": _as_text(files)})

    def files(self, path: Path) -> dict[str, Path]:
        """What is made of an input. The document is written last: what it says holds for the others too."""
        suffixes = {"fit": ".h5", "json": ".json"} | ({"picture": ".png"} if self.with_pictures else {})
        return {kind: self.out / (path.stem + suffix) for kind, suffix in suffixes.items()}

    def source(self, path: Path) -> str:
        """Where the data come from: the file, or what the note says of it."""
        return self.note or str(path.resolve())

    def identity(self, path: Path) -> dict[str, Any]:
        """What makes two fits the same fit: the input and the way it was fitted."""
        return {"source": self.source(path), "requested": {"model": self.model, "recipe": self.recipe}}


def run(files: Sequence[Path], task: FitTask, as_json: bool = False) -> int:
    """Fit every file, show what came of it on standard output, and return the exit status."""
    _refuse_nonsense(files, task)
    numerics.prepare()
    outcome = batch.run(files, task, Console(stderr=True))
    fits = {path: outcome.records[path] for path in files if path in outcome.records}
    if as_json:
        print(report.to_json(_documents(fits, outcome)))
    else:
        report.show_fits(fits, outcome.kept)
    report.say_what_happened(outcome, len(files))
    return outcome.exit_status


def table_to_fit(path: Path, reflectance: Reflectance) -> MeasuredBRDF:
    """What a file holds as a table; raises DataError for a spectrum, which would fill the memory."""
    count = len(sources.channels(reflectance))
    if count > _CHANNELS:
        found = f"{count}; `jaxbrdf convert --rgb` makes colours of a spectrum"
        raise DataError(path, f"at most {_CHANNELS} channels", found)
    table = reflectance if isinstance(reflectance, MeasuredBRDF) else as_table(reflectance)
    return replace(table, name=table.name or path.stem)


def score(model: AbstractBRDF, measured: MeasuredBRDF) -> dict[str, list[float]]:
    """The errors of one material for each channel, over all directions and over those below 80°."""
    errors = compare(model, measured, tuple(_LIMITS.values()))
    return {
        name + suffix: np.asarray(values[i]).tolist()
        for i, suffix in enumerate(_LIMITS)
        for name, values in errors.items()
    }


def _refuse_nonsense(files: Sequence[Path], task: FitTask) -> None:
    if task.model not in MODELS:
        raise batch.Refused(f"--model {task.model}: no such model; there are: {', '.join(MODELS)}")
    batch.one_stem_each(files)
    batch.writable_folder(task.out)
    for path in files:
        if path.resolve() in {output.resolve() for output in task.files(path).values()}:
            raise batch.Refused(
                f"--out {task.out}: a result would overwrite the input {path}; name another folder"
            )


def _documents(fits: Mapping[Path, Fitted], outcome: batch.Report) -> list[dict[str, Any]]:
    """The JSON documents of the fits, then one with the error of each file that failed."""
    done = [fit.document | {"kept": path in outcome.kept} for path, fit in fits.items()]
    failed = [
        {"name": path.stem, "source": str(path), "error": text} for path, text in outcome.errors.items()
    ]
    return done + failed


def _newer(output: Path, source: Path) -> bool:
    return output.exists() and source.exists() and output.stat().st_mtime_ns > source.stat().st_mtime_ns


def _as_text(files: Mapping[str, Path]) -> dict[str, str]:
    return {kind: str(path) for kind, path in files.items()}
