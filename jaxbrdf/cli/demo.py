"""The work of `jaxbrdf demo`: `jaxbrdf fit` on stand-ins for measurements, made on the spot."""

import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console

from data_loaders import published, write_merl
from jaxbrdf import MeasuredBRDF, merl_grid
from jaxbrdf.cli import fit, numerics, report
from jaxbrdf.metrics import tabulate

NOTE = "stand-in made from the ABC model parameters published by Löw et al. 2012; not a measurement"

MATERIALS = ("nickel", "red-plastic", "blue-rubber")  # a metal, a plastic, something nearly diffuse


def run(out: Path) -> int:
    """Fit the stand-ins into the folder `out`, say what they are and what to try next; the exit status."""
    numerics.prepare()
    console = Console(stderr=True)
    report.say(console, f"{len(MATERIALS)} materials, each a {NOTE}", style="bold")
    with tempfile.TemporaryDirectory() as folder:
        files = [write_stand_in(material, Path(folder)) for material in MATERIALS]
        status = fit.run(files, fit.FitTask(out, "shifted-gamma", "slices+linear", force=True, note=NOTE))
    if status == 0:
        report.say(console, "pictures: " + ", ".join(str(out / f"{file.stem}.png") for file in files))
        report.say(console, "next, with a file of your own: jaxbrdf fit my-material.binary --out fits")
    return status


def write_stand_in(material: str, folder: Path) -> Path:
    """Write FOLDER/abc-MATERIAL.binary, a table in MERL's layout; returns its path."""
    path = folder / f"abc-{material}.binary"
    write_merl(path, stand_in(material))
    return path


def stand_in(material: str) -> MeasuredBRDF:
    """The ABC model of one MERL material as if measured: −1 below the horizon, as in real files."""
    grid = merl_grid()
    cos_i, cos_o = (np.asarray(cosine) for cosine in grid.cosines())
    above = (cos_i > 0) & (cos_o > 0)
    table = np.asarray(tabulate(published("abc", material), grid))
    raw = np.where(above[..., None], table, -1.0)
    return MeasuredBRDF(raw, np.ones(3), grid, f"abc-{material}")
