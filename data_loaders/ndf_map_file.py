"""Maps of distributions of normals over surfaces: HDF5, with their units and provenance."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import equinox as eqx

from data_loaders.errors import DataError
from data_loaders.files import AnyPath
from data_loaders.hdf5_record import Kind, read_record, write_record
from data_loaders.provenance import Source
from data_loaders.store import check_shapes
from jaxbrdf import NDFMap

MAPS = Kind("jaxbrdf maps of distributions of normals", "maps")
_LAYOUT = {"unit": "um, 1/sr, radian", "layout": "images [i, j]: rows along y, columns along x"}


def write_ndf_maps(
    path: AnyPath,
    maps: Sequence[eqx.Module],
    source: Source = None,
    about: Mapping[str, str | float] = MappingProxyType({}),
) -> None:
    """Writes maps whole; `read_ndf_maps` gives them back bit for bit.

    `source` names the files that they were made of, `about` says how, for `read_about` to tell. An old file
    stays until the new one is whole. Raises ValueError for anything but NDFMaps, DataError where `path`
    cannot be written.
    """
    if not all(isinstance(item, NDFMap) for item in maps):
        raise ValueError(f"write_ndf_maps writes NDFMaps; found {[type(item).__name__ for item in maps]}")
    write_record(path, MAPS, tuple(maps), source, {**about, **_LAYOUT})


def read_ndf_maps(path: AnyPath) -> tuple[NDFMap, ...]:
    """The maps that `write_ndf_maps` wrote. Raises DataError for any other file, a damaged or a shortened
    one."""
    maps = read_record(path, MAPS)
    if not isinstance(maps, tuple) or not all(isinstance(item, NDFMap) for item in maps):
        raise DataError(path, "NDFMaps", f"a {type(maps).__name__} of something else")
    for item in maps:
        check_shapes(path, item)
    return maps
