"""Tensor files of the RGL database (version 1.0): named arrays of numbers, one after the other.

"tensor_file\\0", two bytes of version (1, 0), uint32 the number of fields; for each field
uint16 length of its name, the name, uint16 number of axes, uint8 kind, uint64 offset, uint64 each axis;
then the arrays at their offsets. All little-endian.
"""

import math
import os
import struct
from collections.abc import Mapping
from typing import BinaryIO, NamedTuple

import numpy as np

from data_loaders.errors import DataError
from data_loaders.files import AnyPath, describe, read_head, replacing, system_errors

_MAGIC = b"tensor_file\0"
_VERSION = (1, 0)
_KINDS = ("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8")  # from 1 on
_MOST_FIELDS = 1000
_MOST_AXES = 32  # numpy's own limit is 64
_ALIGNMENT = 8


class _Field(NamedTuple):
    name: str
    dtype: np.dtype
    shape: tuple[int, ...]
    offset: int

    @property
    def end(self) -> int:
        return self.offset + self.dtype.itemsize * math.prod(self.shape)


def is_tensor_file(head: bytes) -> bool:
    """Whether a file that begins with `head` is a tensor file."""
    return head.startswith(_MAGIC)


def read_tensors(path: AnyPath) -> dict[str, np.ndarray]:
    """The arrays of a tensor file by name.

    Raises DataError where the file cannot be read, is no tensor file or one of another version, is cut short,
    or announces what does not fit in it.
    """
    head = read_head(path)
    if not is_tensor_file(head):
        raise DataError(path, "a tensor file", describe(head))
    with system_errors(path), open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        fields = _read_header(path, file)
        for field in fields:
            if field.end > size or max(field.shape, default=0) > size:
                raise DataError(path, f"{field.name} up to byte {field.end}", f"a file of {size} bytes")
        if sum(field.end - field.offset for field in fields) > size:
            raise DataError(path, f"fields that fit in {size} bytes", "fields that overlap")
        return {field.name: _read_array(path, file, field) for field in fields}


def write_tensors(path: AnyPath, tensors: Mapping[str, np.ndarray]) -> None:
    """Writes arrays as a tensor file, in their order. Raises DataError where `path` cannot be written."""
    fields, offset = [], len(_header([_describe(name, array, 0) for name, array in tensors.items()]))
    for name, array in tensors.items():
        fields.append(_describe(name, array, _aligned(offset)))
        offset = fields[-1].end
    with replacing(path) as temporary, open(temporary, "xb") as file:
        file.write(_header(fields))
        for field, array in zip(fields, tensors.values(), strict=True):
            file.write(bytes(field.offset - file.tell()))
            file.write(np.ascontiguousarray(array, field.dtype).tobytes())
        file.write(bytes(_aligned(file.tell()) - file.tell()))


def _describe(name: str, array: np.ndarray, offset: int) -> _Field:
    return _Field(name, array.dtype.newbyteorder("<"), array.shape, offset)


def _aligned(offset: int) -> int:
    return -(-offset // _ALIGNMENT) * _ALIGNMENT


def _header(fields: list[_Field]) -> bytes:
    parts = [_MAGIC, bytes(_VERSION), struct.pack("<I", len(fields))]
    for name, dtype, shape, offset in fields:
        text, kind = name.encode(), [np.dtype(kind) for kind in _KINDS].index(dtype) + 1
        parts += [struct.pack("<H", len(text)), text, struct.pack("<HBQ", len(shape), kind, offset)]
        parts.append(struct.pack(f"<{len(shape)}Q", *shape))
    return b"".join(parts)


def _read_header(path: AnyPath, file: BinaryIO) -> list[_Field]:
    file.seek(len(_MAGIC))
    major, minor, count = _unpack(path, file, "<BBI")
    if (major, minor) != _VERSION:
        raise DataError(path, f"a tensor file of version {_dotted(_VERSION)}", f"version {major}.{minor}")
    if count > _MOST_FIELDS:
        raise DataError(path, f"at most {_MOST_FIELDS} fields", f"{count}")
    fields = [_read_field(path, file) for _ in range(count)]
    if len({field.name for field in fields}) < count:
        raise DataError(path, "fields of different names", f"{[field.name for field in fields]}")
    return fields


def _read_field(path: AnyPath, file: BinaryIO) -> _Field:
    (length,) = _unpack(path, file, "<H")
    name = file.read(length).decode("utf-8", "replace")
    axes, kind, offset = _unpack(path, file, "<HBQ")
    if not 0 < kind <= len(_KINDS) or axes > _MOST_AXES:
        raise DataError(path, f"numbers of a known kind in {name!r}", f"kind {kind} with {axes} axes")
    return _Field(name, np.dtype(_KINDS[kind - 1]), _unpack(path, file, f"<{axes}Q"), offset)


def _unpack(path: AnyPath, file: BinaryIO, layout: str) -> tuple[int, ...]:
    data = file.read(struct.calcsize(layout))
    if len(data) < struct.calcsize(layout):
        raise DataError(path, "a whole header", "the end of the file inside it")
    return struct.unpack(layout, data)


def _read_array(path: AnyPath, file: BinaryIO, field: _Field) -> np.ndarray:
    file.seek(field.offset)
    data = file.read(field.end - field.offset)
    if len(data) < field.end - field.offset:
        raise DataError(path, f"all of {field.name}", "the end of the file inside it")
    return np.frombuffer(data, field.dtype).reshape(field.shape)


def _dotted(version: tuple[int, int]) -> str:
    return ".".join(map(str, version))
