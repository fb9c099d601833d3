"""Between spectra and colours, by the library colour-science, an optional extra of the package.

Colours are linear sRGB (..., 3), spectra run over wavelengths in micrometres. The white of sRGB is the
daylight D65: a spectrum that is the same at all wavelengths is grey.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from jaxbrdf import AdaptiveBRDF, MeasuredBRDF
from jaxbrdf.resampling import Measurement, Reflectance

_VISIBLE = np.arange(360, 781) / 1000  # µm; what is seen outside is less than 1e-4 of the whole


def linear_srgb(wavelengths: ArrayLike, spectrum: ArrayLike) -> np.ndarray:
    r"""The colour, (3,), of a spectrum s (W,) sampled at ascending wavelengths (W,), µm; linear in between.

        RGB = M ∫ s(λ) D65(λ) (x̄, ȳ, z̄)(λ) dλ / the same with s = 1     (channel by channel)

    M takes XYZ to linear sRGB (IEC 61966-2-1), (x̄, ȳ, z̄) is the CIE 1931 observer. Saturated spectra lie
    outside sRGB, with a negative channel or one above that of the brightest wavelength; nothing is clipped.
    Raises ImportError without colour-science.
    """
    return np.asarray(spectrum, dtype=float) @ _to_srgb(np.asarray(wavelengths, dtype=float))


def to_rgb(reflectance: Reflectance) -> Reflectance:
    """A measurement with the channels R, G and B, linear: of spectra by `linear_srgb`, of grey three alike.

    One that has them already is left as it is, and so is a model. A sample, or a cell of a table, that is not
    valid at all wavelengths becomes invalid, −1; where a colour is so saturated that a channel is negative,
    that channel counts as invalid. Raises ValueError for other channels without wavelengths, ImportError
    without colour-science.
    """
    if not isinstance(reflectance, Measurement):
        return reflectance
    values, wavelengths = reflectance.values, reflectance.wavelengths
    channels = values.shape[-1]
    if wavelengths is None and channels == 3:
        return reflectance
    if wavelengths is None and channels != 1:
        raise ValueError(
            f"colours are made of spectra; these {channels} channels have no wavelengths: set `wavelengths`, "
            "(C,) in micrometres"
        )
    if not isinstance(reflectance, AdaptiveBRDF):  # whose values may all be used
        values = np.where(values >= 0, values, np.nan)
    rgb = (values @ (np.ones((1, 3)) if wavelengths is None else _to_srgb(wavelengths))).astype(values.dtype)
    rgb[~np.isfinite(rgb)] = -1
    if isinstance(reflectance, MeasuredBRDF):
        return replace(reflectance, raw=rgb, scale=np.ones(3), wavelengths=None)
    return replace(reflectance, values=rgb, wavelengths=None)


def _to_srgb(wavelengths: np.ndarray) -> np.ndarray:
    """(W, 3): what a spectrum sampled at wavelengths in any order, linear between them, is multiplied by."""
    order, weights = np.argsort(wavelengths), _srgb_weights()
    hats = [np.interp(_VISIBLE, wavelengths[order], one) for one in np.eye(len(order))]
    matrix = np.empty((len(order), 3))
    matrix[order] = np.array(hats) @ weights / weights.sum(axis=0)
    return matrix


def smooth_reflectance(rgb: ArrayLike, wavelengths: ArrayLike | float) -> np.ndarray:
    r"""A smooth reflectance spectrum of a given colour, (..., 3) and (W,) to (..., W), within (0, 1).

        R(λ) = ½ + U / (2 √(1 + U²)),   U = c_0 λ² + c_1 λ + c_2

    Jakob & Hanika 2019, "A low-dimensional function space for efficient spectral upsampling"; colour-science
    finds the c. `linear_srgb` of R is the colour again, to 2e-3. Takes about .3 s a colour. Raises ValueError
    for a colour outside [0, 1] or a wavelength outside 0.36 to 0.78 µm, ImportError without colour-science.
    """
    rgb, wavelengths = np.asarray(rgb, dtype=float), np.asarray(wavelengths, dtype=float)
    if rgb.shape[-1:] != (3,) or not np.all((rgb >= 0) & (rgb <= 1)):
        raise ValueError(
            "expected colours in linear sRGB, shape (..., 3), every channel in [0, 1] (bytes over 255, their "
            f"gamma undone); found {rgb}"
        )
    check_range(wavelengths, _VISIBLE, "the spectrum of a colour")
    nm = 1000 * wavelengths
    U = np.tensordot(np.apply_along_axis(_coefficients, -1, rgb), np.stack([nm**2, nm, nm**0]), axes=1)
    return np.asarray(0.5 + U / (2 * np.sqrt(1 + U**2)))


def check_range(wavelengths: np.ndarray, nodes: np.ndarray, what: str) -> None:
    """Raises ValueError unless all wavelengths lie between the first and the last of the nodes."""
    if not np.all((wavelengths >= nodes[0]) & (wavelengths <= nodes[-1])):
        raise ValueError(
            f"wavelengths are in micrometres, and {what} runs from {nodes[0]:g} to {nodes[-1]:g} µm; "
            f"found {np.min(wavelengths):g} to {np.max(wavelengths):g}"
        )


def _coefficients(rgb: np.ndarray) -> np.ndarray:
    """Jakob & Hanika's c_0, c_1, c_2 of one colour, for λ in nm."""
    colour = _colour_science()
    XYZ = colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ @ rgb
    return colour.recovery.find_coefficients_Jakob2019(XYZ)[0]


def _srgb_weights() -> np.ndarray:
    """What each visible wavelength adds to R, G and B under D65, (W, 3); in arbitrary units."""
    colour = _colour_science()
    shape = colour.SpectralShape(_VISIBLE[0] * 1000, _VISIBLE[-1] * 1000, 1)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape)
    daylight = colour.SDS_ILLUMINANTS["D65"].copy().align(shape)
    to_rgb = colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB
    return daylight.values[:, None] * observer.values @ to_rgb.T


def _colour_science():
    try:
        with np.printoptions():  # its import sets how numpy prints
            import colour
            import colour.recovery
    except ImportError:
        raise ImportError(
            "colours of spectra need the library colour-science: pip install 'jaxbrdf[colour]' (constants at "
            "given wavelengths do not need it)"
        ) from None
    return colour
