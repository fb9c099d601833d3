"""Tabulated distributions of normals on the disk: HDF5, with their unit, layout and provenance."""

from collections.abc import Mapping
from types import MappingProxyType

from data_loaders.files import AnyPath
from data_loaders.hdf5_record import Kind, write_record
from data_loaders.provenance import Source
from data_loaders.store import read_whole
from jaxbrdf import AbstractNDF, TabulatedNDF

NDF = Kind("jaxbrdf distribution of normals", "ndf")
_LAYOUT = {
    "unit": "1/sr",
    "layout": (
        "values[..., i, j] at m_x = e_x ((2j+1)/N - 1), m_y = e_y ((2i+1)/N - 1) of the unit disk, "
        "0 outside it and outside this window; (e_x, e_y) is the attribute extent of the table, (1, 1) "
        "where there is none"
    ),
}


def write_ndf(
    path: AnyPath,
    ndf: AbstractNDF,
    source: Source = None,
    about: Mapping[str, str | float] = MappingProxyType({}),
) -> None:
    """Writes a table, (N, N), or a stack, (B, N, N), whole; `read_ndf` gives it back bit for bit.

    `source` names the files that it was made of, `about` says how: texts and numbers that become attributes
    beside the unit and the layout (`method`, `sigma`, `wavelength`, …), for `read_about` to tell. An old file
    stays until the new one is whole. Raises ValueError for anything but a `TabulatedNDF`, DataError where
    `path` cannot be written.
    """
    if not isinstance(ndf, TabulatedNDF):
        raise ValueError(f"write_ndf writes a TabulatedNDF; found a {type(ndf).__name__}")
    write_record(path, NDF, ndf, source, {**about, **_LAYOUT})


def read_ndf(path: AnyPath) -> TabulatedNDF:
    """The table that `write_ndf` wrote. Raises DataError for any other file, a damaged or a shortened one."""
    return read_whole(path, NDF, TabulatedNDF, "TabulatedNDF")
