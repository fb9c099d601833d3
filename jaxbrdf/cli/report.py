"""What the commands show: tables for people, JSON for scripts, and a word about what went wrong."""

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from jaxbrdf import FitStatus
from jaxbrdf.cli import batch

_WIDE = 140  # columns a table may take where nobody's terminal limits it


def show_fits(fits: Mapping[Path, Any], kept: Collection[Path]) -> None:
    """A table on standard output with one row for each channel of each fit; see `fit.Fitted`."""
    if not fits:
        return
    table = Table(box=box.SIMPLE_HEAD, padding=0)
    table.add_column("material", overflow="fold")
    table.add_column("", no_wrap=True)
    for name in (*parameters(next(iter(fits.values())).result.model), "L2", "log<80°"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("status")
    for path, fit in fits.items():
        _add_rows(table, path.stem + ("*" if path in kept else ""), fit)
    if kept:
        table.caption, table.caption_justify = "* kept from an earlier run", "left"
    wide_enough(Console()).print(table)


def parameters(model: eqx.Module) -> dict[str, np.ndarray]:
    """The numbers of a model by name, each (C,); parts that are models (shadowing) are left out."""
    values = {f.name: getattr(model, f.name) for f in fields(model)}
    return {name: np.atleast_1d(v) for name, v in values.items() if not isinstance(v, eqx.Module)}


def channel_names(count: int) -> list[str]:
    """R, G, B for three channels, nothing for one, numbers otherwise."""
    return {1: [""], 3: ["R", "G", "B"]}.get(count, [str(c) for c in range(count)])


def to_json(document: Any) -> str:
    """Strict JSON in ASCII, indented: numbers that JSON lacks (NaN, ∞) become null."""
    return json.dumps(_strict(document), indent=2, allow_nan=False)


def say_what_happened(outcome: batch.Report, count: int) -> None:
    """On standard error: files that failed and why, files kept from an earlier run, an interrupt."""
    console = Console(stderr=True)
    for path, reason in outcome.errors.items():
        say(console, f"{path}: {reason}", style="red")
    if outcome.kept:
        text = f"{len(outcome.kept)} of {count} kept from an earlier run; --force does them again"
        say(console, text)
    if outcome.interrupted:
        say(
            console,
            f"interrupted: {len(outcome.records)} of {count} are done; the same command goes on from there",
        )


def say_failures(outcome: batch.Report, count: int) -> None:
    """On standard error: the files that failed and why, and an interrupt."""
    console = Console(stderr=True)
    for path, reason in outcome.errors.items():
        say(console, f"{path}: {reason}", style="red")
    if outcome.interrupted:
        say(console, f"interrupted: {len(outcome.records)} of {count} are done")


def say(console: Console, text: str, style: str = "") -> None:
    """One line of plain text, unwrapped, so that a path in it can be copied."""
    console.print(printable(text), style=style, markup=False, highlight=False, soft_wrap=True)


def printable(text: str) -> str:
    r"""The text, with bytes of a file's name that are not UTF-8 written as \udcXX."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _add_rows(table: Table, name: str, fit: Any) -> None:
    values = parameters(fit.result.model)
    status = np.atleast_1d(fit.result.status)
    errors = (fit.document["normalized_l2"], fit.document["log_error_below_80"])
    for c, channel in enumerate(fit.document.get("channels", channel_names(len(status)))):
        numbers = [float(value[c % len(value)]) for value in values.values()] + [error[c] for error in errors]
        words = FitStatus(int(status[c])).name.lower().replace("_", " ")
        table.add_row(Text(printable(name) if c == 0 else ""), channel, *map(number, numbers), words)


def number(value: float | None, digits: str = ".3g") -> str:
    """A number in a table; a dash where there is none."""
    return "–" if value is None or not math.isfinite(value) else format(value, digits)


def mean(values: Sequence[float | None]) -> float:
    """The mean over channels; NaN where one has no number, null in a document that was kept."""
    return float(np.mean([math.nan if value is None else value for value in values]))


def wide_enough(console: Console) -> Console:
    """In a file or a pipe a table is not squeezed into eighty columns."""
    if not console.is_terminal:
        console.width = max(console.width, _WIDE)
    return console


def _strict(document: Any) -> Any:
    if isinstance(document, Mapping):
        return {key: _strict(value) for key, value in document.items()}
    if isinstance(document, list | tuple):
        return [_strict(value) for value in document]
    if isinstance(document, float) and not math.isfinite(document):
        return None
    return document
