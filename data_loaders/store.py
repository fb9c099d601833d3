"""Fits and reflectances on the disk, as HDF5 files: whole, and bit for bit."""

from typing import Any

import equinox as eqx

from data_loaders.errors import DataError
from data_loaders.files import AnyPath
from data_loaders.hdf5_record import Kind, read_record, write_record
from data_loaders.provenance import Source
from jaxbrdf import FitResult
from jaxbrdf.resampling import Reflectance

FIT = Kind("jaxbrdf fit", "result")
REFLECTANCE = Kind("jaxbrdf reflectance", "reflectance")


def save_fit(path: AnyPath, result: FitResult, source: Source = None) -> None:
    """Writes a fit whole; `load_fit` gives it back bit for bit. `source` names the measured files.

    The file appears complete or not at all; an old one stays until then. Raises ValueError for a model
    with something in it that is not an array, a tuple, a text or a public class of jaxbrdf, DataError
    where `path` cannot be written.
    """
    write_record(path, FIT, result, source)


def load_fit(path: AnyPath) -> FitResult:
    """The fit that `save_fit` wrote, in the precision it was written in.

    Raises DataError where the file cannot be read, is not such a record or one of another version, is
    damaged or cut short, or names a class that this jaxbrdf does not have.
    """
    result = read_record(path, FIT)
    if not isinstance(result, FitResult):
        raise DataError(path, "a FitResult", f"a {type(result).__name__}")
    return result


def write_hdf5(path: AnyPath, reflectance: Reflectance, source: Source = None) -> None:
    """Writes a reflectance, measured or a model; `read_hdf5` gives it back bit for bit.

    Raises as `save_fit` does.
    """
    write_record(path, REFLECTANCE, reflectance, source)


def read_hdf5(path: AnyPath) -> Reflectance:
    """The reflectance that `write_hdf5` wrote. Raises DataError as `load_fit` does."""
    return read_whole(path, REFLECTANCE, Reflectance, "reflectance")


def read_whole(path: AnyPath, kind: Kind, classes: Any, name: str) -> Any:
    """The record of a file, of one of some classes and with arrays that belong together. Raises DataError."""
    record = read_record(path, kind)
    if not isinstance(record, classes):
        raise DataError(path, f"a {name}", f"a {type(record).__name__}")
    check_shapes(path, record)
    return record


def check_shapes(path: AnyPath, record: eqx.Module) -> None:
    """What the class itself asks of its arrays, which reading leaves out."""
    try:
        for cls in type(record).__mro__:
            if "__check_init__" in vars(cls):
                cls.__check_init__(record)  # type: ignore[attr-defined]
    except (ValueError, TypeError, IndexError) as error:  # a number in the place of an array
        raise DataError(path, "arrays that belong together", str(error)) from error
