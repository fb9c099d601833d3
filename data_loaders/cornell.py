"""Text files of Cornell's gonioreflectometer (.brdf): isotropic spectral reflectance at scattered pairs.

The number of wavelengths, the wavelengths in nanometres, then on each line θ_i φ_i θ_s φ_s in radians and
the reflectance in 1/sr at each wavelength; `#` begins a comment. The mirror direction has φ_s = φ_i + π.
"""

import re

import numpy as np

from data_loaders.errors import DataError
from data_loaders.files import AnyPath, is_text
from data_loaders.numbers import (
    Lines,
    excerpt,
    micrometres,
    open_lines,
    read_numbers,
    samples,
    uncommented,
    whole,
)
from jaxbrdf import MeasuredSamples

_MOST_WAVELENGTHS = 10_000


def read_cornell(path: AnyPath) -> MeasuredSamples:
    """The samples of a Cornell file; `origin` holds the comments before its first number.

    Raises DataError where the file cannot be read, is cut short in its header or within a line, or holds
    what is no number or no angle.
    """
    with open_lines(path) as lines:
        comments = [uncommented(line.lstrip()).strip() for line in lines.header(_is_comment)]
        wavelengths = _wavelengths(lines, _number_of_wavelengths(lines))
        rows = read_numbers(lines, 4 + len(wavelengths))
    theta_i, phi_i, theta_s, phi_s = rows[:, :4].T
    origin = [text for text in comments if text]
    angles = (theta_i, phi_i, theta_s, phi_s)
    return samples(path, angles, rows[:, 4:], wavelengths=wavelengths, origin=origin)


def is_cornell(head: bytes) -> bool:
    """Whether a file that begins with `head` is one of Cornell's: a count alone, then numbers only."""
    if not is_text(head):
        return False
    lines = [text for line in head.splitlines() if (text := line.partition(b"#")[0].strip())]
    return (
        len(lines) > 1
        and re.fullmatch(rb"\d{1,5}", lines[0]) is not None
        and re.fullmatch(rb"[\d.]+([ \t]+[\d.]+)*", lines[1]) is not None
    )


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith("#")


def _number_of_wavelengths(lines: Lines) -> int:
    line = next(lines, "").partition("#")[0].strip()
    count = whole(line)
    if count is None:
        found = excerpt(line) if line else "nothing"
        raise DataError(lines.path, "the number of wavelengths on a line of its own", found)
    if not 0 < count <= _MOST_WAVELENGTHS:
        raise DataError(lines.path, f"1 to {_MOST_WAVELENGTHS} wavelengths", f"{count}")
    return count


def _wavelengths(lines: Lines, count: int) -> np.ndarray:
    """The wavelengths in µm, which may take several lines."""
    words: list[str] = []
    while len(words) < count:
        line = next(lines, None)
        if line is None:
            raise DataError(lines.path, f"{count} wavelengths", f"{len(words)}, and the end of the file")
        words += line.partition("#")[0].split()
    if len(words) > count:
        raise DataError(lines.path, f"{count} wavelengths", f"{len(words)}")
    try:
        nanometres = [float(word) for word in words]
    except ValueError as error:
        raise DataError(lines.path, f"{count} wavelengths", excerpt(" ".join(words))) from error
    return micrometres(lines.path, nanometres)
