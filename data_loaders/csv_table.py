"""Tables of goniometers (.csv): a line of column names, then a line of numbers for each pair of directions.

    theta_i, phi_i, theta_o, phi_o     in any order; s, r or v may stand for o, phi_i may be absent (0)
    weight                             how much the pair counts, 1 where there is no such column
    465nm, 0.465um, R, G, B, …         the reflectance in 1/sr, each channel a column

An angle is in radians, unless its column says otherwise: theta_i_deg, "theta_i [deg]". Commas, semicolons or
tabs part the columns, a point the decimals; `#` begins a comment.
"""

import csv
import re
from typing import NamedTuple

import numpy as np

from data_loaders.errors import DataError
from data_loaders.files import AnyPath, is_text
from data_loaders.numbers import (
    Angles,
    check_angles,
    check_columns,
    check_writable,
    commented,
    excerpt,
    few,
    micrometres,
    one_line,
    open_lines,
    read_numbers,
    samples,
    uncommented,
    write_numbers,
)
from jaxbrdf import MeasuredSamples

_DELIMITERS = ",;\t"
_NAME = "name: "  # begins the first comment of the files written here
_ANGLE = re.compile(r"(theta|phi)_?([iosrv])[ _]?[(\[]?(deg|degrees?|°|rad|radians?)?[)\]]?", re.IGNORECASE)
_WAVELENGTH = re.compile(r"([0-9]+(?:\.[0-9]*)?(?:e[-+]?[0-9]+)?) ?(nm|[uµμ]m)", re.IGNORECASE)
_PLAIN = re.compile(r"[rgb]|value(_[0-9]+)?", re.IGNORECASE)  # names of channels that tell nothing more


def read_csv(path: AnyPath) -> MeasuredSamples:
    """The samples of a table. `origin` holds the comments before the names, and the names of odd channels.

    `name` is that of a first comment "name: …", or else the file's. Channels R, G and B come in this order.
    Raises DataError where the file cannot be read or is cut short within a line, names no angles or no
    channel, or holds what is no finite number or no angle in its unit.
    """
    with open_lines(path) as lines:
        comments = [uncommented(line) for line in lines.header(lambda line: line.startswith("#"))]
        header = next(lines, "")
        delimiter = _delimiter(header)
        check_columns(path, header.count(delimiter) + 1)
        columns = _columns(path, header, _names(header, delimiter))
        rows = read_numbers(lines, len(columns.names), delimiter)
    name = comments.pop(0).removeprefix(_NAME) if comments and comments[0].startswith(_NAME) else None
    return samples(
        path,
        _angles(path, columns, rows),
        rows[:, columns.channels],
        weights=_weights(path, columns, rows),
        wavelengths=columns.wavelengths,
        name=name,
        origin=[*comments, *columns.note],
    )


def write_csv(path: AnyPath, measured: MeasuredSamples) -> None:
    """Writes samples as a table in radians, with commas: `read_csv` gives them back bit for bit.

    The channels are called by their wavelengths in µm, else R, G, B if there are three, else value_0 and so
    on; there are weights only if they are not all 1. `name` and `origin` become comments; line breaks within
    them are not kept. The file appears complete or not at all. Raises ValueError for what could not be read
    again (NaN, no value ≥ 0, a direction below the horizon), DataError where `path` cannot be written.
    """
    check_writable(measured)
    columns = {
        "theta_i": measured.theta_i,
        "phi_i": measured.phi_i,
        "theta_o": measured.theta_o,
        "phi_o": measured.phi_o,
    }
    if (measured.weights != 1).any():
        columns["weight"] = measured.weights
    names = [*columns, *_channel_names(measured)]
    comments = commented([_NAME + one_line(measured.name), *measured.origin])
    write_numbers(path, [*comments, ",".join(names)], [*columns.values(), *measured.values.T], ",")


def is_csv(head: bytes) -> bool:
    """Whether a file that begins with `head` is such a table: two angles are named before any number."""
    if not is_text(head):
        return False
    lines = [line for line in head.decode("utf-8-sig", "replace").splitlines() if line.strip()]
    header = next((line for line in lines if not line.startswith("#")), "")
    angles = {_angle(name) for name in _names(header, _delimiter(header))}
    return {"theta_i", "theta_o"} <= {name for name, _ in filter(None, angles)}


class _Columns(NamedTuple):
    names: list[str]
    angles: dict[str, tuple[int, bool]]  # theta_i, phi_i, theta_o, phi_o: the column, and whether in degrees
    weight: int | None
    channels: list[int]
    wavelengths: np.ndarray | None
    note: list[str]


def _delimiter(header: str) -> str:
    return max(_DELIMITERS, key=header.count)


def _names(header: str, delimiter: str) -> list[str]:
    try:
        return [name.strip() for name in next(csv.reader([header], delimiter=delimiter), [])]
    except csv.Error:  # the line is no table's, which is said where the names are missed
        return []


def _columns(path: AnyPath, header: str, names: list[str]) -> _Columns:
    """What the names mean. Raises DataError where a column is missing or there twice."""
    angles: dict[str, tuple[int, bool]] = {}
    weights, channels = [], []
    for column, name in enumerate(names):
        if angle := _angle(name):
            if angle[0] in angles:
                raise DataError(path, f"one column {angle[0]}", f"two in {excerpt(header)}")
            angles[angle[0]] = column, angle[1]
        elif name.lower() in ("weight", "weights"):
            weights.append(column)
        else:
            channels.append(column)
    _check_columns(path, header, list(angles), len(weights), [names[column] for column in channels])
    channels = _rgb_first(names, channels)
    wavelengths = _wavelengths(path, [names[column] for column in channels])
    odd = [] if wavelengths is not None else [names[c] for c in channels if not _PLAIN.fullmatch(names[c])]
    note = [f"channels: {', '.join(odd)}"] if odd else []
    return _Columns(names, angles, weights[0] if weights else None, channels, wavelengths, note)


def _angle(name: str) -> tuple[str, bool] | None:
    """The name in the record of a column that holds an angle, and whether it is in degrees."""
    found = _ANGLE.fullmatch(name)
    if not found:
        return None
    end = "i" if found[2].lower() == "i" else "o"
    return f"{found[1].lower()}_{end}", (found[3] or "rad").lower()[0] in "d°"


def _check_columns(path: AnyPath, header: str, angles: list[str], weights: int, channels: list[str]) -> None:
    for name in ("theta_i", "theta_o", "phi_o"):
        if name not in angles:
            raise DataError(path, f"a line of column names, {name} among them", excerpt(header) or "none")
    unknown = [name for name in channels if not name or name.lower().startswith(("theta", "phi"))]
    if unknown:  # rather than taken for a reflectance
        raise DataError(path, "columns theta_i, phi_i, theta_o, phi_o, weight and channels", repr(unknown[0]))
    if weights > 1 or not channels:
        found = f"{weights} and {len(channels)} in {excerpt(header)}"
        raise DataError(path, "at most one column of weights, at least one channel", found)


def _rgb_first(names: list[str], channels: list[int]) -> list[int]:
    """The channels, in the order R, G, B if that is what they are."""
    rgb = {names[column].lower(): column for column in channels}
    return [rgb[c] for c in "rgb"] if len(channels) == 3 and rgb.keys() == set("rgb") else channels


def _wavelengths(path: AnyPath, channels: list[str]) -> np.ndarray | None:
    """The wavelengths of all channels in µm, None where they have none."""
    found = [_WAVELENGTH.fullmatch(name) for name in channels]
    if not any(found):
        return None
    wavelengths = [_micrometres(path, *match.groups()) for match in found if match]
    if len(wavelengths) < len(channels):
        other = next(name for name, match in zip(channels, found, strict=True) if not match)
        raise DataError(path, "a wavelength for every channel, or for none", excerpt(other))
    return np.array(wavelengths)


def _micrometres(path: AnyPath, number: str, unit: str) -> float:
    wavelength = float(number)
    if unit.lower() == "nm":
        return float(micrometres(path, [wavelength])[0])
    if not 0 < wavelength < np.inf:
        raise DataError(path, "wavelengths above 0", excerpt(number + unit))
    return wavelength


def _angles(path: AnyPath, columns: _Columns, rows: np.ndarray) -> Angles:
    def angle(name: str) -> np.ndarray:
        if name not in columns.angles:
            return np.zeros(len(rows))
        column, degrees = columns.angles[name]
        if degrees:
            return np.radians(rows[:, column])
        if name.startswith("theta"):  # with a hint that `samples` cannot give
            check_angles(path, f"{name} (or call it {name}_deg)", rows[:, column])
        return rows[:, column]

    return angle("theta_i"), angle("phi_i"), angle("theta_o"), angle("phi_o")


def _weights(path: AnyPath, columns: _Columns, rows: np.ndarray) -> np.ndarray | None:
    if columns.weight is None:
        return None
    weights = rows[:, columns.weight]
    if weights.min() < 0:
        raise DataError(path, "weights ≥ 0", few(weights[weights < 0]))
    return weights


def _channel_names(measured: MeasuredSamples) -> list[str]:
    channels = measured.values.shape[1]
    if measured.wavelengths is not None:
        return [f"{wavelength!r}um" for wavelength in measured.wavelengths.tolist()]
    if channels == 3:
        return ["R", "G", "B"]
    return ["value"] if channels == 1 else [f"value_{k}" for k in range(channels)]
