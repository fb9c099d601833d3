"""ASTM E1392 text files as Light Tec's Mini-Diff writes them (.astm): reflectance at scattered pairs.

Lines of a keyword and its value, the last of them VARS with the names of the columns; then lines of numbers
between commas: θ_i, φ_i, θ_s, φ_s in radians and the reflectance in 1/sr at each wavelength, "465nm". The
mirror direction has φ_s = φ_i + π. The instrument leaves the name phi_s out, but not its column.
"""

import re

from data_loaders.errors import DataError
from data_loaders.files import AnyPath, is_text
from data_loaders.numbers import excerpt, micrometres, open_lines, read_numbers, samples, whole
from jaxbrdf import MeasuredSamples

_ANGLES = ["theta_i", "phi_i", "theta_s", "phi_s"]
_WAVELENGTH = re.compile(r"([0-9]{1,9}(?:\.[0-9]*)?) ?nm")


def read_minidiff(path: AnyPath) -> MeasuredSamples:
    """The samples of a Mini-Diff file; `origin` holds the lines of its header.

    The instrument's signal falls off beyond 70 to 75° whatever the surface; that is left as it is. Raises
    DataError where the file cannot be read, is cut short, or holds what is no number or no angle.
    """
    with open_lines(path) as lines:
        header = lines.header(lambda line: line.strip()[:1].isalpha() and not line.startswith("VARS"))
        names = next(lines, "nothing")
        channels = _channels(path, names)
        rows = read_numbers(lines, len(_ANGLES) + len(channels), delimiter=",")
    _check_count(path, header, len(rows))
    theta_i, phi_i, theta_s, phi_s = rows[:, :4].T
    angles = (theta_i, phi_i, theta_s, phi_s)
    origin = [line.strip() for line in [*header, names]]
    return samples(path, angles, rows[:, 4:], wavelengths=micrometres(path, channels), origin=origin)


def is_minidiff(head: bytes) -> bool:
    """Whether a file that begins with `head` is one of the Mini-Diff's: keywords, and VARS among them."""
    return is_text(head) and re.search(rb"\A[A-Z](?s:.*)^VARS[ \t]+theta_i,", head, re.MULTILINE) is not None


def _channels(path: AnyPath, names: str) -> list[float]:
    """The wavelengths, in nanometres, of the columns that are no angles."""
    keyword, listed = [*names.split(maxsplit=1), "", ""][:2]
    columns = [name.strip() for name in listed.split(",")]
    angles = [name for name in columns if not _WAVELENGTH.fullmatch(name)]
    if (
        keyword != "VARS"
        or angles not in (_ANGLES, _ANGLES[:3])
        or columns[: len(angles)] != angles
        or columns == angles
    ):
        expected = f"the line VARS {','.join(_ANGLES)} and wavelengths, as 465nm"
        raise DataError(path, expected, excerpt(names))
    return [float(name.removesuffix("nm")) for name in columns[len(angles) :]]


def _check_count(path: AnyPath, header: list[str], rows: int) -> None:
    for line in header:
        keyword, announced = [*line.split(maxsplit=1), ""][:2]
        if keyword == "NUM_POINTS" and whole(announced.strip()) != rows:
            raise DataError(path, f"as many rows as NUM_POINTS says, {excerpt(announced)}", f"{rows}")
