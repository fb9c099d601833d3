"""`jaxbrdf patches`: ellipsoids fitted to the distribution of normals of every patch of height maps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from data_loaders import DataError, read_about, read_ndf_maps, write_ndf_maps
from data_loaders.files import replacing
from fitting import fit_ndf_patches
from jaxbrdf import (
    Ellipsoid,
    FitStatus,
    Heightfield,
    NDFMap,
    PatchNDFs,
    aligned_maps,
    ndf_map,
    patch_ndfs,
)
from jaxbrdf.cli import batch, map_pictures, numerics, report, scans


class Error(NamedTuple):
    """What is shown of a fit's cost, and its name."""

    name: str
    of: Callable[[np.ndarray], np.ndarray]


LOSSES = {  # what --loss knows; see `fit_ndf` for the costs
    "likelihood": Error("KL", lambda cost: cost / 100),
    "l2": Error("L2", lambda cost: np.sqrt(cost / 50)),
}


@dataclass(frozen=True)
class Options:
    """What the command was asked for."""

    size: float
    stride: float | None = None
    sigma: float | None = None
    loss: str = "likelihood"
    cells: int = 65
    treatment: scans.Treatment = field(default_factory=scans.Treatment)

    def refuse_nonsense(self) -> None:
        self.treatment.refuse_nonsense()
        if self.loss not in LOSSES:
            raise batch.Refused(f"--loss {self.loss}: expected one of {', '.join(LOSSES)}")
        if self.cells < 5:
            raise batch.Refused(f"--cells {self.cells}: expected at least 5 along the table")
        for name, length in (("size", self.size), ("stride", self.stride)):
            if length is not None and not length > 0:
                raise batch.Refused(f"--{name} {length:g}: expected a length in µm greater than 0")

    def about(self) -> dict[str, str | float]:
        """What the file says of how its maps were made."""
        numbers = {"patch": self.size, "stride": self.stride or self.size, "cells": float(self.cells)}
        sigma = {"sigma": "default" if self.sigma is None else self.sigma}
        return {"loss": self.loss, **numbers, **sigma, **self.treatment.about()}

    def tables(self, heightfield: Heightfield) -> PatchNDFs:
        return patch_ndfs(heightfield, self.size, self.stride, sigma=self.sigma, cells=self.cells)

    def fitted(self, name: str, heightfield: Heightfield) -> NDFMap:
        patches = self.tables(heightfield)
        start = Ellipsoid(*(jnp.array(value) for value in (0.2, 0.2, 0.0, 0.0, 0.0)))
        return ndf_map(patches, fit_ndf_patches(start, patches, loss=self.loss), name)


@dataclass(frozen=True)
class PatchTask(batch.Task[tuple[str, Heightfield], NDFMap, NDFMap]):
    """Fit the patches of each scan; after each, `out` is written whole, with all maps so far."""

    out: Path
    options: Options
    files: Sequence[Path]
    maps: dict[Path, NDFMap]  # what is finished
    verb = "fitting"

    def finished(self, path: Path) -> NDFMap | None:
        newer = path.exists() and self.out.exists() and self.out.stat().st_mtime_ns > path.stat().st_mtime_ns
        if not newer:
            self.maps.pop(path, None)
        return self.maps.get(path)

    def read(self, path: Path) -> tuple[str, Heightfield]:
        return path.stem, self.options.treatment.read(path)

    def process(self, inputs: Sequence[tuple[str, Heightfield]]) -> Sequence[NDFMap]:
        return [self.options.fitted(name, heightfield) for name, heightfield in inputs]

    def save(self, path: Path, content: tuple[str, Heightfield], output: NDFMap) -> NDFMap:
        self.maps[path] = output
        self.write(self.maps)
        return output

    def write(self, maps: Mapping[Path, NDFMap]) -> None:
        """The file, with the maps in the order of the scans."""
        done = [path for path in self.files if path in maps]
        self.out.parent.mkdir(parents=True, exist_ok=True)
        source = [path.resolve() for path in done]
        write_ndf_maps(self.out, [maps[path] for path in done], source, self.options.about())


def run(
    paths: Sequence[Path],
    out: Path,
    options: Options,
    *,
    as_json: bool = False,
    picture: bool = True,
    force: bool = False,
) -> int:
    """Fit the patches of all scans, show what came of them, and return the exit status."""
    options.refuse_nonsense()
    files = scans.inputs(paths, out)
    batch.one_stem_each(files)
    numerics.prepare()
    earlier = {} if force or not out.exists() else _earlier(out, options, files)
    task = PatchTask(out, options, files, earlier)
    outcome = batch.run(files, task, Console(stderr=True), chunk=1)
    if outcome.records and not outcome.interrupted:
        try:
            _finish(task, outcome, picture)
        except (DataError, OSError) as error:
            raise batch.Refused(str(error)) from error
    _tell(task, outcome, as_json)
    report.say_what_happened(outcome, len(files))
    return outcome.exit_status


def _earlier(out: Path, options: Options, files: Sequence[Path]) -> dict[Path, NDFMap]:
    """The maps that an earlier run of the same command finished; refuses any other file of that name."""
    try:
        about, maps = read_about(out), read_ndf_maps(out)
    except DataError as error:
        raise batch.Refused(f"--out {out}: is there already ({error}); --force replaces it") from error
    said, given = about["source"], {str(path.resolve()): path for path in files}
    sources = [str(source) for source in said] if isinstance(said, tuple) else []
    others = [source for source in sources if source not in given]
    if others or not options.about().items() <= about.items():
        reason = f"holds {others[0]} too" if others else "its maps were made in another way"
        raise batch.Refused(f"--out {out}: is there already, and {reason}; --force replaces it")
    return {given[source]: item for source, item in zip(sources, maps, strict=True)}


def _finish(task: PatchTask, outcome: batch.Report, picture: bool) -> None:
    """Names all ellipsoids by the orientation of all, and draws the map of most fitted patches."""
    done = [path for path in task.files if path in outcome.records]
    task.maps.update(zip(done, aligned_maps([outcome.records[path] for path in done]), strict=True))
    outcome.records.update(task.maps)
    task.write(task.maps)
    path = max(done, key=lambda path: task.maps[path].success.sum())
    if picture and task.maps[path].success.any():
        # Made again: the tables of all scans would not fit into the memory.
        tables = task.options.tables(task.options.treatment.read(path))
        item, error = task.maps[path], LOSSES[task.options.loss]
        figure = map_pictures.patches(tables, item, error.name, error.of(np.asarray(item.cost)))
        with replacing(task.out.with_suffix(".png")) as scratch:
            figure.savefig(scratch, format="png")


def _tell(task: PatchTask, outcome: batch.Report, as_json: bool) -> None:
    found = [(path, outcome.records[path]) for path in task.files if path in outcome.records]
    error = LOSSES[task.options.loss]
    documents = [_document(path, item, error, path in outcome.kept) for path, item in found]
    if as_json:
        failed = [{"source": str(path), "error": text} for path, text in outcome.errors.items()]
        about = {"out": str(task.out), **task.options.about()}
        print(report.to_json({**about, "maps": documents, "failed": failed}))
    elif documents:
        console = report.wide_enough(Console())
        console.print(_table(documents, error.name))
        report.say(console, f"written: {task.out}")


def _document(path: Path, item: NDFMap, error: Error, kept: bool) -> dict[str, Any]:
    """A map in numbers: parameters as mean and standard deviation over the fitted patches."""
    ok, status = item.success, np.asarray(item.status)
    images = {name: np.asarray(getattr(item.ndf, name))[ok] for name in item.names}
    return {
        "name": path.stem,
        "source": str(path),
        "kept": kept,
        "shape": list(item.shape),
        "size": list(item.size),
        "step": list(item.step),
        "normals": float(np.median(np.asarray(item.counts))),
        "fitted": int(ok.sum()),
        "statuses": {s.name.lower(): int(np.sum(status == s)) for s in FitStatus if np.any(status == s)},
        "parameters": {
            name: {"mean": float(np.mean(image)), "std": float(np.std(image))} if ok.any() else None
            for name, image in images.items()
        },
        error.name: float(np.median(error.of(np.asarray(item.cost)[ok]))) if ok.any() else None,
    }


def _table(documents: Sequence[dict[str, Any]], error: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("scan", overflow="fold")
    for name in ("patches", "µm", "fitted", "alpha_x", "alpha_y", "theta_x, °", "theta_y, °", "theta_z, °"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column(error, justify="right", no_wrap=True)
    for document in documents:
        shape = " × ".join(str(n) for n in reversed(document["shape"]))
        size = " × ".join(f"{length:.4g}" for length in document["size"])
        numbers = [_mean_and_spread(name, value) for name, value in document["parameters"].items()]
        star = "*" if document["kept"] else ""
        row = (shape, size, str(document["fitted"]), *numbers, report.number(document[error]))
        table.add_row(Text(report.printable(document["name"] + star)), *row)
    return table


def _mean_and_spread(name: str, value: dict[str, float] | None) -> str:
    if value is None:
        return "–"
    unit = 180 / np.pi if name.startswith("theta") else 1
    return f"{unit * value['mean']:.3g} ± {unit * value['std']:.2g}"
