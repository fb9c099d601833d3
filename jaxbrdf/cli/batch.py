"""Many files through one command: in chunks, with a progress bar, past the files that fail, resumable.

A command describes its work as a `Task`; `run` takes the files through it and says in a `Report` what
came of each. What a task makes of a file, and how that is shown, is the command's business.
"""

import os
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from data_loaders import DataError

# What may be the fault of a file; anything else is a bug of ours, and ends the run.
_FAILURES = (DataError, ValueError, ArithmeticError, OSError)

Input = TypeVar("Input")
Output = TypeVar("Output")
Record = TypeVar("Record")


class Refused(Exception):
    """The arguments make no sense together; nothing was done. The text says what to change."""


class Task(ABC, Generic[Input, Output, Record]):
    """What a command does with a file: read it, process it along with others, save what came of it."""

    verb: str = "working"

    @abstractmethod
    def finished(self, path: Path) -> Record | None:
        """The record of a file that an earlier run finished and that needs no work now, else None."""

    @abstractmethod
    def read(self, path: Path) -> Input:
        """The content of a file; raises DataError, ValueError or OSError for a bad one."""

    @abstractmethod
    def process(self, inputs: Sequence[Input]) -> Sequence[Output]:
        """One output for each input, all in one call."""

    @abstractmethod
    def save(self, path: Path, content: Input, output: Output) -> Record:
        """Write what came of the file at `path`, each output file whole or not at all."""


@dataclass
class Report(Generic[Record]):
    """What came of each file: its record, whether that was kept from an earlier run, or why it failed."""

    records: dict[Path, Record] = field(default_factory=dict)
    kept: set[Path] = field(default_factory=set)
    errors: dict[Path, str] = field(default_factory=dict)
    interrupted: bool = False

    @property
    def exit_status(self) -> int:
        """0 all good, 1 some file failed, 2 every file failed, 130 interrupted."""
        if self.interrupted:
            return 130
        if self.errors:
            return 1 if self.records else 2
        return 0

    @contextmanager
    def noting_failure(self, path: Path) -> Iterator[None]:
        """Write the failure of one file down, and go on."""
        try:
            yield
        except _FAILURES as error:
            self.errors[path] = _in_words(error, path)


def run(paths: Sequence[Path], task: Task, console: Console, chunk: int = 8) -> Report:
    """Take every file through `task`, `chunk` of them a call; `console` shows the progress.

    An interrupt (Ctrl-C) ends the run early: what was saved until then stays and is in the report.
    """
    report: Report = Report()
    with _progress(console) as progress:
        bar = progress.add_task(task.verb, total=len(paths))
        try:
            todo = _set_finished_aside(paths, task, report)
            for start in range(0, len(todo), chunk):
                group = todo[start : start + chunk]
                done = len(paths) - len(todo) + start
                progress.update(bar, completed=done, description=f"{task.verb} {_names(group)}")
                for _ in _run_chunk(group, task, report):
                    progress.advance(bar)
        except KeyboardInterrupt:
            report.interrupted = True
    return report


def each(paths: Sequence[Path], work: Callable[[Path], Record], verb: str, console: Console) -> Report:
    """Take files one by one through `work`, past those that fail; see `run` for `console` and interrupts."""
    report: Report = Report()
    with _progress(console) as progress:
        bar = progress.add_task(verb, total=len(paths))
        try:
            for path in paths:
                progress.update(bar, description=f"{verb} {path.stem}")
                with report.noting_failure(path):
                    report.records[path] = work(path)
                progress.advance(bar)
        except KeyboardInterrupt:
            report.interrupted = True
    return report


def one_stem_each(paths: Sequence[Path]) -> None:
    """Refuse files whose results would carry the same name."""
    twice = [stem for stem, count in Counter(path.stem for path in paths).items() if count > 1]
    if twice:
        rivals = ", ".join(str(path) for path in paths if path.stem == twice[0])
        raise Refused(
            f"results are named after their file, and these would all be named {twice[0]!r}: {rivals}; "
            "rename one, or give them different output folders"
        )


def writable_folder(out: Path) -> None:
    """Refuse an output folder that is a file, or that cannot be made or written to."""
    nearest = next(folder for folder in (out, *out.absolute().parents) if os.path.exists(folder))
    if not nearest.is_dir():
        raise Refused(f"--out {out}: expected a folder, found that {nearest} is a file; name another folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise Refused(f"--out {out}: no permission to write to {nearest}; name another folder")


def writable_picture(plot: Path | None, inputs: Sequence[Path]) -> None:
    """Refuse a picture in an unknown format, on top of an input, or where nothing can be written."""
    if plot is None:
        return
    if plot.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise Refused(f"--plot {plot}: expected a name that ends in .png, .pdf or .svg")
    if plot.resolve() in {path.resolve() for path in inputs}:
        raise Refused(f"--plot {plot}: the picture would overwrite an input; give it another name")
    writable_folder(plot.parent)


def _set_finished_aside(paths: Sequence[Path], task: Task, report: Report) -> list[Path]:
    """The files that still need work; the records of the others go into the report."""
    for path in paths:
        record = task.finished(path)
        if record is not None:
            report.records[path] = record
            report.kept.add(path)
    return [path for path in paths if path not in report.kept]


def _run_chunk(group: Sequence[Path], task: Task, report: Report) -> Iterator[Path]:
    """Read, process and save a chunk; yields each path as soon as its output is saved, or failed to be."""
    contents = {}
    for path in group:
        with report.noting_failure(path):
            contents[path] = task.read(path)
    for path, output in _process(contents, task, report):
        with report.noting_failure(path):
            report.records[path] = task.save(path, contents[path], output)
        yield path


def _process(contents: dict, task: Task, report: Report) -> list[tuple]:
    """The outputs by path. Where a chunk fails as a whole, one by one, to find the file at fault."""
    if not contents:
        return []
    try:
        return list(zip(contents, task.process(list(contents.values())), strict=True))
    except _FAILURES as error:
        if len(contents) == 1:
            report.errors.update({path: _in_words(error, path) for path in contents})
            return []
    return [pair for path in contents for pair in _process({path: contents[path]}, task, report)]


def _in_words(error: Exception, path: Path) -> str:
    """The message of an error, without the path that stands next to it in the report."""
    text = error.strerror if isinstance(error, OSError) else str(error)
    return " ".join((text or repr(error)).removeprefix(f"{path}: ").split())


def _names(group: Sequence[Path]) -> str:
    return group[0].stem if len(group) == 1 else f"{group[0].stem} and {len(group) - 1} more"


def _progress(console: Console) -> Progress:
    text = TextColumn("{task.description}", markup=False)
    columns = (text, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
