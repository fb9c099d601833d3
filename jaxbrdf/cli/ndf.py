"""`jaxbrdf ndf`: the distribution of normals of measured height maps, with models fitted to it."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from data_loaders import DataError, write_ndf
from data_loaders.files import replacing
from fitting import fit_ndf
from jaxbrdf import (
    AbstractNDF,
    Beckmann,
    Ellipsoid,
    FitResult,
    FitStatus,
    Heightfield,
    TabulatedNDF,
    TrowbridgeReitz,
    default_sigma,
    kirchhoff_ndf,
)
from jaxbrdf.cli import batch, ndf_pictures, numerics, report, scans
from jaxbrdf.ndf.tabulated import cell_area, disk_cells
from jaxbrdf.surface.kirchhoff import COHERENT_PATCH
from jaxbrdf.surface.normals import NormalCounts, facet_cells, filtered_cells

# How a distribution is made of maps that come one by one


class Method(ABC):
    """Takes maps in, one by one, and gives their distribution."""

    @abstractmethod
    def add(self, heightfield: Heightfield) -> dict[str, Any]:
        """Takes in one more map; returns what is to be said of it."""

    @abstractmethod
    def ndf(self) -> TabulatedNDF:
        """The distribution of all maps. Raises ValueError where there is none."""

    def about(self) -> dict[str, float]:
        """The numbers that it worked with."""
        return {}


class Facets(Method):
    """`facet_ndf` of all."""

    def __init__(self, size: int):
        self._counts = NormalCounts(facet_cells, size)

    def add(self, heightfield: Heightfield) -> dict[str, Any]:
        return {"normals": self._counts.add(heightfield)}

    def ndf(self) -> TabulatedNDF:
        return self._counts.ndf()


class Filtered(Method):
    """`filtered_ndf` of all, each with its own default sigma unless one is given."""

    def __init__(self, size: int, sigma: float | None):
        self._sigma, self._sigmas = sigma, set[float]()
        self._counts = NormalCounts(partial(filtered_cells, sigma=sigma), size)

    def add(self, heightfield: Heightfield) -> dict[str, Any]:
        sigma = default_sigma(heightfield) if self._sigma is None else self._sigma
        count = self._counts.add(heightfield)
        self._sigmas.add(sigma)
        return {"normals": count, "sigma": sigma}

    def ndf(self) -> TabulatedNDF:
        return self._counts.ndf()

    def about(self) -> dict[str, float]:
        """Of several sigmas each scan has its own in the document."""
        return {"sigma": min(self._sigmas)} if len(self._sigmas) == 1 else {}


class Kirchhoff(Method):
    """The mean of `kirchhoff_ndf`, by measured area."""

    def __init__(self, size: int, wavelength: float, patch: float):
        self._about = {"wavelength": wavelength, "patch": patch}
        self._estimate = partial(kirchhoff_ndf, wavelength=wavelength, patch=patch, size=size)
        self._total, self._area = np.zeros((size, size)), 0.0

    def add(self, heightfield: Heightfield) -> dict[str, Any]:
        area = float(jnp.sum(heightfield.valid)) * heightfield.dx * heightfield.dy
        self._total += area * np.asarray(self._estimate(heightfield).values)
        self._area += area
        return {"area": area}

    def ndf(self) -> TabulatedNDF:
        return TabulatedNDF(jnp.asarray(self._total / self._area))

    def about(self) -> dict[str, float]:
        return self._about


@dataclass(frozen=True)
class Options:
    """What the command was asked for."""

    method: str = "filtered"
    sigma: float | None = None
    wavelength: float = 0.555
    patch: float = COHERENT_PATCH
    size: int = 1025
    treatment: scans.Treatment = field(default_factory=scans.Treatment)

    def start(self) -> Method:
        methods = {
            "facet": lambda: Facets(self.size),
            "filtered": lambda: Filtered(self.size, self.sigma),
            "kirchhoff": lambda: Kirchhoff(self.size, self.wavelength, self.patch),
        }
        if self.method not in methods:
            raise batch.Refused(f"--method {self.method}: expected one of {', '.join(methods)}")
        return methods[self.method]()

    def about(self) -> dict[str, str]:
        """What the file says of how its scans were treated."""
        return {"method": self.method, **self.treatment.about()}


def run(
    paths: Sequence[Path],
    out: Path,
    options: Options = Options(),
    *,
    as_json: bool = False,
    picture: bool = True,
    force: bool = False,
) -> int:
    """Make one distribution of all scans, write and draw it, fit models to it; returns the exit status."""
    files = _refuse_nonsense(paths, out, options, force)
    numerics.prepare()
    method = options.start()
    outcome = batch.each(files, partial(_take_in, method, options), "reading", Console(stderr=True))
    if outcome.records and not outcome.interrupted:
        try:
            document = _finish(method, list(outcome.records.values()), out, options, picture)
        except (DataError, ValueError, OSError) as error:
            raise batch.Refused(str(error)) from error
        _tell(document, outcome, as_json)
    report.say_failures(outcome, len(files))
    return outcome.exit_status


def _refuse_nonsense(paths: Sequence[Path], out: Path, options: Options, force: bool) -> list[Path]:
    """The files of all scans."""
    options.treatment.refuse_nonsense()
    if options.size < 3 or options.size % 2 == 0:
        raise batch.Refused(
            f"--size {options.size}: expected an odd number of cells, so that one is the normal's"
        )
    files = scans.inputs(paths, out)
    if out.exists() and not force:
        raise batch.Refused(f"--out {out}: is there already; --force replaces it")
    return files


def _take_in(method: Method, options: Options, path: Path) -> dict[str, Any]:
    """Adds a scan to the distribution; what is to be said of the scan."""
    prepared = options.treatment.read(path)
    return scans.described(path, prepared) | method.add(prepared)


def _finish(method: Method, taken: list[dict], out: Path, options: Options, picture: bool) -> dict[str, Any]:
    """Writes the table and its picture; the document that says what they show."""
    ndf = method.ndf()
    about: dict[str, str | float] = {**options.about(), **method.about()}
    out.parent.mkdir(parents=True, exist_ok=True)
    fits = {name: fit_ndf(model, ndf) for name, model in _models().items()}
    write_ndf(out, ndf, [scan["source"] for scan in taken], about | {"scans": float(len(taken))})
    document = {
        "out": str(out),
        **about,
        "scans": taken,
        **_slopes(ndf),
        "fits": [_fit_in_words(name, fit) for name, fit in fits.items()],
    }
    if picture:
        with replacing(out.with_suffix(".png")) as scratch:
            title = f"{taken[0]['name']}{f' and {len(taken) - 1} more' if len(taken) > 1 else ''}"
            ndf_pictures.overview(ndf, fits, f"{title}, {options.method}").savefig(scratch, format="png")
    return document


def _models() -> dict[str, AbstractNDF]:
    """What is fitted, from anywhere; made after the precision is chosen."""
    rough, none = jnp.array(0.2), jnp.array(0.0)
    return {
        "ellipsoid": Ellipsoid(rough, rough, none, none, none),
        "GGX": TrowbridgeReitz(rough, rough),
        "Beckmann": Beckmann(rough, rough),
    }


def _slopes(ndf: TabulatedNDF) -> dict[str, Any]:
    """∫ D cos θ, which is 1 but for Kirchhoff, and the rms slopes of the distribution along x, y and both."""
    m_x, m_y, m_z = disk_cells(ndf.values.shape[0], ndf.extent)
    share = np.where(m_z > 0, np.asarray(ndf.values) * cell_area(len(m_z), ndf.extent), 0)
    safe = np.where(m_z > 0, m_z, 1)
    x, y = (float(np.sqrt(np.sum(share * (m / safe) ** 2) / share.sum())) for m in (m_x, m_y))
    return {"integral": float(share.sum()), "rms_slope": [x, y], "Sdq": float(np.hypot(x, y))}


def _fit_in_words(name: str, fit: FitResult) -> dict[str, Any]:
    """The parameters of a fit, and √(∫(D − T)² / ∫T²) over the disk."""
    values = {parameter: float(getattr(fit.model, parameter)) for parameter in fit.parameters}
    errors = np.sqrt(np.diagonal(fit.covariance))
    return {
        "model": name,
        "parameters": values,
        "standard_errors": dict(zip(fit.parameters, errors.tolist(), strict=True)),
        "relative_l2": float(np.sqrt(fit.cost / 50)),
        "status": FitStatus(int(fit.status)).name.lower(),
    }


def _tell(document: dict[str, Any], outcome: batch.Report, as_json: bool) -> None:
    if as_json:
        failed = [{"source": str(path), "error": text} for path, text in outcome.errors.items()]
        print(report.to_json({**document, "failed": failed}))
        return
    console = report.wide_enough(Console())
    console.print(_scan_table(document["scans"]))
    x, y = document["rms_slope"]
    report.say(
        console,
        f"rms slope {document['Sdq']:.4g} (x {x:.4g}, y {y:.4g}), ∫ D cos θ = {document['integral']:.4f}",
    )
    console.print(_fit_table(document["fits"]))
    report.say(console, f"written: {document['out']}")


def _scan_table(taken: Sequence[dict[str, Any]]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("scan", overflow="fold")
    for name in ("points", "pixel, µm", "missing", "Sq, µm", "sigma, µm"):
        table.add_column(name, justify="right", no_wrap=True)
    for scan in taken:
        shape = " × ".join(str(n) for n in reversed(scan["shape"]))
        pixel = " × ".join(f"{size:.4g}" for size in scan["pixel"])
        numbers = f"{100 * scan['missing']:.2f} %", f"{scan['Sq']:.4g}", report.number(scan.get("sigma"))
        table.add_row(Text(report.printable(scan["name"])), shape, pixel, *numbers)
    return table


def _fit_table(fits: Sequence[dict[str, Any]]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for name in ("fit", "parameters", "relative L2", "status"):
        table.add_column(name)
    for fit in fits:
        values = ", ".join(
            f"{name} {value:.4g} ± {fit['standard_errors'][name]:.1g}"
            for name, value in fit["parameters"].items()
        )
        table.add_row(fit["model"], values, f"{fit['relative_l2']:.3g}", fit["status"].replace("_", " "))
    return table
