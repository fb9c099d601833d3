"""The work of `jaxbrdf demo`: `jaxbrdf fit` on stand-ins for measurements, made on the spot."""

import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console

from data_loaders import published, write_merl
from jaxbrdf import MeasuredBRDF, merl_grid
from jaxbrdf.cli import fit, report

NOTE = "stand-in made from the ABC model parameters published by Löw et al. 2012; not a measurement"

MATERIALS = ("nickel", "red-plastic", "blue-rubber")  # a metal, a plastic, something nearly diffuse


def run(out: Path) -> int:
    """Fit the stand-ins into the folder `out`, say what they are and what to try next; the exit status."""
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
    cos_h = np.broadcast_to(np.cos(grid.theta_h)[:, None, None], grid.shape)
    cos_d = np.broadcast_to(np.cos(grid.theta_d)[None, :, None], grid.shape)
    raw = np.full((*grid.shape, 3), -1.0)
    raw[above] = _abc(material, cos_i[above], cos_o[above], cos_h[above], cos_d[above])
    return MeasuredBRDF(raw, np.ones(3), grid, f"abc-{material}")


def _abc(
    material: str, cos_i: np.ndarray, cos_o: np.ndarray, cos_h: np.ndarray, cos_d: np.ndarray
) -> np.ndarray:
    r"""The ABC model of Löw et al. 2012 with its published parameters, (N,) cosines to (N, 3) in 1/sr:

        f = k_D / π + F(θ_d) G S(h) / (π cos θ_i cos θ_o),   S(h) = A / (1 + B (1 − cos θ_h))^C

    F is Fresnel's term of a dielectric of index `ior`, G that of V-cavities. The factors 1/π are not
    stated with the numbers: of the plausible ones (1, 1/π, 1/4, 1/4π for the lobe, 1 and 1/π for k_D)
    these come nearest to the 100 reconstructed MERL materials, in median log error.
    """
    abc = published("abc", material)
    S = 1 / (1 + abc["B"] * (1 - cos_h)) ** abc["C"]
    G = np.minimum(1, 2 * cos_h * np.minimum(cos_i, cos_o) / cos_d)
    lobe = _dielectric(cos_d, abc["ior"]) * G * S / (cos_i * cos_o)
    return (abc["kD"] + abc["A"] * lobe[:, None]) / np.pi


def _dielectric(cos_d: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Unpolarised reflectance of a smooth dielectric: Fresnel's two amplitudes, squared and averaged."""
    cos_t = np.sqrt(1 - (1 - cos_d**2) / index**2)
    across = (cos_d - index * cos_t) / (cos_d + index * cos_t)
    along = (index * cos_d - cos_t) / (index * cos_d + cos_t)
    return (across**2 + along**2) / 2
