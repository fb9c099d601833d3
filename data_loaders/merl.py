r"""MERL files (Matusik et al. 2003; .binary): isotropic RGB reflectance over half and difference angles.

Three little-endian int32, the numbers of θ_h, θ_d and φ_d cells (90, 90, 180), then little-endian float64
[3 channels][90 θ_h][90 θ_d][180 φ_d]. A number times (1, 1.15, 1.66)/1500 is the reflectance in 1/sr; a
negative number marks a cell that was not measured. `jaxbrdf.merl_grid` says where the cells are.
"""

import math
import os
import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from data_loaders.errors import DataError
from data_loaders.files import AnyPath, describe, is_text, read_head, replacing, system_errors
from jaxbrdf import HalfDifferenceGrid, MeasuredBRDF, Slices, merl_grid

_DIMENSIONS = (90, 90, 180)
_CELLS = math.prod(_DIMENSIONS)
_SHAPE = (3, *_DIMENSIONS)
_HEADER = struct.Struct("<3i")
_SIZE = _HEADER.size + 8 * math.prod(_SHAPE)
_SCALE = (1.0 / 1500, 1.15 / 1500, 1.66 / 1500)  # the database's own reader, BRDFRead.cpp
_NOT_MEASURED = -1.0


def read_merl(path: AnyPath) -> MeasuredBRDF:
    """The reflectance of a MERL file. The table stays on the disk, mapped: `raw` is a view of it.

    The whole file is looked through once, in little memory. `name` is the file's name without its suffix.
    Raises DataError where the file cannot be read, its header or size is wrong, a number is NaN or
    infinite, or no sample is valid.
    """
    table = _map(path)
    _check_samples(path, table.reshape(-1, *_DIMENSIONS[1:]))
    return _measured(path, table)


def read_merl_slices(path: AnyPath) -> Slices:
    """The slices that `read_merl(path).slices()` gives, read alone: two parts in a hundred of the file.

    Raises DataError as `read_merl` does, for the numbers of the two slices only.
    """
    table = _map(path)
    _check_samples(path, (table[:, :, 0], table[:, 0]))
    return _measured(path, table).slices()


def write_merl(path: AnyPath, measured: MeasuredBRDF) -> None:
    """Writes a reflectance as a MERL file: what `read_merl` gave comes back bit for bit, invalid cells too.

    Where `measured.scale` is not MERL's, the samples are rescaled and invalid ones become −1. The file
    appears complete or not at all, and may be the one that `measured` is mapped from. Raises ValueError
    for a reflectance that is not RGB on the MERL grid or is infinite somewhere, DataError where `path`
    cannot be written.
    """
    _check_grid(measured)
    with replacing(path) as temporary, open(temporary, "xb") as file:
        file.write(_HEADER.pack(*_DIMENSIONS))
        for channel, scale in enumerate(_SCALE):
            raw = np.asarray(measured.raw[..., channel])
            file.write(_samples(raw, float(measured.scale[channel]) / scale).tobytes())


def is_merl(head: bytes) -> bool:
    """Whether a file that begins with `head` is a MERL file."""
    return head.startswith(_HEADER.pack(*_DIMENSIONS))


def _map(path: AnyPath) -> np.ndarray:
    """The table [channel, θ_h, θ_d, φ_d] of a file whose header and size are right; not read yet."""
    _check_header(path, read_head(path))
    with system_errors(path):
        _check_size(path, os.path.getsize(path))
        return np.memmap(path, "<f8", mode="r", offset=_HEADER.size, shape=_SHAPE)


def _measured(path: AnyPath, table: np.ndarray) -> MeasuredBRDF:
    return MeasuredBRDF(np.moveaxis(table, 0, -1), np.array(_SCALE), merl_grid(), name=Path(path).stem)


def _check_header(path: AnyPath, head: bytes) -> None:
    if is_text(head) or len(head) < _HEADER.size:
        raise DataError(path, f"a MERL file, binary, of {_SIZE} bytes", describe(head))
    found = _HEADER.unpack_from(head)
    if min(found) <= 0 or math.prod(found) != _CELLS:
        raise DataError(path, f"the MERL dimensions {_times(_DIMENSIONS)}", f"dimensions {_times(found)}")


def _check_size(path: AnyPath, size: int) -> None:
    if size != _SIZE:
        difference = f"{_SIZE - size} too few, cut short" if size < _SIZE else f"{size - _SIZE} too many"
        raise DataError(path, f"a MERL file of {_SIZE} bytes", f"{size} bytes ({difference})")


def _check_samples(path: AnyPath, parts: Iterable[np.ndarray]) -> None:
    """Whether all numbers are finite and one is valid, a part at a time so that memory stays flat."""
    total, finite, valid = 0, 0, 0
    for part in parts:
        total += part.size
        finite += int(np.count_nonzero(np.isfinite(part)))
        valid += int(np.count_nonzero(part >= 0))
    if finite < total:
        raise DataError(path, "finite samples", f"NaN or infinity in {total - finite} of {total} samples")
    if not valid:
        raise DataError(path, "valid samples (≥ 0)", f"none: all {total} samples are negative")


def _check_grid(measured: MeasuredBRDF) -> None:
    if not _is_merl_grid(measured.grid):
        raise ValueError(
            f"a MERL file has the {_times(_DIMENSIONS)} cells of merl_grid(), this reflectance another grid, "
            f"of {_times(measured.grid.shape)} cells: evaluate it at merl_grid().directions() and write that"
        )
    if measured.wavelengths is not None:
        raise ValueError("a MERL file holds R, G and B, not wavelengths: make colours of them by `to_rgb`")
    if measured.raw.shape != (*_DIMENSIONS, 3):
        raise ValueError(
            f"a MERL file has 3 channels; this reflectance is a table of {_times(measured.raw.shape)}: "
            "choose or make three channels, R, G and B"
        )


def _is_merl_grid(grid: HalfDifferenceGrid) -> bool:
    merl = merl_grid()
    return grid.shape == merl.shape and all(
        np.allclose(getattr(grid, axis), getattr(merl, axis), rtol=1e-6)
        for axis in ("theta_h", "theta_d", "phi_d")
    )


def _samples(raw: np.ndarray, ratio: float) -> np.ndarray:
    """One channel as the file holds it: raw · ratio. At ratio 1 finite invalid samples keep their value."""
    invalid = np.where(np.isfinite(raw), raw, _NOT_MEASURED) if ratio == 1 else _NOT_MEASURED
    samples = np.where(raw >= 0, raw * ratio, invalid).astype("<f8")
    if not np.isfinite(samples).all():
        raise ValueError(
            "a MERL file holds finite numbers; this reflectance is infinite somewhere: mark it invalid, −1"
        )
    return samples


def _times(dimensions: Iterable[int]) -> str:
    return " × ".join(map(str, dimensions))
