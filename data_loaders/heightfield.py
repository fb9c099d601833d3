"""Height maps: numpy's files, HDF5 of ours, and whatever profilometers write, by SurfaceTopography."""

import warnings
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from data_loaders.errors import DataError
from data_loaders.files import HDF5_MAGIC, AnyPath, describe, read_head, system_errors
from data_loaders.hdf5_record import Kind, record_format, write_record
from data_loaders.provenance import Source
from data_loaders.store import read_whole
from jaxbrdf import Heightfield

HEIGHTFIELD = Kind("jaxbrdf height map", "heightfield")
_MICROMETRES = {"m": 1e6, "mm": 1e3, "µm": 1.0, "μm": 1.0, "um": 1.0, "nm": 1e-3, "pm": 1e-6, "Å": 1e-4}

# What a folder is searched for, beside numpy's and ours: the usual suffixes of profilometers.
_SUFFIXES = {".npy", ".npz", ".h5", ".hdf5"} | {
    *(".dat", ".datx", ".opd", ".opdx", ".x3p", ".sur", ".mnt", ".plu", ".plux", ".al3d", ".sdf", ".nms"),
    *(".ibw", ".spm", ".mi", ".gwy", ".zon", ".vk3", ".vk4", ".vk6", ".vk7", ".nc", ".bcr", ".bcrf", ".os3d"),
    *(".jpk", ".zag", ".zmg", ".frt", ".lext", ".ezd", ".nid", ".par"),
}


def read_heightfield(
    path: AnyPath,
    *,
    unit: str | None = None,
    pixel: float | Sequence[float] | None = None,
    channel: str | int | None = None,
) -> Heightfield:
    """The height map in a file, in micrometres above its mean height; missing points are masked.

    .npz holds `z` (ny, nx), `dx`, `dy` (or `pixel=`) and perhaps `mask`; .npy holds z, its pixel size being
    given as `pixel`, one number or (dx, dy); NaN there means that a height is missing. HDF5 is what
    `write_heightfield` wrote. Anything else is read by SurfaceTopography (the extra `scans`): Zygo MetroPro
    and datx, Wyko opd, x3p, sur, mnt, plu, al3d and many more; `channel` is one of several by name or number.
    `unit` ('m', 'mm', 'um', 'nm', …) is that of heights and sizes where the file does not say it; of .npy and
    .npz it is by default µm. Nothing is levelled, and no outlier is left out.

    Raises DataError for a file that cannot be read, holds no map or no valid point, is cut short, or does not
    say its unit or size where they are not given; ValueError for an unknown `unit`.
    """
    if unit is not None and unit not in _MICROMETRES:
        raise ValueError(f"unknown unit {unit!r}: expected one of {', '.join(_MICROMETRES)}")
    head = read_head(path)
    suffix = Path(path).suffix.lower()
    if suffix in (".npy", ".npz"):
        return _read_numpy(path, unit or "um", pixel)
    if head.startswith(HDF5_MAGIC) and record_format(path) == HEIGHTFIELD.format:
        return read_whole(path, HEIGHTFIELD, Heightfield, "Heightfield")
    return _read_scan(path, unit, pixel, channel)


def write_heightfield(path: AnyPath, heightfield: Heightfield, source: Source = None) -> None:
    """Writes a map as HDF5; `read_heightfield` gives it back bit for bit. `source` names the measured files.

    An old file stays until the new one is whole. Raises DataError where `path` cannot be written.
    """
    write_record(path, HEIGHTFIELD, heightfield, source, {"unit": "um"})


def scan_files(paths: Iterable[AnyPath]) -> list[Path]:
    """Files as they are, and in place of each folder the height maps in it, by their suffixes, in order of
    their names. Raises DataError for a folder without any."""
    return [file for path in paths for file in _files_of(Path(path))]


def _files_of(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    with system_errors(path, "a folder that can be read"):
        found = sorted(file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES)
    if not found:
        raise DataError(path, "height maps in the folder", "no file with the suffix of one")
    return found


# numpy's files


def _read_numpy(path: AnyPath, unit: str, pixel) -> Heightfield:
    with system_errors(path):
        try:
            parts = _arrays(path)
        except (ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
            raise DataError(path, "numpy arrays", f"the error “{error}”") from error
    if "z" not in parts:
        raise DataError(path, "an array z of heights", f"only {sorted(parts)}")
    sizes = _sizes(path, pixel, parts)
    mask = np.asarray(parts["mask"], bool) if "mask" in parts else None
    return _heightfield(path, parts["z"], mask, sizes, _MICROMETRES[unit])


def _arrays(path: AnyPath) -> dict[str, np.ndarray]:
    content: Any = np.load(path, allow_pickle=False)
    if isinstance(content, np.ndarray):
        return {"z": content}
    with content:
        return dict(content)


def _sizes(path: AnyPath, pixel, parts: Mapping[str, np.ndarray]) -> tuple[float, float]:
    """(dx, dy) as given, or as an .npz says."""
    if pixel is not None:
        dx, dy = np.broadcast_to(pixel, 2)
        return float(dx), float(dy)
    if "dx" not in parts:
        raise DataError(path, "a pixel size: dx and dy in an .npz, or pixel=(dx, dy)", "none")
    try:
        return float(parts["dx"]), float(parts.get("dy", parts["dx"]))
    except (TypeError, ValueError) as error:
        raise DataError(path, "dx and dy that are one number each", f"{error}") from error


# Profilometers' files


def _read_scan(path: AnyPath, unit: str | None, pixel, channel: str | int | None) -> Heightfield:
    topography = _topography(path, _opener(path), channel)
    said = topography["unit"]
    if unit is None and said is None:
        raise DataError(path, "a unit of its heights", "none: give it as unit='um' or the like")
    if unit is None and said not in _MICROMETRES:
        raise DataError(path, f"heights in {', '.join(_MICROMETRES)}", f"the unit {said!r}: give unit=")
    scale = _MICROMETRES[unit if unit is not None else said]
    sizes, shape = topography["sizes"], topography["z"].shape
    if pixel is None and sizes is None:
        raise DataError(path, "the size of its pixels", "none: give it as pixel=(dx, dy)")
    dx, dy = (
        (float(size) / n for size, n in zip(sizes, shape[::-1], strict=True))
        if pixel is None
        else (np.broadcast_to(pixel, 2) / scale)
    )
    return _heightfield(path, topography["z"], topography["mask"], (dx * scale, dy * scale), scale)


def _opener(path: AnyPath) -> Callable:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it tells of an MPI that nobody asked for
            from SurfaceTopography import open_topography
    except ImportError as error:
        raise DataError(
            path,
            "a .npy, .npz or .h5 file, or the library SurfaceTopography for other formats",
            "no such library: pip install 'jaxbrdf[scans]'",
        ) from error
    return open_topography


def _topography(path: AnyPath, open_topography: Callable, channel: str | int | None) -> dict[str, Any]:
    """Heights [y, x], where they were measured, the sizes and the unit that the file says."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of metadata that are of no use here
            reader = open_topography(str(path))
            index = _channel_index(path, [c.name for c in reader.channels], channel)
            topography = reader.topography() if index is None else reader.topography(channel_index=index)
            heights = np.ma.asarray(topography.heights())
            sizes, unit = topography.physical_sizes, topography.unit
    except DataError:
        raise
    except Exception as error:  # a damaged file makes a reader stumble in any way
        found = f"{describe(read_head(path))} ({type(error).__name__}: {' '.join(str(error).split())[:80]})"
        raise DataError(path, "a height map in a format that is understood, whole", found) from error
    if heights.ndim != 2:
        raise DataError(path, "a map of heights", "a line scan")
    missing = np.ma.getmaskarray(heights) | ~np.isfinite(heights.filled(np.nan))
    return {"z": heights.filled(np.nan).T, "mask": ~missing.T, "sizes": sizes, "unit": unit}


def _channel_index(path: AnyPath, names: list[str], channel: str | int | None) -> int | None:
    if channel is None:
        return None
    if isinstance(channel, int) and 0 <= channel < len(names):
        return channel
    if channel in names:
        return names.index(channel)
    raise DataError(path, f"a channel {channel!r}", f"the channels {', '.join(map(str, names))}")


def _heightfield(path: AnyPath, z, mask, sizes: tuple[float, float], scale: float) -> Heightfield:
    """The record of heights in a unit of so many µm; those that are NaN are missing."""
    z = np.asarray(z)
    if z.dtype.kind not in "iuf":
        raise DataError(path, "heights that are numbers", f"an array of {z.dtype}")
    z = z * scale
    measured = ~np.isnan(z) if mask is None else mask
    if mask is None or mask.shape == z.shape:
        known = z[measured & np.isfinite(z)]
        z = np.where(measured, z - (known.mean() if known.size else 0), 0)
    try:
        return Heightfield(z, *sizes, None if np.all(measured) else measured)
    except (ValueError, TypeError) as error:
        raise DataError(path, "a height map", str(error).removeprefix("Heightfield: ")) from error
