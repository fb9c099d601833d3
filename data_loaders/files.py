"""What every format needs of the file system: the first bytes of a file, and writing all of it or nothing."""

import os
import re
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from data_loaders.errors import DataError

AnyPath = str | os.PathLike[str]

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_CONTROL = re.compile(rb"[^\t\n\f\r\x20-\x7e\x80-\xff]")


@contextmanager
def system_errors(path: AnyPath, expected: str = "a file that can be read") -> Iterator[None]:
    """Turns the operating system's errors inside the block into a DataError about `path`."""
    try:
        yield
    except OSError as error:
        raise DataError(path, expected, f"the error “{error.strerror or str(error)}”") from error


def read_head(path: AnyPath, count: int = 64) -> bytes:
    """The first `count` bytes. Raises DataError where `path` is no regular file or cannot be read."""
    with system_errors(path):
        mode = os.stat(path).st_mode
        if not stat.S_ISREG(mode):
            raise DataError(path, "a file", "a folder" if stat.S_ISDIR(mode) else "a device or pipe")
        with open(path, "rb") as file:
            return file.read(count)


def describe(head: bytes) -> str:
    """What a file beginning with `head` seems to be, in words for the `found` of a DataError."""
    if not head:
        return "an empty file"
    if head.startswith(HDF5_MAGIC):
        return "an HDF5 file"
    if is_text(head):
        line = head.decode("utf-8", "replace").strip().partition("\n")[0]
        return f"a text file beginning {line[:40]!r}"
    return f"a binary file beginning with the bytes {head[:12].hex(' ')}"


def is_text(head: bytes) -> bool:
    """Whether bytes look like text: no control characters but white space (ASCII, Latin-1, UTF-8)."""
    return bool(head) and not _CONTROL.search(head)


@contextmanager
def replacing(path: AnyPath) -> Iterator[Path]:
    """A temporary path beside `path`, to write to; it takes the place of `path` when the block ends well.

    Nobody ever sees half a file: the old one stays until the new one is complete and on the disk, and
    stays for good if the block raises; the temporary file is then removed. Errors of the operating
    system become DataErrors about `path`.
    """
    target = Path(os.path.realpath(path))  # the file behind a link is replaced, not the link
    temporary = target.with_name(f".jaxbrdf-{secrets.token_hex(8)}.tmp")
    with system_errors(path, "a place that can be written"):
        try:
            yield temporary
            with open(temporary, "rb+") as file:
                os.fsync(file.fileno())
            os.replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
