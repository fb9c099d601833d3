"""Files of the RGL database (.bsdf): reflectance in the adaptive parameterisation of Dupuy & Jakob 2018.

A tensor file with the tables of `jaxbrdf.AdaptiveBRDF` in single precision: `values` is the field "rgb" or
"spectra" [φ_i][θ_i][channel][][], spectra with their "wavelengths" in nanometres. See
https://rgl.epfl.ch/materials. Mitsuba's plugin `measured` reads the same files.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from data_loaders.errors import DataError
from data_loaders.files import AnyPath
from data_loaders.numbers import check_any_valid, micrometres
from data_loaders.tensor_file import read_tensors, write_tensors
from jaxbrdf import AdaptiveBRDF

_AXES = {"theta_i": 1, "phi_i": 1, "ndf": 2, "sigma": 2, "vndf": 4, "luminance": 4}
_MARKS = {"jacobian": np.uint8, "version": np.uint32, "valid": np.uint8}


def read_rgl(path: AnyPath) -> AdaptiveBRDF:
    """The reflectance of an RGL file, RGB or spectral, isotropic or anisotropic.

    `name` is the file's name without its suffix, `origin` its description. Raises DataError where the file
    cannot be read, lacks a table or has it in another shape, or where a number is NaN or infinite.
    """
    tensors = read_tensors(path)
    channels = "spectra" if "spectra" in tensors else "rgb"
    for name, axes in {**_AXES, channels: 5, "wavelengths": 1}.items():
        if name != "wavelengths" or channels == "spectra":
            _check(path, tensors, name, axes)
    _check_angles(path, "theta_i", tensors["theta_i"], np.pi / 2)
    _check_angles(path, "phi_i", tensors["phi_i"], 2 * np.pi)
    check_any_valid(path, tensors[channels])
    try:
        return AdaptiveBRDF(
            **{name: tensors[name] for name in _AXES},
            values=np.moveaxis(tensors[channels], 2, -1),
            wavelengths=micrometres(path, tensors["wavelengths"]) if channels == "spectra" else None,
            **_marks(path, tensors),
            name=Path(path).stem,
            origin=_description(tensors),
        )
    except ValueError as error:
        raise DataError(path, "tables whose shapes belong together", str(error)) from error


def write_rgl(path: AnyPath, brdf: AdaptiveBRDF) -> None:
    """Writes a reflectance as an RGL file: what `read_rgl` gave comes back bit for bit.

    Mitsuba reads it. Raises ValueError for spectra without wavelengths (other than three channels, which are
    R, G and B), DataError where `path` cannot be written. The file appears complete or not at all.
    """
    channels = brdf.values.shape[-1]
    if brdf.wavelengths is None and channels != 3:
        raise ValueError(
            f"an RGL file holds R, G and B or a spectrum; this has {channels} channels without "
            "wavelengths: give it wavelengths, in micrometres, or make three channels"
        )
    tensors = {
        "version": brdf.version,
        "description": np.frombuffer("\n".join(brdf.origin).encode("utf-8", "surrogateescape"), np.uint8),
        **{name: _single(getattr(brdf, name)) for name in ("phi_i", "theta_i", "sigma", "ndf", "vndf")},
        "luminance": _single(brdf.luminance),
        "rgb" if brdf.wavelengths is None else "spectra": _single(np.moveaxis(brdf.values, -1, 2)),
        "wavelengths": None if brdf.wavelengths is None else _single(1000 * brdf.wavelengths),
        "jacobian": brdf.jacobian,
        "valid": brdf.valid,
    }
    write_tensors(path, {name: np.asarray(array) for name, array in tensors.items() if array is not None})


def _check(path: AnyPath, tensors: Mapping[str, np.ndarray], name: str, axes: int) -> None:
    """Whether a table is there, with that many axes, and holds finite numbers in single precision."""
    if name not in tensors:
        raise DataError(path, f"a table {name!r}", f"only {', '.join(sorted(tensors)) or 'nothing'}")
    table = tensors[name]
    if (
        table.dtype != np.float32
        or table.ndim != axes
        or 0 in table.shape
        or 1 in table.shape[-2:] * (axes > 1)
    ):
        raise DataError(path, f"{name} with {axes} axes of float32", f"{table.dtype} of shape {table.shape}")
    if not np.isfinite(table).all():
        raise DataError(path, f"finite numbers in {name}", "NaN or infinity")


def _check_angles(path: AnyPath, name: str, angles: np.ndarray, limit: float) -> None:
    if np.any(np.diff(angles) <= 0) or np.any(np.abs(angles) > limit + 1e-4):
        raise DataError(path, f"{name} in radians, increasing, up to {limit:.4g}", f"{angles}")


def _marks(path: AnyPath, tensors: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The rows of whole numbers that are there."""
    marks = {name: tensors[name] for name in _MARKS if name in tensors}
    for name, mark in marks.items():
        if mark.dtype != _MARKS[name] or mark.ndim != 1 or not mark.size:
            raise DataError(path, f"{name}: {_MARKS[name].__name__}", f"{mark.dtype} of shape {mark.shape}")
    return marks


def _description(tensors: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    text = tensors.get("description", np.zeros(0, np.uint8)).tobytes().decode("utf-8", "surrogateescape")
    return tuple(text.split("\n")) if text else ()


def _single(array: np.ndarray) -> np.ndarray:
    return np.asarray(array, np.float32)
