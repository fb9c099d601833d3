"""Optical constants of metals: measured ones from a small table in optical/, or estimated from a colour."""

import csv
import difflib
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from data_loaders.colours import check_range, linear_srgb, smooth_reflectance
from jaxbrdf.fresnel import kappa_from_reflectance

_ELEMENTS = {
    "aluminium": "Al",
    "aluminum": "Al",
    "chromium": "Cr",
    "copper": "Cu",
    "gold": "Au",
    "iron": "Fe",
    "nickel": "Ni",
    "silver": "Ag",
}


class OpticalConstants(NamedTuple):
    """The index of refraction N = η + iκ: `Conductor(*constants)` is the Fresnel term of such a metal."""

    eta: np.ndarray
    kappa: np.ndarray


def optical_constants(name: str, wavelengths: ArrayLike | float | None = None) -> OpticalConstants:
    """η and κ of a metal at wavelengths in micrometres, in their shape; without them as R, G, B, each (3,).

    Metals: Ag, Al, Au, Cr, Cu, Fe, Ni, by symbol or English name, and stainless steel (austenitic). The table
    runs from 0.3 to 1 µm, linear in between; its header gives the sources.

    R, G, B are `linear_srgb` of η(λ) and κ(λ), white-balanced: they give the colour of the reflectance to .02
    at any angle, gold's (which lies outside sRGB) to .06. The triplets in common use, η of copper being
    (.200, .924, 1.102), are not balanced: a constant 1 would be (1.205, .948, .909) there.

    Raises ValueError for an unknown metal or a wavelength outside the table, and for R, G, B ImportError
    without the library colour-science.
    """
    table = _table()[_metal(name)]
    if wavelengths is None:
        return OpticalConstants(*(linear_srgb(table[0], spectrum) for spectrum in table[1:]))
    at = np.asarray(wavelengths, dtype=float)
    check_range(at, table[0], f"the table of {name}")
    return OpticalConstants(*(np.asarray(np.interp(at, table[0], spectrum)) for spectrum in table[1:]))


def conductor_from_colour(rgb: ArrayLike, wavelengths: ArrayLike | float) -> OpticalConstants:
    r"""η = 1 and κ(λ) of a metal of which only the colour at normal incidence is known.

        κ(λ) = √(4 R_0(λ) / (1 − R_0(λ))),   R_0 the smooth reflectance spectrum of the colour

    Linear sRGB (..., 3) and wavelengths (W,), µm, to arrays (..., W). Sun et al. 2002, section 5.2 and
    eq. 5.11; the spectrum is `smooth_reflectance`. Constants as R, G, B need no spectrum: η = 1 and
    `jaxbrdf.kappa_from_reflectance(rgb)`. Raises ValueError for a colour outside [0, 1] and for wavelengths
    outside 0.36 to 0.78 µm, ImportError without colour-science.
    """
    kappa = np.asarray(kappa_from_reflectance(smooth_reflectance(rgb, wavelengths)))
    return OpticalConstants(np.ones_like(kappa), kappa)


def _metal(name: str) -> str:
    """The table's name of a metal. Raises ValueError."""
    metals = list(_table())
    known = {metal.casefold(): metal for metal in metals} | _ELEMENTS
    if name.casefold() not in known:
        near = difflib.get_close_matches(name.casefold(), known)
        raise ValueError(
            f"no optical constants of {name!r}; "
            + (f"the nearest names are: {', '.join(near)}" if near else f"there are: {', '.join(metals)}")
        )
    return known[name.casefold()]


@cache
def _table() -> dict[str, np.ndarray]:
    """Wavelengths (µm), η and κ, (3, rows), of each metal; lines that begin with # are comments."""
    rows: dict[str, list[list[float]]] = {}
    with (Path(__file__).with_name("optical") / "metals.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(line for line in file if line[0] != "#"):
            numbers = [float(row[column]) for column in ("wavelength", "eta", "kappa")]
            rows.setdefault(row["metal"], []).append(numbers)
    return {metal: np.array(numbers).T for metal, numbers in rows.items()}
