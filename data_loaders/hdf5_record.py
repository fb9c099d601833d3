r"""A record as an HDF5 file: models, measurements, fits, bit for bit, and where they come from.

A model is a group with its class in the attribute "class"; its arrays are datasets, its tuples groups with
the attribute "length" and members numbered from 0, its texts and plain numbers, and static tuples of them,
attributes. One that is not there reads as the default of its field, if there is one: old files stay readable
when a class gains a field. Classes are looked up by name among the public names of jaxbrdf; nothing else in a
file can name code. The file's own attributes say its format and its provenance.

Damage is noticed: HDF5 of this version checks its own structure, and each array has a CRC-32 beside it.
"""

import dataclasses
import inspect
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import NamedTuple

import equinox as eqx
import h5py
import numpy as np

import jaxbrdf
from data_loaders.errors import DataError
from data_loaders.files import HDF5_MAGIC, AnyPath, describe, read_head, replacing
from data_loaders.provenance import Source, provenance

_VERSION = 1
# v110 checks its structure. No locks: files are replaced whole, and network drives often cannot lock.
_WRITE = {"mode": "w", "libver": "v110", "locking": False}
_READ = {"mode": "r", "locking": False}
_NUMBERS = (int,), (float, np.float64)  # of one kind: what reads as another would not be the same

Static = str | float | int | tuple[str, ...] | tuple[float, ...] | tuple[int, ...]


class Kind(NamedTuple):
    """What a file holds: the `format` it says it has, and the name of the group with the record."""

    format: str
    group: str


def write_record(
    path: AnyPath,
    kind: Kind,
    record: eqx.Module | tuple,
    source: Source = None,
    about: Mapping[str, str | float] = MappingProxyType({}),
) -> None:
    """Writes a record whole; `read_record` gives it back bit for bit. `source` names the measured files,
    `about` is whatever else is to be said of it, which `read_about` tells.

    The file appears complete or not at all; an old one stays until then. Raises ValueError for a record
    with something in it that is not an array, a tuple, a text or a public class of jaxbrdf, DataError
    where `path` cannot be written.
    """
    with replacing(path) as temporary, h5py.File(temporary, **_WRITE) as file:
        for name, value in {**about, "format": kind.format, **provenance(source)}.items():
            _write_static(file, name, value)
        file.attrs["format_version"] = _VERSION
        _write(file, kind.group, record)


def read_record(path: AnyPath, kind: Kind) -> object:
    """What `write_record` wrote, in the precision it was written in.

    Raises DataError where the file cannot be read, is not such a record or one of another version, is
    damaged or cut short, or names a class that this jaxbrdf does not have.
    """
    head = read_head(path)
    if not head.startswith(HDF5_MAGIC):
        raise DataError(path, f"a {kind.format} saved as HDF5", describe(head))
    with _damage(path), h5py.File(path, **_READ) as file:
        _check_format(path, file, kind)
        return _read(path, _member(path, file, kind.group))


def record_format(path: AnyPath) -> str:
    """The format that an HDF5 file says it has; an empty text where it says nothing. Raises DataError for a
    damaged file."""
    with _damage(path), h5py.File(path, **_READ) as file:
        return str(_text(file, "format")) if "format" in file.attrs else ""


def read_about(path: AnyPath) -> dict[str, Static]:
    """What a file says of itself: its format, where it comes from, and what its writer added. Raises
    DataError for a damaged file."""
    with _damage(path), h5py.File(path, **_READ) as file:
        return {name: _attribute(file, name) for name in file.attrs if name != "format_version"}


# Writing


def _write(group: h5py.Group, name: str, value: object) -> None:
    if isinstance(value, eqx.Module):
        _write_module(group.create_group(name), value)
    elif isinstance(value, tuple):
        numbered = group.create_group(name)
        numbered.attrs["length"] = len(value)
        for index, item in enumerate(value):
            _write(numbered, str(index), item)
    else:
        _write_array(group, name, np.asarray(value))


def _write_module(group: h5py.Group, module: eqx.Module) -> None:
    name = type(module).__name__
    if _public_class(name) is not type(module):
        raise ValueError(
            f"HDF5 stores classes among jaxbrdf's public names; {name} is not: nobody could find it again"
        )
    _write_text(group, "class", name)
    for field in dataclasses.fields(module):
        value, is_static = getattr(module, field.name), field.metadata.get("static", False)
        if value is not None:
            (_write_static if is_static else _write)(group, field.name, value)


def _write_array(group: h5py.Group, name: str, array: np.ndarray) -> None:
    if array.dtype.kind not in "biufc":
        raise ValueError(
            f"HDF5 stores numbers, tuples, texts and models; {group.name}/{name} is {array.dtype}"
        )
    group.create_dataset(name, data=array).attrs["crc32"] = _crc(array)


def _write_static(group: h5py.Group, name: str, value: object) -> None:
    """A plain number or a text, or a tuple of either."""
    items = value if isinstance(value, tuple) else (value,)
    if items and any(all(type(item) in kinds for item in items) for kinds in _NUMBERS):
        group.attrs[name] = value
    else:
        _write_text(group, name, value)


def _write_text(group: h5py.Group, name: str, value: object) -> None:
    """A str or a tuple of str, of fixed length: HDF5's checks do not cover texts of variable length."""
    if not all(isinstance(item, str) for item in (value if isinstance(value, tuple) else (value,))):
        raise ValueError(
            "HDF5 stores a static field if it is a float, an int, a str or a tuple of one of them; "
            f"{group.name}/{name} is {value!r}"
        )
    data = np.char.encode(np.asarray(value, dtype=str), "utf-8", "surrogateescape")
    group.attrs.create(name, data, dtype=h5py.string_dtype("utf-8", max(1, data.itemsize)))


# Reading


@contextmanager
def _damage(path: AnyPath) -> Iterator[None]:
    """Turns what h5py raises on a damaged file, which may be any of these, into a DataError."""
    try:
        yield
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as error:
        reason = error.args[0] if error.args else type(error).__name__
        raise DataError(path, "an undamaged record", f"damage: {reason}") from error


def _check_format(path: AnyPath, file: h5py.File, kind: Kind) -> None:
    found = _text(file, "format") if "format" in file.attrs else "an HDF5 file of another kind"
    if found != kind.format:
        raise DataError(path, f"a {kind.format}", f"{found}")
    version = int(file.attrs["format_version"])
    if version != _VERSION:
        raise DataError(
            path,
            f"a {kind.format} in format version {_VERSION}",
            f"version {version}: another jaxbrdf wrote it",
        )


def _read(path: AnyPath, node: h5py.Group | h5py.Dataset) -> object:
    if isinstance(node, h5py.Dataset):
        return _read_array(path, node)
    if "length" in node.attrs:
        return tuple(_read(path, _member(path, node, str(k))) for k in range(int(node.attrs["length"])))
    return _read_module(path, node)


def _read_array(path: AnyPath, dataset: h5py.Dataset) -> np.ndarray:
    if dataset.dtype.kind not in "biufc" or dataset.id.get_storage_size() != dataset.nbytes:
        raise DataError(path, f"all numbers of {dataset.name}", "something else, or only a part")
    array = dataset[...]
    if _crc(array) != dataset.attrs["crc32"]:
        raise DataError(path, f"{dataset.name} as it was written", "other numbers: the file is damaged")
    return array


def _read_module(path: AnyPath, group: h5py.Group) -> eqx.Module:
    """The model of a group, made without its constructor, whose conversions could narrow its numbers."""
    cls = _class(path, group)
    module = object.__new__(cls)
    for field in dataclasses.fields(cls):
        object.__setattr__(module, field.name, _read_field(path, group, field))
    return module


def _read_field(path: AnyPath, group: h5py.Group, field: dataclasses.Field) -> object:
    if field.metadata.get("static", False):
        is_new = field.name not in group.attrs and field.default is not dataclasses.MISSING
        return field.default if is_new else _static(path, group, field.name)
    if field.name not in group and field.default is None:
        return None
    return _as_declared(_read(path, _member(path, group, field.name)), field)


def _as_declared(value: object, field: dataclasses.Field) -> object:
    """An array as the field's own converter makes it, unless that would narrow it (float64 without x64)."""
    converter = field.metadata.get("converter")
    if converter is None or not isinstance(value, np.ndarray):
        return value
    converted = converter(value)
    return converted if converted.dtype == value.dtype else value


def _class(path: AnyPath, group: h5py.Group) -> type[eqx.Module]:
    name = _static(path, group, "class")
    cls = _public_class(str(name))
    if cls is None:
        raise DataError(path, f"one of jaxbrdf's models in {group.name}", f"the unknown class {name!r}")
    return cls


def _public_class(name: str) -> type[eqx.Module] | None:
    """The concrete model of that name on jaxbrdf's face, None where there is none."""
    cls = getattr(jaxbrdf, name) if name in jaxbrdf.__all__ else None
    is_model = inspect.isclass(cls) and issubclass(cls, eqx.Module) and not inspect.isabstract(cls)
    return cls if is_model else None


def _member(path: AnyPath, group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset:
    if name not in group:
        raise DataError(path, f"{name!r} in {group.name}", f"only {sorted(group)}")
    return group[name]


def _static(path: AnyPath, group: h5py.Group, name: str) -> Static:
    if name not in group.attrs:
        raise DataError(path, f"the attribute {name!r} of {group.name}", f"only {sorted(group.attrs)}")
    return _attribute(group, name)


def _attribute(group: h5py.Group, name: str) -> Static:
    value = np.asarray(group.attrs[name])
    if value.dtype.kind not in "if":
        return _text(group, name)
    return tuple(value.tolist()) if value.ndim else value.item()


def _text(group: h5py.Group, name: str) -> str | tuple[str, ...]:
    text = np.char.decode(group.attrs[name], "utf-8", "surrogateescape")
    return tuple(text.tolist()) if text.ndim else str(text)


def _crc(array: np.ndarray) -> int:
    return zlib.crc32(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
