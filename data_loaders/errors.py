"""The error of every reader: which file, what was expected of it, and what was found."""

import os
from pathlib import Path


class DataError(Exception):
    """A file that cannot be used. `path` is the file, `expected` and `found` say why, in words.

    `str` is one line, "PATH: expected ..., found ...", fit to be shown as it is.
    """

    def __init__(self, path: str | os.PathLike[str], expected: str, found: str):
        super().__init__(path, expected, found)
        self.path = Path(path)
        self.expected = expected
        self.found = found

    def __str__(self) -> str:
        return f"{self.path}: expected {self.expected}, found {self.found}"
