"""Reading a reflectance without saying what format it is in: by its first bytes, then by its suffix."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from data_loaders.alta import is_alta, read_alta
from data_loaders.cornell import is_cornell, read_cornell
from data_loaders.csv_table import is_csv, read_csv
from data_loaders.errors import DataError
from data_loaders.files import HDF5_MAGIC, AnyPath, describe, read_head
from data_loaders.hdf5_record import record_format
from data_loaders.merl import is_merl, read_merl
from data_loaders.minidiff import is_minidiff, read_minidiff
from data_loaders.rgl import read_rgl
from data_loaders.store import FIT, load_fit, read_hdf5
from data_loaders.tensor_file import is_tensor_file
from jaxbrdf import AbstractBRDF, MeasuredSamples

Reflectance = AbstractBRDF | MeasuredSamples

_HEAD = 4096  # bytes that tell the formats apart


class Format(NamedTuple):
    """A kind of file: its name, the usual suffixes, whether a file begins like one, and its reader."""

    name: str
    suffixes: tuple[str, ...]
    begins: Callable[[bytes], bool]
    read: Callable[[AnyPath], Reflectance]


def _read_hdf5(path: AnyPath) -> Reflectance:
    """A reflectance of ours, or the model of a fit."""
    if record_format(path) != FIT.format:
        return read_hdf5(path)
    model = load_fit(path).model
    if not isinstance(model, AbstractBRDF):
        raise DataError(path, "a fitted reflectance", f"a fitted {type(model).__name__}")
    return model


_FORMATS = (
    Format("MERL", (".binary",), is_merl, read_merl),
    Format("RGL", (".bsdf",), is_tensor_file, read_rgl),
    Format("HDF5", (".h5", ".hdf5"), lambda head: head.startswith(HDF5_MAGIC), _read_hdf5),
    Format("ALTA", (".alta",), is_alta, read_alta),
    Format("Mini-Diff", (".astm",), is_minidiff, read_minidiff),
    Format("Cornell", (".brdf",), is_cornell, read_cornell),
    Format("CSV", (".csv",), is_csv, read_csv),
)


def read_brdf(path: AnyPath) -> Reflectance:
    """The reflectance in a file of any format that is understood; `recognise` says which that is.

    MERL gives a `MeasuredBRDF`, RGL an `AdaptiveBRDF`, ALTA, Mini-Diff, Cornell and CSV `MeasuredSamples`,
    HDF5 what was stored, of a fit its model. Raises DataError as `recognise` does, and as the reader does.
    """
    return recognise(path).read(path)


def recognise(path: AnyPath) -> Format:
    """The format of a file: its `name`, its `suffixes`, and the function that can `read` it.

    The first bytes decide; where they say nothing, the suffix does, so that a damaged file is reported by the
    reader it was meant for. Raises DataError where neither is known, or the file cannot be read.
    """
    head = read_head(path, _HEAD)
    suffix = Path(path).suffix.lower()
    by_content = [f for f in _FORMATS if f.begins(head)]
    by_suffix = [f for f in _FORMATS if suffix in f.suffixes]
    for known in by_content + by_suffix:
        return known
    understood = ", ".join(f"{f.name} ({', '.join(f.suffixes)})" for f in _FORMATS)
    raise DataError(path, f"a reflectance in a known format: {understood}", describe(head))
