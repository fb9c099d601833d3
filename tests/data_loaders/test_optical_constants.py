"""The table of metals against its sources and known mirrors; spectra to colours and back."""

import csv
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from data_loaders.colours import linear_srgb, smooth_reflectance
from data_loaders.optical_constants import conductor_from_colour, optical_constants
from jaxbrdf.fresnel import Conductor

SOURCES = {
    "Ag": ("Ag", "Johnson"),
    "Al": ("Al", "Rakic"),
    "Au": ("Au", "Johnson"),
    "Cr": ("Cr", "Johnson"),
    "Cu": ("Cu", "Johnson"),
    "Fe": ("Fe", "Johnson"),
    "Ni": ("Ni", "Johnson"),
    "stainless steel": ("StainlessSteel", "Karlsson-austenitic"),
}
VISIBLE = np.linspace(0.36, 0.78, 211)


def reflectance(eta, kappa, c):
    N = eta + 1j * kappa
    u = np.sqrt(N**2 - 1 + c**2)
    return (abs((c - u) / (c + u)) ** 2 + abs((N**2 * c - u) / (N**2 * c + u)) ** 2) / 2


@pytest.mark.parametrize("metal", SOURCES)
def test_the_table_holds_its_sources_rows(metal, shared_data):
    with (shared_data / "optical" / "metals_nk_long.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if (row["element"], row["source"]) == SOURCES[metal]]
    nk = np.array([[float(row[name]) for name in ("wavelength_nm", "n", "k")] for row in rows])
    nk = nk[(nk[:, 0] >= 300) & (nk[:, 0] <= 1000)]
    assert len(nk) > 15
    assert_allclose(np.stack(optical_constants(metal, nk[:, 0] / 1000), axis=1), nk[:, 1:], rtol=1e-13)


@pytest.mark.parametrize("metal", SOURCES)
def test_the_table_covers_the_visible_with_a_margin(metal):
    eta, kappa = optical_constants(metal, [0.3, 1.0])
    assert np.all(eta > 0)
    assert np.all(kappa > 0)


def test_between_its_rows_the_table_is_linear():
    """Copper at 0.5821 and 0.6168 µm in Johnson & Christy 1972: 0.70 + 2.704i and 0.30 + 3.205i."""
    eta, kappa = optical_constants("Cu", [[0.5821], [0.59945], [0.6168]])
    assert eta.shape == kappa.shape == (3, 1)
    assert_allclose(eta.ravel(), [0.7, 0.5, 0.3], rtol=1e-12)
    assert_allclose(kappa.ravel(), [2.704, 2.9545, 3.205], rtol=1e-12)
    assert optical_constants("Cu", 0.6).eta.shape == ()


@pytest.mark.parametrize(
    ("name", "symbol"),
    [("copper", "Cu"), ("CU", "Cu"), ("Aluminum", "Al"), ("aluminium", "Al"), ("iron", "Fe")],
)
def test_names_and_symbols_are_the_same(name, symbol):
    assert_array_equal(optical_constants(name, 0.55), optical_constants(symbol, 0.55))


# Fresh evaporated mirrors at 0.45, 0.55, 0.65 and 0.70 µm: G. Hass, American Institute of Physics Handbook.
MIRRORS = {
    "Al": [0.922, 0.916, 0.905, 0.897],
    "Ag": [0.966, 0.979, 0.983, 0.985],
    "Au": [0.387, 0.817, 0.955, 0.970],
    "Cu": [0.552, 0.669, 0.966, 0.975],
}


@pytest.mark.parametrize("metal", MIRRORS)
def test_mirrors_reflect_what_handbooks_say(metal):
    F = Conductor(*optical_constants(metal, [0.45, 0.55, 0.65, 0.70]))(1.0)
    assert_allclose(F, MIRRORS[metal], atol=0.002 if metal == "Al" else 0.05)


# Base colours in linear sRGB as physicallybased.info gives them.
BASE_COLOURS = {
    "aluminium": (0.92, 0.92, 0.92),
    "silver": (0.99, 0.98, 0.97),
    "copper": (0.93, 0.62, 0.52),
    "iron": (0.53, 0.51, 0.49),
    "nickel": (0.70, 0.64, 0.56),
    "stainless steel": (0.67, 0.64, 0.60),
}


@pytest.mark.parametrize("metal", BASE_COLOURS)
def test_red_green_and_blue_constants_give_the_metals_colour(metal):
    assert_allclose(Conductor(*optical_constants(metal))(1.0), BASE_COLOURS[metal], atol=0.015)


@pytest.mark.parametrize("metal", SOURCES)
def test_red_green_and_blue_reflect_like_the_spectrum(metal):
    """The deviations that the docstring states: the colour of R(λ) against R of the colours of η and κ."""
    eta, kappa = optical_constants(metal)
    assert eta.shape == kappa.shape == (3,)
    assert np.all(eta > 0)
    assert np.all(kappa > 0)
    spectra = optical_constants(metal, VISIBLE)
    for c in (0.05, 0.2, 0.5, 1.0):
        true = linear_srgb(VISIBLE, reflectance(*spectra, c))
        assert_allclose(reflectance(eta, kappa, c), true, atol=0.06 if metal == "Au" else 0.02)


def test_numpy_prints_as_before():
    code = (
        "import numpy as np; before = np.get_printoptions()\n"
        "from data_loaders.colours import linear_srgb; linear_srgb([0.3, 1.0], [1.0, 1.0])\n"
        "assert np.get_printoptions() == before"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def test_a_constant_spectrum_is_grey():
    assert_allclose(linear_srgb([0.3, 1.0], [0.7, 0.7]), 0.7, rtol=1e-14)


def test_colours_are_those_of_the_librarys_own_integration():
    import colour

    nm = np.arange(360, 781)
    eta = optical_constants("Cu", nm / 1000).eta
    spectrum = colour.SpectralDistribution(dict(zip(nm, eta, strict=True)))
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(spectrum.shape)
    daylight = colour.SDS_ILLUMINANTS["D65"].copy().align(spectrum.shape)
    XYZ = colour.sd_to_XYZ(spectrum, observer, daylight, method="Integration") / 100
    assert_allclose(
        linear_srgb(nm / 1000, eta), colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB @ XYZ, atol=1e-3
    )


COPPER, GOLD, BLACK, WHITE, BLUE = (0.93, 0.62, 0.52), (1, 0.78, 0.34), (0, 0, 0), (1, 1, 1), (0.02, 0.1, 0.9)
COLOURS = np.array([COPPER, GOLD, BLACK, WHITE, BLUE])


@pytest.fixture(scope="module")
def spectra():
    return smooth_reflectance(COLOURS, VISIBLE)


def test_the_spectrum_of_a_colour_has_that_colour(spectra):
    assert spectra.shape == (5, 211)
    assert_allclose([linear_srgb(VISIBLE, R) for R in spectra], COLOURS, atol=2e-3)


def test_the_spectrum_of_a_colour_is_a_smooth_share(spectra):
    assert spectra.min() > 0
    assert spectra.max() < 1
    assert np.abs(np.diff(spectra[:2])).max() < 0.02  # from one 2 nm to the next


def test_a_metal_known_by_its_colour_reflects_that_colours_spectrum(spectra):
    eta, kappa = conductor_from_colour(COLOURS[:2], VISIBLE[::30])
    assert kappa.shape == eta.shape == (2, 8)
    assert_allclose(reflectance(eta, kappa, 1.0), spectra[:2, ::30], rtol=1e-12)
    assert conductor_from_colour(COLOURS[0], 0.55).kappa.shape == ()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: optical_constants("coper"), "'coper'; the nearest names are: copper"),
        (lambda: optical_constants("unobtainium-7"), "there are: Ag, Al, Au"),
        (
            lambda: optical_constants("Cu", 550.0),
            "wavelengths are in micrometres, and the table of Cu runs from",
        ),
        (lambda: optical_constants("Cu", [0.5, np.nan]), "wavelengths are in micrometres"),
        (lambda: conductor_from_colour([0.9, 1.1, 0.5], 0.5), r"every channel in \[0, 1\]"),
        (lambda: conductor_from_colour([0.9, np.nan, 0.5], 0.5), r"every channel in \[0, 1\]"),
        (lambda: conductor_from_colour([0.9, 0.5], 0.5), r"shape \(\.\.\., 3\)"),
        (
            lambda: conductor_from_colour([0.9, 0.6, 0.5], [0.5, 0.9]),
            "from 0.36 to 0.78 µm; found 0.5 to 0.9",
        ),
    ],
)
def test_misuse_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    "call", [lambda: optical_constants("Cu"), lambda: conductor_from_colour([0.9, 0.6, 0.5], 0.5)]
)
def test_without_the_library_of_colours_the_message_says_what_to_install(call, monkeypatch):
    monkeypatch.setitem(sys.modules, "colour", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxbrdf\[colour\]'"):
        call()
    assert optical_constants("Cu", 0.55).eta > 0
