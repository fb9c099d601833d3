"""What the text formats share: lines, a block of numbers, and the record made of them, both ways.

What a line means is the business of each format. Everything that is read goes through `Lines` and
`read_numbers`, everything that comes of it through `samples`, everything that is written through
`check_writable` and `write_numbers`, so that what is written can be read again.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from data_loaders.errors import DataError
from data_loaders.files import AnyPath, read_head, replacing, system_errors
from jaxbrdf import MeasuredSamples

Angles = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # θ_i, φ_i, θ_o, φ_o, each (N,), radians

_ROUNDING = 1e-4  # radians by which a printed θ may lie outside [0, π/2]
_MOST_PHI = 4 * np.pi  # radians; instruments count beyond a turn, but not far
_LONGEST_LINE = 2**24  # bytes
_MOST_HEADER_LINES = 10_000
_MOST_COLUMNS = 10_000
_LINE_BREAK = re.compile(r"\r\n|\r|\n")
_BLOCK = 2**15  # rows that are formatted at a time


class Lines(Iterator[str]):
    """The lines of a text file but the blank ones, without their ends, in UTF-8 or else Latin-1.

    `number` is the number in the file of the last line given, `last` that line. Raises DataError for a line
    of more than 16 MiB.
    """

    def __init__(self, path: AnyPath, file: BinaryIO):
        self.path, self.number, self.last = path, 0, ""
        self._read, self._held = self._lines(file), False

    def __next__(self) -> str:
        if self._held:
            self._held = False
            return self.last
        return next(self._read)

    def rest(self) -> Iterator[str]:
        """All that is left, without the cost of a call for each line."""
        if self._held:
            self._held = False
            yield self.last
        yield from self._read

    def _lines(self, file: BinaryIO) -> Iterator[str]:
        while raw := file.readline(_LONGEST_LINE + 1):
            self.number += 1
            if len(raw) > _LONGEST_LINE:
                raise DataError(self.path, f"lines of at most {_LONGEST_LINE} bytes", "a longer one")
            if not raw.isspace():
                try:
                    self.last = raw.decode("utf-8-sig").rstrip("\r\n")
                except UnicodeDecodeError:
                    self.last = raw.decode("latin-1").rstrip("\r\n")
                yield self.last

    def hold(self) -> None:
        """The last line will be given once more."""
        self._held = True

    def header(self, belongs: Callable[[str], bool]) -> list[str]:
        """The lines up to the first that does not belong. Raises DataError for more than 10 000 of them."""
        header: list[str] = []
        for line in self:
            if not belongs(line):
                self.hold()
                break
            header.append(line)
            if len(header) > _MOST_HEADER_LINES:
                raise DataError(self.path, f"a header of at most {_MOST_HEADER_LINES} lines", "more")
        return header


@contextmanager
def open_lines(path: AnyPath) -> Iterator[Lines]:
    """The lines of a file. Raises DataError where it is no regular file or cannot be read."""
    read_head(path)  # a pipe must not be opened, it could be waited for without end
    with system_errors(path), open(path, "rb") as file:
        yield Lines(path, file)


def read_numbers(lines: Lines, columns: int, delimiter: str | None = None) -> np.ndarray:
    """The numbers in the lines that are left, (rows, columns), `#` and what follows it left out.

    `delimiter` is white space unless given. Raises DataError for anything that is not a finite number, for
    another count of columns, and for no rows at all.
    """
    expected = f"rows of {columns} numbers"
    check_columns(lines.path, columns)
    found = columns_ahead(lines, delimiter)
    if found != columns:  # said before the whole file is read in vain
        raise DataError(lines.path, expected, _in_line(lines, f"{found}") if found else "none")
    try:
        rows = np.loadtxt(lines.rest(), comments="#", delimiter=delimiter, ndmin=2)
    except ValueError as error:
        found = _count(lines.last, delimiter)
        what = f"{found}" if found != columns else "something else"
        raise DataError(lines.path, expected, _in_line(lines, what)) from error
    return _finite(lines.path, rows)


def columns_ahead(lines: Lines, delimiter: str | None = None) -> int:
    """How many columns the next line has that is no comment; 0 where there is none."""
    lines.header(lambda line: line.lstrip().startswith("#"))
    line = next(lines, None)
    if line is None:
        return 0
    lines.hold()
    return _count(line, delimiter)


def samples(
    path: AnyPath,
    angles: Angles,
    values: np.ndarray,
    *,
    weights: np.ndarray | None = None,
    wavelengths: np.ndarray | None = None,
    name: str | None = None,
    origin: Iterable[str] = (),
    below: bool = False,
) -> MeasuredSamples:
    """The record of what was read. `weights` are 1 and `name` is that of the file unless they are given.

    Raises DataError for a θ outside [0, π/2], unless directions may lie `below` the horizon, for a φ beyond
    two turns, and where no value is a reflectance.
    """
    for end, theta, phi in (("i", *angles[:2]), ("o", *angles[2:])):
        check_angles(path, f"theta_{end}", theta, np.pi if below else np.pi / 2)
        check_angles(path, f"phi_{end}", np.abs(phi), _MOST_PHI)
    check_any_valid(path, values)
    return MeasuredSamples(
        *angles,
        values=values,
        weights=np.ones(len(values)) if weights is None else weights,
        wavelengths=wavelengths,
        name=Path(path).stem if name is None else name,
        origin=tuple(origin),
    )


def check_columns(path: AnyPath, columns: int) -> None:
    """Raises DataError for more columns than any instrument gives."""
    if columns > _MOST_COLUMNS:
        raise DataError(path, f"at most {_MOST_COLUMNS} columns", f"{columns}")


def check_angles(path: AnyPath, name: str, angles: np.ndarray, most: float = np.pi / 2) -> None:
    """Raises DataError for an angle outside [0, `most`], in radians and up to rounding."""
    if _outside(angles, most):
        degrees = " (degrees?)" if np.pi < angles.max() <= 360 else ""
        raise DataError(
            path,
            f"{name} in radians, at most {most:.6g}",
            f"angles from {angles.min():.6g} to {angles.max():.6g}{degrees}",
        )


def check_any_valid(path: AnyPath, values: np.ndarray) -> None:
    """Raises DataError where no value is a reflectance."""
    if not (values >= 0).any():
        raise DataError(path, "reflectances (≥ 0)", f"none: all {values.size} values are negative")


def micrometres(path: AnyPath, nanometres: Sequence[float] | np.ndarray) -> np.ndarray:
    """Wavelengths in µm. Raises DataError unless they are wavelengths of light in nanometres."""
    wavelengths = np.asarray(nanometres, dtype=float)
    if not ((wavelengths >= 100) & (wavelengths <= 100_000)).all():  # so for NaN too
        raise DataError(path, "wavelengths of light in nanometres", f"{few(wavelengths)}")
    return wavelengths / 1000


def whole(text: str) -> int | None:
    """The natural number that a text is, None where it is none or has more than 15 digits."""
    return int(text) if re.fullmatch(r"[0-9]{1,15}", text) else None


def few(numbers: np.ndarray) -> str:
    """Some of the numbers, for a message."""
    return ", ".join(f"{x:.6g}" for x in numbers[:5]) + (", …" if len(numbers) > 5 else "")


def excerpt(line: str) -> str:
    """The beginning of a line, for a message."""
    return repr(line.strip()[:40])


def uncommented(line: str) -> str:
    """The text of a line that begins with `#`, without that and the space after it."""
    return line[1:].removeprefix(" ")


def commented(texts: Iterable[str]) -> list[str]:
    """Lines of comment that `uncommented` takes back; a text of several lines becomes several."""
    return [f"# {line}" for text in texts for line in _LINE_BREAK.split(text)]


def one_line(text: str) -> str:
    """The text with spaces for its line breaks."""
    return _LINE_BREAK.sub(" ", text)


def check_writable(measured: MeasuredSamples) -> None:
    """Raises ValueError for a record that could be written, but never read again."""
    angles = (measured.theta_i, measured.theta_o)
    faults = {
        "no sample": measured.values.size == 0,
        "NaN or infinity": not all(np.isfinite(x).all() for x in _arrays(measured)),
        "no value ≥ 0": not (measured.values >= 0).any(),
        "weights below 0": (measured.weights < 0).any(),
        "wavelengths ≤ 0": measured.wavelengths is not None and (measured.wavelengths <= 0).any(),
        "directions below the horizon": any(_outside(theta, np.pi / 2) for theta in angles),
        "azimuths beyond two turns": (np.abs([measured.phi_i, measured.phi_o]) > _MOST_PHI).any(),
    }
    for fault, found in faults.items():
        if found:
            raise ValueError(f"a text file cannot hold this record, it has {fault}: leave that out first")


def write_numbers(path: AnyPath, header: list[str], columns: list[np.ndarray], separator: str) -> None:
    """Writes the header, then a line for each row of the columns, in the shortest digits that are exact.

    The file appears complete or not at all. Raises ValueError for a header that could not be read again,
    DataError where `path` cannot be written.
    """
    if len(columns) > _MOST_COLUMNS:
        raise ValueError(f"a text file has at most {_MOST_COLUMNS} columns, this record {len(columns)}")
    if len(header) > _MOST_HEADER_LINES or max(len(line.encode()) for line in header) >= _LONGEST_LINE:
        raise ValueError(f"a header has at most {_MOST_HEADER_LINES} lines of {_LONGEST_LINE} bytes")
    with replacing(path) as temporary, open(temporary, "x", encoding="utf-8", newline="\n") as file:
        file.writelines(f"{line}\n" for line in header)
        for start in range(0, len(columns[0]), _BLOCK):
            # repr of Python's own floats is the shortest text that reads back as the same bits
            texts = [map(repr, column[start : start + _BLOCK].tolist()) for column in columns]
            file.write("\n".join(map(separator.join, zip(*texts, strict=True))) + "\n")


def _in_line(lines: Lines, what: str) -> str:
    return f"{what} in line {lines.number}: {excerpt(lines.last)}"


def _count(line: str, delimiter: str | None) -> int:
    return len(line.partition("#")[0].split(delimiter))


def _finite(path: AnyPath, rows: np.ndarray) -> np.ndarray:
    finite = np.isfinite(rows)
    if not finite.all():
        row, column = np.unravel_index(np.argmin(finite), rows.shape)
        raise DataError(path, "finite numbers", f"{rows[row, column]} in row {row + 1}, column {column + 1}")
    return rows


def _outside(angles: np.ndarray, most: float) -> bool:
    return bool(angles.size) and not (angles.min() >= -_ROUNDING and angles.max() <= most + _ROUNDING)


def _arrays(measured: MeasuredSamples) -> list[np.ndarray]:
    names = ("theta_i", "phi_i", "theta_o", "phi_o", "values", "weights", "wavelengths")
    return [x for name in names if (x := getattr(measured, name)) is not None]
