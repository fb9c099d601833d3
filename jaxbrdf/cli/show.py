"""`jaxbrdf show`: what is in a file of reflectance, in numbers and as a picture."""

from collections.abc import Iterator, Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from data_loaders.files import replacing
from jaxbrdf import (
    AbstractBRDF,
    AdaptiveBRDF,
    MeasuredBRDF,
    MeasuredSamples,
    as_samples,
    sample_albedos,
    spherical,
)
from jaxbrdf.cli import batch, factors, numerics, portrait, report, sources
from jaxbrdf.energy import albedo_by_quadrature
from jaxbrdf.resampling import Reflectance

_INCIDENCES = (0, 30, 60, 80)  # degrees, of the albedos of what is known in all directions
_COLUMNS = 6  # channels that stand side by side; of more, the first and the last


class ShowTask(batch.Task[Reflectance, dict[str, Any], dict[str, Any]]):
    """Look at what is in each file; writes nothing. The record is the JSON document about the file."""

    verb = "reading"

    def finished(self, path: Path) -> None:
        return None

    def read(self, path: Path) -> Reflectance:
        return sources.load(path)

    def process(self, inputs: Sequence[Reflectance]) -> Sequence[dict[str, Any]]:
        return [describe(reflectance) for reflectance in inputs]

    def save(self, path: Path, content: Reflectance, output: dict[str, Any]) -> dict[str, Any]:
        name = getattr(content, "name", "") or (str(path) if sources.is_published(path) else path.stem)
        return {"name": name, "source": str(path), "format": sources.format_name(path), **output}


class PictureTask(ShowTask):
    """The same, and the picture of the one file."""

    def __init__(self, plot: Path):
        self.plot = plot

    def save(self, path: Path, content: Reflectance, output: dict[str, Any]) -> dict[str, Any]:
        document = super().save(path, content, output)
        _write(self.plot, portrait.draw(content, document["name"]))
        return document


class FactorsTask(ShowTask):
    """The same, the factors that are read off the data and how near fits are; drawn if there is a `plot`."""

    verb = "fitting"

    def __init__(self, plot: Path | None):
        self.plot = plot

    def save(self, path: Path, content: Reflectance, output: dict[str, Any]) -> dict[str, Any]:
        document = super().save(path, content, output)
        found = factors.find(content)
        if self.plot is not None:
            _write(self.plot, factors.draw(found, document["name"]))
        return {**document, "factors": factors.document(found)}


def _write(plot: Path, figure: Figure) -> None:
    with replacing(plot) as scratch:
        figure.savefig(scratch, format=plot.suffix[1:].lower())


def run(
    files: Sequence[Path], as_json: bool = False, plot: Path | None = None, with_factors: bool = False
) -> int:
    """Describe every file on standard output, and return the exit status."""
    batch.writable_picture(plot, files)
    if plot is not None and len(files) > 1:
        raise batch.Refused(f"--plot {plot}: a picture shows one file; there are {len(files)}")
    numerics.prepare()
    outcome = batch.run(files, _task(plot, with_factors), Console(stderr=True), chunk=1)
    if as_json:
        failed = [{"name": p.stem, "source": str(p), "error": text} for p, text in outcome.errors.items()]
        print(report.to_json([*outcome.records.values(), *failed]))
    else:
        for document in outcome.records.values():
            _show(document)
    report.say_failures(outcome, len(files))
    return outcome.exit_status


def _task(plot: Path | None, with_factors: bool) -> ShowTask:
    if with_factors:
        return FactorsTask(plot)
    return ShowTask() if plot is None else PictureTask(plot)


# Describing


def describe(reflectance: Reflectance) -> dict[str, Any]:
    """What is in a reflectance, as plain numbers; each list with one number for each channel."""
    samples = as_samples(reflectance)
    wavelengths = sources.wavelengths(reflectance)
    return {
        "kind": sources.kind(reflectance),
        "channels": sources.channels(reflectance),
        "wavelengths_um": None if wavelengths is None else wavelengths.tolist(),
        "origin": list(getattr(reflectance, "origin", ())),
        "units": "1/sr",
        "directions": _directions(reflectance),
        **_angles(samples),
        **_range(samples),
        "invalid_share": _invalid_share(reflectance),
        **_albedos(reflectance),
    }


@singledispatch
def _directions(reflectance: Reflectance) -> str:
    """Where the reflectance is known, in words."""
    return "all: it is a formula; range and median are those of some 20,000 pairs"


@_directions.register
def _(samples: MeasuredSamples) -> str:
    incidences = np.unique(np.round(samples.theta_i, 4))
    return f"{len(samples.theta_i)} pairs at {len(incidences)} polar angles of incidence"


@_directions.register
def _(table: MeasuredBRDF) -> str:
    return f"{' × '.join(map(str, table.grid.shape))} cells over θ_h, θ_d and φ_d"


@_directions.register
def _(brdf: AdaptiveBRDF) -> str:
    P, T, K = brdf.luminance.shape[:3]
    azimuths = "isotropic" if brdf.is_isotropic else f"{P} azimuths"
    return f"{T} polar angles of incidence, {azimuths}; {K} × {K} outgoing directions each"


def _angles(samples: MeasuredSamples) -> dict[str, list[float]]:
    """The least and the largest polar angle, degrees."""
    return {
        f"{name}_deg": np.rad2deg([getattr(samples, name).min(), getattr(samples, name).max()]).tolist()
        for name in ("theta_i", "theta_o")
    }


def _range(samples: MeasuredSamples) -> dict[str, list[float]]:
    """The least, the middle and the largest of the valid samples, 1/sr; NaN where there is none."""
    columns = [column[valid] for column, valid in zip(samples.values.T, samples.valid.T, strict=True)]
    found = [np.percentile(column, (0, 50, 100)) if column.size else np.full(3, np.nan) for column in columns]
    return {name: [float(f[k]) for f in found] for k, name in enumerate(("min", "median", "max"))}


@singledispatch
def _invalid_share(reflectance: Reflectance) -> list[float] | None:
    """The share of what was measured that is negative or no number; None for a formula."""
    return None


@_invalid_share.register
def _(samples: MeasuredSamples) -> list[float] | None:
    return np.mean(~samples.valid, axis=0).tolist()


@_invalid_share.register
def _(table: MeasuredBRDF) -> list[float] | None:
    return table.missing_share.tolist()


@_invalid_share.register
def _(brdf: AdaptiveBRDF) -> list[float] | None:
    return np.mean(~(brdf.values >= 0), axis=(0, 1, 2, 3)).tolist()


@singledispatch
def _albedos(reflectance: Reflectance) -> dict[str, Any]:
    """Directional albedos by incidence, (incidences, channels); by quadrature, which may be too coarse."""
    brdf, wi = cast(AbstractBRDF, reflectance).anonymous, spherical(np.radians(_INCIDENCES), 0.0)
    found, resolved = (np.asarray(a).reshape(len(wi), -1) for a in albedo_by_quadrature(brdf, wi))
    return {
        "incidences_deg": list(_INCIDENCES),
        "albedo": found.tolist(),
        "albedo_is_coarse": (~resolved).tolist(),
    }


@_albedos.register
def _(samples: MeasuredSamples) -> dict[str, Any]:
    """Those of the samples, and the share of the hemisphere's projection that they cover."""
    found = sample_albedos(samples)
    return {
        "incidences_deg": np.rad2deg(found.theta_i).tolist(),
        "azimuths_deg": np.rad2deg(found.phi_i).tolist(),
        "albedo": found.albedo.tolist(),
        "covered_share": found.covered.tolist(),
    }


# Showing


def _show(document: dict[str, Any]) -> None:
    """A paragraph and a table on standard output."""
    console = report.wide_enough(Console())
    report.say(console, f"{document['source']}: {document['format']}, {document['kind']}", style="bold")
    for line in (*document["origin"], document["directions"], _limits(document)):
        report.say(console, f"  {line}")
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("")
    shown = _shown(len(document["channels"]))
    for c in shown:
        table.add_column(document["channels"][c] or "f", justify="right")
    for label, values, digits in _rows(document):
        table.add_row(Text(label), *(report.number(values[c], digits) for c in shown))
    console.print(table)
    if "factors" in document:
        factors.show(document["factors"])


def _limits(document: dict[str, Any]) -> str:
    (i0, i1), (o0, o1) = document["theta_i_deg"], document["theta_o_deg"]
    return f"θ_i from {i0:.4g} to {i1:.4g}°, θ_o from {o0:.4g} to {o1:.4g}°"


def _shown(count: int) -> Sequence[int]:
    """The channels that have a column."""
    return (
        range(count) if count <= _COLUMNS else [*range(_COLUMNS // 2), *range(count - _COLUMNS // 2, count)]
    )


def _rows(document: dict[str, Any]) -> list[tuple[str, list[float], str]]:
    rows = [(f"{name} f (1/sr)", document[name], ".4g") for name in ("min", "median", "max")]
    if document["invalid_share"] is not None:
        rows.append(("invalid", document["invalid_share"], ".2%"))
    labels = _albedo_labels(document)
    return rows + [(label, values, ".3f") for label, values in zip(labels, document["albedo"], strict=True)]


def _albedo_labels(document: dict[str, Any]) -> Iterator[str]:
    """What stands before each row of albedos, with what they leave out or how good they are."""
    covered = [f", over {share:.0%} of the hemisphere" for share in document.get("covered_share", ())]
    coarse = ["  (to a few %)" * any(channels) for channels in document.get("albedo_is_coarse", ())]
    for theta, note in zip(document["incidences_deg"], covered or coarse, strict=True):
        yield f"albedo at {theta:.4g}°{note}"
