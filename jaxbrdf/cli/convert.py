"""`jaxbrdf convert`: a reflectance from one format to another, saying what that changed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.console import Console

from data_loaders import read_brdf, to_rgb, write_brdf
from jaxbrdf import resampling_error
from jaxbrdf.cli import batch, numerics, report, sources
from jaxbrdf.resampling import Reflectance

_ROWS = 4  # channels that are shown one by one


class ConvertTask(batch.Task[Reflectance, Reflectance, dict[str, Any]]):
    """One file to another; what was written is read again, and compared."""

    verb = "converting"

    def __init__(self, target: Path, rgb: bool):
        self.target, self.rgb = target, rgb

    def finished(self, path: Path) -> None:
        return None

    def read(self, path: Path) -> Reflectance:
        return sources.load(path)

    def process(self, inputs: Sequence[Reflectance]) -> Sequence[Reflectance]:
        return [to_rgb(reflectance) if self.rgb else reflectance for reflectance in inputs]

    def save(self, path: Path, content: Reflectance, output: Reflectance) -> dict[str, Any]:
        written = write_brdf(self.target, output)
        again = read_brdf(self.target)
        about = {
            "source": str(path),
            "target": str(self.target),
            "read_as": sources.format_name(path),
            "written_as": sources.format_name(self.target),
            "from": sources.kind(content),
            "to": sources.kind(again),
            "channels": sources.channels(again),
        }
        if written is content and _same_numbers(content, again):
            return about | {"lossless": True}
        error = resampling_error(output, again)
        return about | {
            "lossless": False,
            "pairs_compared": error.pairs,
            "relative_l2": error.relative_l2.tolist(),
            "median_relative_error": error.median.tolist(),
        }


def run(source: Path, target: Path, rgb: bool = False, force: bool = False, as_json: bool = False) -> int:
    """Convert, show what became of it, and return the exit status."""
    _refuse_nonsense(source, target, force)
    numerics.prepare()
    outcome = batch.run([source], ConvertTask(target, rgb), Console(stderr=True))
    documents = list(outcome.records.values())
    if as_json:
        documents += [{"source": str(path), "error": text} for path, text in outcome.errors.items()]
    for document in documents:
        print(report.to_json(document) if as_json else _in_words(document))
    report.say_failures(outcome, 1)
    return outcome.exit_status


def _refuse_nonsense(source: Path, target: Path, force: bool) -> None:
    if target.exists() and source.exists() and target.samefile(source):
        raise batch.Refused(f"{target}: a file cannot be converted onto itself; give the result another name")
    if target.exists() and not force:
        raise batch.Refused(f"{target} is there already; --force replaces it")
    if not target.parent.is_dir():
        raise batch.Refused(f"{target}: expected a folder to write to, found none named {target.parent}")


def _same_numbers(a: Reflectance, b: Reflectance) -> bool:
    """Whether two records hold the same arrays, bit for bit; texts may differ."""
    leaves = [jax.tree.leaves(record) for record in (a, b)]
    return type(a) is type(b) and all(
        np.array_equal(x, y, equal_nan=True) for x, y in zip(*leaves, strict=True)
    )


def _in_words(document: dict[str, Any]) -> str:
    source, target = (report.printable(document[end]) for end in ("source", "target"))
    ends = f"{source} ({document['read_as']}) -> {target} ({document['written_as']})"
    if document["lossless"]:
        return f"{ends}\nlossless: read again, every number is the same"
    changed = f"from {document['from']} to {document['to']}"
    if not any(document["relative_l2"]):
        return f"{ends}\nrearranged {changed}: all {document['pairs_compared']} values looked at are the same"
    return "\n".join(
        [
            ends,
            f"resampled {changed}; the error where it was known,",
            f"both directions below 80 degrees ({document['pairs_compared']} pairs):",
            *_error_lines(document),
        ]
    )


def _error_lines(document: dict[str, Any]) -> list[str]:
    """A row for each channel, or for the least and the largest error of many."""
    columns = [document["relative_l2"], document["median_relative_error"]]
    names = document["channels"]
    if len(names) > _ROWS:
        names, columns = ["least", "largest"], [[min(column), max(column)] for column in columns]
    rows = [
        (name, *(report.number(x, ".2%") for x in numbers))
        for name, *numbers in zip(names, *columns, strict=True)
    ]
    head = ("channel", "relative L2", "median relative")
    return [f"  {name:>8} {l2:>12} {median:>16}" for name, l2, median in [head, *rows]]
