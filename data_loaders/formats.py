"""All formats of reflectance in one table: recognised by first bytes, then by suffix; read, and written."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from data_loaders.alta import is_alta, read_alta, write_alta
from data_loaders.colours import to_rgb
from data_loaders.cornell import is_cornell, read_cornell
from data_loaders.csv_table import is_csv, read_csv, write_csv
from data_loaders.errors import DataError
from data_loaders.files import HDF5_MAGIC, AnyPath, describe, read_head
from data_loaders.hdf5_record import record_format
from data_loaders.merl import is_merl, read_merl, write_merl
from data_loaders.minidiff import is_minidiff, read_minidiff
from data_loaders.rgl import read_rgl, write_rgl
from data_loaders.store import FIT, load_fit, read_hdf5, write_hdf5
from data_loaders.tensor_file import is_tensor_file
from jaxbrdf import AbstractBRDF, MeasuredBRDF, as_adaptive, as_samples, as_table
from jaxbrdf.resampling import Measurement, Reflectance, count_channels

_HEAD = 4096  # bytes that tell the formats apart


def _read_hdf5(path: AnyPath) -> Reflectance:
    """A reflectance of ours, or the model of a fit."""
    if record_format(path) != FIT.format:
        return read_hdf5(path)
    model = load_fit(path).model
    if not isinstance(model, AbstractBRDF):
        raise DataError(path, "a fitted reflectance", f"a fitted {type(model).__name__}")
    return model


def _as_merl(reflectance: Reflectance) -> MeasuredBRDF:
    """A table in one or three channels; a spectrum's would fill the memory before it is refused."""
    count = count_channels(reflectance)
    spectral = isinstance(reflectance, Measurement) and reflectance.wavelengths is not None
    if spectral or count not in (1, 3):  # three wavelengths are no R, G and B either
        raise ValueError(
            f"a MERL file holds R, G and B; this reflectance has {count} "
            f"{'wavelengths' if spectral else 'channels'}: make colours of spectra (`to_rgb`, --rgb), or "
            "write RGL, HDF5, ALTA or CSV"
        )
    return as_table(reflectance)


class Format(NamedTuple):
    """A kind of file: its name, the usual suffixes, whether a file begins like one, and its reader.

    `write` is its writer, None where there is none; `record` makes of any reflectance what that takes, and
    `colours` says whether grey has to become R, G and B for it.
    """

    name: str
    suffixes: tuple[str, ...]
    begins: Callable[[bytes], bool]
    read: Callable[[AnyPath], Reflectance]
    write: Callable[[AnyPath, Any], None] | None = None
    record: Callable[[Reflectance], Reflectance] = as_samples
    colours: bool = False


FORMATS = (
    Format("MERL", (".binary",), is_merl, read_merl, write_merl, _as_merl, colours=True),
    Format("RGL", (".bsdf",), is_tensor_file, read_rgl, write_rgl, as_adaptive, colours=True),
    Format(
        "HDF5",
        (".h5", ".hdf5"),
        lambda head: head.startswith(HDF5_MAGIC),
        _read_hdf5,
        write_hdf5,
        lambda reflectance: reflectance,
    ),
    Format("ALTA", (".alta",), is_alta, read_alta, write_alta),
    Format("CSV", (".csv",), is_csv, read_csv, write_csv),
    Format("Mini-Diff", (".astm",), is_minidiff, read_minidiff),
    Format("Cornell", (".brdf",), is_cornell, read_cornell),
)


def read_brdf(path: AnyPath) -> Reflectance:
    """The reflectance in a file of any format that is understood; `recognise` says which that is.

    MERL gives a `MeasuredBRDF`, RGL an `AdaptiveBRDF`, ALTA, Mini-Diff, Cornell and CSV `MeasuredSamples`,
    HDF5 what was stored, of a fit its model. Raises DataError as `recognise` does, and as the reader does.
    """
    return recognise(path).read(path)


def write_brdf(path: AnyPath, reflectance: Reflectance) -> Reflectance:
    """Writes any reflectance, measured or a model, in the format that the suffix of `path` names.

    What is returned is what was written: the same where the format holds it as it is, and else resampled by
    `jaxbrdf.as_table` (MERL), `as_adaptive` (RGL) or `as_samples` (ALTA, CSV); `resampling_error` has the
    difference. Grey becomes three equal channels where the format needs colours; of spectra `to_rgb` makes
    some. An old file stays until the new one is whole. Raises ValueError for what the format cannot hold,
    DataError for a suffix that is not written and where `path` cannot be.
    """
    kind = _written_as(path)
    record = kind.record(reflectance)
    record = to_rgb(record) if kind.colours and _is_grey(record) else record
    assert kind.write is not None
    kind.write(path, record)
    return record


def recognise(path: AnyPath) -> Format:
    """The format of a file: its `name`, its `suffixes`, and the function that can `read` it.

    The first bytes decide; where they say nothing, the suffix does, so that a damaged file is reported by the
    reader it was meant for. Raises DataError where neither is known, or the file cannot be read.
    """
    head = read_head(path, _HEAD)
    suffix = Path(path).suffix.lower()
    by_content = [f for f in FORMATS if f.begins(head)]
    by_suffix = [f for f in FORMATS if suffix in f.suffixes]
    for known in by_content + by_suffix:
        return known
    raise DataError(path, f"a reflectance in a known format: {_listed(FORMATS)}", describe(head))


def _written_as(path: AnyPath) -> Format:
    suffix = Path(path).suffix.lower()
    writers = [f for f in FORMATS if f.write is not None]
    for known in writers:
        if suffix in known.suffixes:
            return known
    raise DataError(
        path, f"a name with the suffix of a format that is written: {_listed(writers)}", suffix or "none"
    )


def _listed(formats: Iterable[Format]) -> str:
    return ", ".join(f"{f.name} ({', '.join(f.suffixes)})" for f in formats)


def _is_grey(record: Reflectance) -> bool:
    """Whether it has one channel, of no wavelength."""
    return isinstance(record, Measurement) and record.wavelengths is None and count_channels(record) == 1
