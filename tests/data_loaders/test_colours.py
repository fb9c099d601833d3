"""Measured spectra as colours: against colour-science's own integration, and what is left as it is."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from data_loaders import to_rgb
from data_loaders.colours import linear_srgb
from jaxbrdf import AdaptiveBRDF, HalfDifferenceGrid, Lambertian, MeasuredBRDF, MeasuredSamples

with np.printoptions():  # its import sets how numpy prints, for all tests that follow
    import colour

NM = np.arange(400, 701, 10)  # as Cornell measures
WAVELENGTHS = NM / 1000
SHUFFLED = np.random.default_rng(1).permutation(len(NM))
SPECTRA = np.stack(
    [
        np.full(len(NM), 0.4),
        0.1 + 0.8 / (1 + np.exp(-(NM - 560) / 20)),  # orange
        0.2 + 0.3 * np.exp(-(((NM - 470) / 60) ** 2)),  # blue
        0.3 + 0.1 * np.sin(NM / 25.0),
    ]
)


def by_colour_science(spectrum):
    """Its sRGB under D65 and the 1931 observer, at 1 nm; outside 400 to 700 nm the spectrum goes on level."""
    shape = colour.SpectralShape(360, 780, 1)
    values = np.interp(np.arange(360, 781), NM, spectrum)
    XYZ = colour.sd_to_XYZ(
        colour.SpectralDistribution(values, np.arange(360, 781)),
        colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape),
        colour.SDS_ILLUMINANTS["D65"].copy().align(shape),
        method="Integration",
    )
    return colour.XYZ_to_RGB(XYZ / 100, "sRGB", apply_cctf_encoding=False)


EXPECTED = np.stack([by_colour_science(spectrum) for spectrum in SPECTRA])


def samples(values, wavelengths=None):
    angles = np.linspace(0.1, 1.2, len(values))
    return MeasuredSamples(
        angles, angles, angles, angles, values, np.ones(len(values)), wavelengths, "paint", ("by hand",)
    )


def table(values, wavelengths=None, scale=1.0):
    """A table of one θ_h and θ_d and a φ_d for each row."""
    rows, channels = values.shape
    phi = np.pi * (np.arange(rows + 1.0) / rows)
    middle, edges = np.array([0.2]), np.array([0.0, 0.4])
    grid = HalfDifferenceGrid(middle, middle, (phi[1:] + phi[:-1]) / 2, edges, edges, phi)
    raw = values[None, None] / scale
    return MeasuredBRDF(raw, np.full(channels, scale), grid, "paint", wavelengths, ("by hand",))


def adaptive(values, wavelengths=None):
    """Adaptive tables of 2 × 2 nodes, at as many incidences as there are rows."""
    T, C = values.shape
    ones = np.ones((1, T, 2, 2), np.float32)
    return AdaptiveBRDF(
        theta_i=np.linspace(0, 1.5, T, dtype=np.float32),
        phi_i=np.zeros(1, np.float32),
        ndf=np.ones((2, 2), np.float32),
        sigma=np.ones((2, 2), np.float32),
        vndf=ones,
        luminance=ones,
        values=np.broadcast_to(values[None, :, None, None], (1, T, 2, 2, C)).astype(np.float32),
        wavelengths=wavelengths,
        name="paint",
        origin=("by hand",),
    )


def rows(record):
    """The values of `samples`, `table` or `adaptive`, a row each."""
    values = np.asarray(record.values, float)
    if isinstance(record, MeasuredSamples):
        return values
    return values[0, 0] if isinstance(record, MeasuredBRDF) else values[0, :, 1, 1]


every_kind = pytest.mark.parametrize("record", [samples, table, adaptive])


@every_kind
def test_spectra_become_the_colours_of_colour_science(record):
    found = to_rgb(record(SPECTRA, WAVELENGTHS))
    assert_allclose(rows(found), EXPECTED, atol=1e-3)
    assert found.wavelengths is None
    assert (found.name, found.origin) == ("paint", ("by hand",))
    assert type(found) is type(record(SPECTRA))


@every_kind
def test_wavelengths_may_come_in_any_order(record):
    found = to_rgb(record(SPECTRA[:, SHUFFLED], WAVELENGTHS[SHUFFLED]))
    assert_allclose(rows(found), EXPECTED, atol=1e-3)


@every_kind
def test_flat_spectra_are_grey_and_grey_is_three_alike(record):
    level = np.array([[0.7], [0.0], [0.2]])
    for found in (to_rgb(record(np.repeat(level, 31, axis=1), WAVELENGTHS)), to_rgb(record(level))):
        assert_allclose(rows(found), np.repeat(level, 3, axis=1), rtol=1e-6, atol=1e-15)


def test_the_same_as_linear_srgb_and_of_one_wavelength_grey():
    for wavelengths, spectra in ((WAVELENGTHS, SPECTRA), (np.array([0.55]), SPECTRA[:, :1])):
        expected = [linear_srgb(wavelengths, spectrum) for spectrum in spectra]
        assert_allclose(to_rgb(samples(spectra, wavelengths)).values, expected, rtol=1e-13)
    assert_allclose(expected, np.repeat(SPECTRA[:, :1], 3, axis=1), rtol=1e-13)


def test_the_scale_of_a_table_is_kept():
    found = to_rgb(table(SPECTRA, WAVELENGTHS, scale=1 / 1500))
    assert_allclose(found.raw[0, 0] * found.scale, EXPECTED, atol=1e-3)


@pytest.mark.parametrize("missing", [-1.0, np.nan])
@pytest.mark.parametrize("record", [samples, table])
def test_what_lacks_a_wavelength_has_no_colour(record, missing):
    holed = SPECTRA.copy()
    holed[1, 7] = missing
    found = to_rgb(record(holed, WAVELENGTHS))
    stored = found.raw[0, 0] if record is table else found.values
    valid = found.valid if record is samples else np.isfinite(rows(found))
    assert_array_equal(valid, np.arange(4)[:, None] != [1, 1, 1])
    assert np.isfinite(stored).all()
    assert_allclose(rows(found)[[0, 2, 3]], EXPECTED[[0, 2, 3]], atol=1e-3)


def test_a_channel_outside_srgb_is_not_valid():
    """Light of 500 nm alone has less than no red."""
    line = np.exp(-(((NM - 500) / 10) ** 2))[None]
    assert by_colour_science(line[0])[0] < -0.02
    assert_array_equal(to_rgb(samples(line, WAVELENGTHS)).valid, [[False, True, True]])
    assert_array_equal(np.isfinite(to_rgb(table(line, WAVELENGTHS)).values[0, 0]), [[False, True, True]])


@every_kind
def test_colours_are_left_as_they_are_and_unknown_channels_refused(record):
    colours = record(SPECTRA[:, :3])
    assert to_rgb(colours) is colours
    with pytest.raises(ValueError, match="5 channels have no wavelengths: set `wavelengths`"):
        to_rgb(record(SPECTRA[:, :5]))


@every_kind
def test_three_wavelengths_are_no_colours(record):
    """Blue, green and red light, in this order: the first belongs to B."""
    found = rows(to_rgb(record(np.array([[0.9, 0.1, 0.1]]), np.array([0.465, 0.525, 0.63]))))[0]
    assert found[2] > 0.5 > found[0]


def test_a_model_is_left_as_it_is():
    model = Lambertian(np.full(5, 0.5))
    assert to_rgb(model) is model


def test_grey_needs_no_library(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "colour", None)
    assert to_rgb(samples(SPECTRA[:, :1])).values.shape == (4, 3)
    with pytest.raises(ImportError, match="jaxbrdf\\[colour\\]"):
        to_rgb(replace(samples(SPECTRA), wavelengths=WAVELENGTHS))
