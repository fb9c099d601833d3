"""`jaxbrdf texture`: surfaces of any size that vary as measured ones do."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from data_loaders import DataError, read_ndf_maps, write_ndf_maps
from data_loaders.files import replacing
from jaxbrdf import Ellipsoid, NDFMap, aligned_maps, ndf_texture, ndf_texture_of_strips
from jaxbrdf.cli import batch, map_pictures, numerics, report


@dataclass(frozen=True)
class Options:
    """What the command was asked for."""

    shape: tuple[int, int]
    seed: int = 0
    scan: str | None = None
    separable: bool = False
    correlated: bool = True
    marginals: bool = True

    def refuse_nonsense(self, files: Sequence[Path]) -> None:
        if min(self.shape) < 1:
            raise batch.Refused(f"--shape {self.shape[0]} {self.shape[1]}: expected two positive numbers")
        if len(files) > 2:
            raise batch.Refused(f"expected one file of maps, or two of strips; found {len(files)}")
        if len(files) == 2 and (self.scan or self.separable or not self.correlated or not self.marginals):
            raise batch.Refused(
                "--scan, --separable, --independent and --normal are for one file of maps: of two strips the "
                "texture is always separable, its channels independent, and their values normal"
            )

    def about(self, strips: bool) -> dict[str, str | float]:
        """What the file says of how the texture was made."""
        return {
            "seed": float(self.seed),
            "spectrum": "separable" if self.separable or strips else "full",
            "channels": "correlated" if self.correlated and not strips else "independent",
            "marginals": "those of the exemplar" if self.marginals and not strips else "normal",
        }


def run(
    files: Sequence[Path],
    out: Path | None,
    options: Options,
    *,
    as_json: bool = False,
    picture: bool = True,
    force: bool = False,
) -> int:
    """Synthesise a texture, write and draw it, say how it compares; returns the exit status."""
    options.refuse_nonsense(files)
    target = out or files[0].with_suffix(".texture.h5")
    _refuse_to_overwrite(target, files, force)
    numerics.prepare()
    try:
        exemplar, texture = _synthesised([read_ndf_maps(file) for file in files], options)
        target.parent.mkdir(parents=True, exist_ok=True)
        about = options.about(strips=len(files) == 2)
        write_ndf_maps(target, [texture], files, about)
        if picture and isinstance(exemplar.ndf, Ellipsoid):  # as all are that `patches` writes
            with replacing(target.with_suffix(".png")) as scratch:
                map_pictures.texture(exemplar, texture).savefig(scratch, format="png")
    except (DataError, ValueError, OSError) as error:
        raise batch.Refused(str(error)) from error
    _tell({"out": str(target), **about, **_document(exemplar, texture)}, as_json)
    return 0


def _refuse_to_overwrite(target: Path, files: Sequence[Path], force: bool) -> None:
    if target.suffix.lower() not in (".h5", ".hdf5"):
        raise batch.Refused(f"--out {target}: expected a name that ends in .h5")
    if target.resolve() in {file.resolve() for file in files}:
        raise batch.Refused(f"--out {target}: the result would overwrite an input; give it another name")
    if target.exists() and not force:
        raise batch.Refused(f"--out {target}: is there already; --force replaces it")
    batch.writable_folder(target.parent)


def _synthesised(sources: list[tuple[NDFMap, ...]], options: Options) -> tuple[NDFMap, NDFMap]:
    """The exemplar, of strips the first, and the texture."""
    key = jax.random.key(options.seed)
    if len(sources) == 2:
        count = len(sources[0])
        maps = aligned_maps([item for source in sources for item in source])
        return maps[0], ndf_texture_of_strips(key, maps[:count], maps[count:], options.shape)
    exemplar = _chosen(sources[0], options.scan)
    how = {"separable": options.separable, "correlated": options.correlated, "marginals": options.marginals}
    return exemplar, ndf_texture(key, exemplar, options.shape, **how)


def _chosen(maps: Sequence[NDFMap], scan: str | None) -> NDFMap:
    """The map of that name, or that of most patches."""
    if scan is None:
        return max(maps, key=lambda item: item.success.sum())
    named = [item for item in maps if item.name == scan]
    if not named:
        raise batch.Refused(f"--scan {scan}: expected one of {', '.join(item.name for item in maps)}")
    return named[0]


def _document(exemplar: NDFMap, texture: NDFMap) -> dict[str, Any]:
    return {
        "exemplar": {"name": exemplar.name, "shape": list(exemplar.shape)},
        "shape": list(texture.shape),
        "step": list(texture.step),
        "parameters": {
            name: {"exemplar": _statistics(exemplar, name), "texture": _statistics(texture, name)}
            for name in exemplar.names
        },
    }


def _statistics(item: NDFMap, name: str) -> dict[str, float]:
    """Mean, standard deviation, and how neighbours along x and y correlate."""
    image = np.where(item.success, np.asarray(getattr(item.ndf, name)), np.nan)
    z = image - np.nanmean(image)
    return {
        "mean": float(np.nanmean(image)),
        "std": float(np.nanstd(image)),
        "neighbours_x": _correlation(z[:, 1:], z[:, :-1]),
        "neighbours_y": _correlation(z[1:], z[:-1]),
    }


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    scale = np.sqrt(np.sum(a * a) * np.sum(b * b))
    return float(np.sum(a * b) / scale) if scale > 0 else float("nan")


def _tell(document: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(report.to_json(document))
        return
    console = report.wide_enough(Console())
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for name in ("parameter", "", "mean", "std", "neighbours along x", "along y"):
        table.add_column(name, justify="left" if name in ("parameter", "") else "right")
    for name, both in document["parameters"].items():
        for which, statistics in both.items():
            table.add_row(
                name if which == "exemplar" else "", which, *map(report.number, statistics.values())
            )
    console.print(table)
    report.say(console, f"written: {document['out']}")
