"""The work of `jaxbrdf check`: whether fits, measurements and published models obey physics."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from data_loaders import DataError, load_fit, recognise
from data_loaders.files import replacing
from data_loaders.hdf5_record import record_format
from data_loaders.store import FIT
from jaxbrdf import AbstractBRDF, CookTorrance, MeasuredBRDF, ShiftedGammaBRDF
from jaxbrdf.checks import (
    AZIMUTHS,
    INCIDENCES,
    albedos,
    evaluate,
    is_isotropic,
    reciprocity_error,
    sample_pairs,
    sampling,
)
from jaxbrdf.cli import batch, numerics, report, sources

_SHOWN = (0, 30, 60, 80, 89)  # degrees of incidence in the table
_EXACT = 1e-3  # of an albedo: what it exceeds 1 by may be the quadrature's
_ROUNDING = 1e-6  # of a reciprocity error
_COLUMNS = 4  # channels that stand side by side; of more, the least and the largest number

_FOUR_OVER_PI = (
    "Bagher's and Cook & Torrance's form has 1/π where facets have 1/4: it reflects 4/π times the light of "
    "its facets, so that published parameters may exceed 1."
)


@dataclass(frozen=True)
class Subject:
    """A reflectance to be checked; `model` is its class, `brdf` what is evaluated in its place."""

    name: str
    kind: str
    model: str
    brdf: AbstractBRDF


@dataclass(frozen=True)
class CheckTask(batch.Task[list[Subject], list[dict[str, Any]], dict[str, Any]]):
    """Check what is in each file; writes nothing. The record is the JSON document about the file."""

    verb = "checking"

    def finished(self, path: Path) -> None:
        return None

    def read(self, path: Path) -> list[Subject]:
        if sources.is_published(path):
            return [_subject(path, str(path), "published")]
        if recognise(path).name == "HDF5" and record_format(path) == FIT.format:
            return list(_from_fit(path))
        return [_subject(path, path.stem, "measured")]

    def process(self, inputs: Sequence[list[Subject]]) -> Sequence[list[dict[str, Any]]]:
        return [[examine(subject) for subject in subjects] for subjects in inputs]

    def save(self, path: Path, content: list[Subject], output: list[dict[str, Any]]) -> dict[str, Any]:
        return {"name": path.stem, "source": str(path), "kind": content[0].kind, "reflectances": output}


def run(files: Sequence[Path], as_json: bool = False, plot: Path | None = None) -> int:
    """Check every file, show what was found on standard output, and return the exit status."""
    batch.writable_picture(plot, files)
    numerics.prepare()
    outcome = batch.run(files, CheckTask(), Console(stderr=True), chunk=1)
    documents = list(outcome.records.values())
    if as_json:
        failed = [{"name": p.stem, "source": str(p), "error": text} for p, text in outcome.errors.items()]
        print(report.to_json(documents + failed))
    else:
        _show(documents)
    if plot is not None and documents:
        with replacing(plot) as scratch:
            picture([found for document in documents for found in document["reflectances"]]).savefig(
                scratch, format=plot.suffix[1:].lower()
            )
    report.say_failures(outcome, len(files))
    return outcome.exit_status


# Reading


def _subject(path: Path, name: str, kind: str) -> Subject:
    brdf = sources.load(path)
    if not isinstance(brdf, AbstractBRDF):
        raise DataError(path, "a reflectance that is known in all directions", sources.kind(brdf))
    return Subject(name, kind, sources.class_names(brdf), brdf)


def _from_fit(path: Path) -> Iterator[Subject]:
    """Each material of a fit."""
    result = load_fit(path)
    if not isinstance(result.model, AbstractBRDF):
        raise DataError(path, "a fitted reflectance", f"a fitted {type(result.model).__name__}")
    model = sources.class_names(result.model)
    if np.ndim(result.status) < 2:
        yield Subject(
            result.names[0] if result.names else path.stem, "fitted", model, result.model.tabulated()
        )
        return
    for i in range(len(result.status)):
        name = result.names[i] if result.names else f"{path.stem} {i}"
        yield Subject(name, "fitted", model, cast(AbstractBRDF, result[i].model).tabulated())


# Examining


def examine(subject: Subject) -> dict[str, Any]:
    """All checks of one reflectance, as plain numbers; each list with one number for each channel."""
    brdf = subject.brdf.anonymous
    document = {
        "name": subject.name,
        "kind": subject.kind,
        "model": subject.model,
        "isotropic": bool(is_isotropic(brdf)),
        **_missing(brdf),
        **_values(brdf),
        "reciprocity_error": np.atleast_1d(reciprocity_error(brdf)).tolist(),
        **_energy(brdf),
        "sampling": _sampling(brdf),
    }
    return document | {"channels": len(document["reciprocity_error"]), "verdicts": _verdicts(document)}


def _missing(brdf: AbstractBRDF) -> dict[str, Any]:
    """The share of a table's cells above the horizon that hold no sample; None for a formula."""
    if not isinstance(brdf, MeasuredBRDF):
        return {"missing_share": None}
    return {"missing_share": brdf.missing_share.tolist()}


def _values(brdf: AbstractBRDF) -> dict[str, Any]:
    """The least value, and how often f is negative or, in a formula, no number."""
    wi, wo = sample_pairs()
    above = np.asarray((wi[:, 2] > 0) & (wo[:, 2] > 0))
    f = np.asarray(evaluate(brdf, wi, wo))[above]
    f = f.reshape(len(f), -1)
    no_number = np.mean(~np.isfinite(f), axis=0) * (not isinstance(brdf, MeasuredBRDF))
    least = np.min(np.where(np.isfinite(f), f, np.inf), axis=0)
    negative = np.mean(f < 0, axis=0)
    return {
        "smallest_value": least.tolist(),
        "negative_share": negative.tolist(),
        "no_number_share": no_number.tolist(),
    }


def _energy(brdf: AbstractBRDF) -> dict[str, Any]:
    """The albedo at each incidence, largest over the azimuths, and where it is largest of all."""
    found = np.asarray(albedos(brdf))
    found = found.reshape(len(INCIDENCES), len(AZIMUTHS), -1)
    azimuths = np.array(AZIMUTHS)[np.argmax(np.round(found, 4), axis=1)]  # of equal ones, the first
    by_incidence = np.max(found, axis=1)
    worst = np.argmax(by_incidence, axis=0)
    channels = range(found.shape[-1])
    return {
        "incidences": list(INCIDENCES),
        "albedo": by_incidence.tolist(),
        "azimuth_of_albedo": azimuths.tolist(),
        "largest_albedo": [float(by_incidence[worst[c], c]) for c in channels],
        "largest_at": [[INCIDENCES[worst[c]], int(azimuths[worst[c], c])] for c in channels],
        "energy_excess": np.maximum(by_incidence.max(axis=0) - 1, 0).tolist(),
    }


def _sampling(brdf: AbstractBRDF) -> dict[str, Any]:
    found = sampling(brdf)
    numbers = {name: _by_channel(values) for name, values in found._asdict().items()}
    return numbers | {"consistent": np.all(_by_channel(found.consistent), axis=0).tolist()}


def _by_channel(values: np.ndarray | jax.Array) -> list[list[Any]]:
    """(N,) or (N, C) as N lists of C."""
    return np.asarray(values).reshape(len(values), -1).tolist()


# Verdicts


def _verdicts(found: dict[str, Any]) -> dict[str, str]:
    """What the numbers say, in words."""
    return {
        "values": _on_values(found),
        "reciprocity": _on_reciprocity(found),
        "energy": _on_energy(found),
        "sampling": _on_sampling(found["sampling"]),
    }


def _on_values(found: dict[str, Any]) -> str:
    if max(found["no_number_share"]) > 0:
        return f"no number at {_percent(max(found['no_number_share']))} of the directions"
    if max(found["negative_share"]) > 0:
        return f"negative at {_percent(max(found['negative_share']))} of the directions"
    return "nowhere negative"


def _on_reciprocity(found: dict[str, Any]) -> str:
    if found["model"] == MeasuredBRDF.__name__:
        return "reciprocal by construction: the table holds one half of φ_d, which serves both ways"
    error = max(found["reciprocity_error"])
    if np.isnan(error):
        return "not known"
    if error <= _ROUNDING:
        return "reciprocal"
    return f"not reciprocal: the two ways differ by up to {_percent(error)}"


def _on_energy(found: dict[str, Any]) -> str:
    worst = int(np.argmax(found["largest_albedo"]))
    theta, phi = found["largest_at"][worst]
    side = "" if found["isotropic"] else f", azimuth {phi}°"
    most = f"{found['largest_albedo'][worst]:.3g} of the light at {theta}°{side}"
    if max(found["no_number_share"]) > 0:
        return "not known"
    if found["energy_excess"][worst] > _EXACT:
        return f"creates energy: reflects {most}"
    return f"conserves energy: at most {most}"


def _on_sampling(found: dict[str, Any]) -> str:
    if not np.all(found["consistent"]):
        return "samples do not fit the reflectance"
    if not np.any(found["resolved"]):
        return "not checked: lobes too narrow for the quadrature"
    return "samples fit the reflectance"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


# Showing


def _show(documents: Sequence[dict[str, Any]]) -> None:
    console = Console()
    console.width = console.width if console.is_terminal else max(console.width, 120)
    found = [reflectance for document in documents for reflectance in document["reflectances"]]
    for reflectance in found:
        console.print(_heading(reflectance))
        console.print(_table(reflectance))
        console.print()
    if any(_has_four_over_pi(f) and max(f["energy_excess"]) > _EXACT for f in found):
        console.print(_FOUR_OVER_PI, highlight=False)


def _has_four_over_pi(found: dict[str, Any]) -> bool:
    return found["model"] in (ShiftedGammaBRDF.__name__, CookTorrance.__name__)


def _heading(found: dict[str, Any]) -> Text:
    what = "a measured table" if found["kind"] == "measured" else f"{found['kind']}: {found['model']}"
    return Text.assemble(
        (report.printable(found["name"]), "bold"),
        f"  {what}, {'isotropic' if found['isotropic'] else 'anisotropic'}",
    )


def _table(found: dict[str, Any]) -> Table:
    count = found["channels"]
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    table.add_column("", no_wrap=True)
    for name in _columns(count):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("")
    for label, values, digits, words in _rows(found):
        shown = values if count <= _COLUMNS else [min(values), max(values)]
        table.add_row(label, *(report.number(value, digits) for value in shown), Text(words))
    return table


def _columns(count: int) -> Sequence[str]:
    if count == 1:
        return ("value",)
    return report.channel_names(count) if count <= _COLUMNS else ("least", "largest")


def _rows(found: dict[str, Any]) -> Iterator[tuple[str, list[float], str, str]]:
    """(label, a number for each channel, their format, the verdict) of each row."""
    verdicts = found["verdicts"]
    if found["missing_share"] is not None:
        words = "of the cells above the horizon hold no sample, and count as dark"
        yield "missing", found["missing_share"], ".1%", words
    yield "smallest f (1/sr)", found["smallest_value"], ".2g", verdicts["values"]
    yield "reciprocity error", found["reciprocity_error"], ".1g", verdicts["reciprocity"]
    for i, theta in enumerate(found["incidences"]):
        if theta in _SHOWN:
            yield f"albedo at {theta}°", found["albedo"][i], ".3f", _side(found, i)
    yield "energy excess", found["energy_excess"], ".3f", verdicts["energy"]
    yield "samples off by", _samples_off_by(found["sampling"]), ".1g", verdicts["sampling"]


def _samples_off_by(found: dict[str, Any]) -> list[float]:
    """How far the albedo from samples is off the quadrature's, where that is resolved; −∞ if nowhere."""
    off = np.abs(np.array(found["mean"]) - np.array(found["albedo"]))
    return np.max(off, axis=0, initial=-np.inf, where=np.array(found["resolved"])).tolist()


def _side(found: dict[str, Any], i: int) -> str:
    """Where light must come from for an anisotropic reflectance to reflect that much."""
    if found["isotropic"] or found["incidences"][i] == 0:
        return ""
    azimuths = dict.fromkeys(found["azimuth_of_albedo"][i])
    return "from azimuth " + ", ".join(f"{phi}°" for phi in azimuths)


def picture(found: Sequence[dict[str, Any]]) -> Figure:
    """Albedo against incidence: a colour for each reflectance, a line for each channel."""
    figure = Figure(figsize=(7, 4.6), dpi=120, layout="constrained")
    axes = figure.subplots()
    for i, one in enumerate(found):
        for c, values in enumerate(np.transpose(one["albedo"])):
            label = report.printable(one["name"]).replace("$", r"\$") if c == 0 else None
            style = ("-", "--", ":")[c % 3]
            axes.plot(one["incidences"], values, style, marker=".", color=f"C{i % 10}", label=label)
    axes.axhline(1, color="0.5", linewidth=0.8)
    axes.set(xlim=(0, 90), ylim=(0, None), xlabel="incidence (degrees)", ylabel="albedo")
    axes.grid(color="0.92", linewidth=0.6)
    axes.legend(
        frameon=False,
        title="channels: solid, dashed, dotted" if max(f["channels"] for f in found) > 1 else None,
    )
    return figure
