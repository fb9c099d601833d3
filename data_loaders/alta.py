r"""ALTA's text files (.alta, .dat): reflectance over one of the parameterisations of that library.

    #DIM N P               N numbers say where, P numbers what
    #PARAM_IN NAME         what the N are
    #PARAM_OUT NAME        what the P are
    #VS 0, 1 or 2          for each of the P a further column, half the width of its interval, or two, its
                           least and its greatest; once for each of the P, or once (for all, or the first)

`#` and a letter begin such a line, `#` and a space a comment. Then come rows of N, P and those further
numbers. All angles are in radians, and (0, 0, 1) is the normal. ALTA: Belcour, Courtes, Pacanowski et al.
2013-2017, https://github.com/belcour/alta, whose params.cpp says what the names mean. Its pairs are view and
light, in this order: the difference vector of the half-angle parameterisations is the view's.
"""

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from data_loaders.errors import DataError
from data_loaders.files import AnyPath
from data_loaders.numbers import (
    Angles,
    Lines,
    check_angles,
    check_writable,
    columns_ahead,
    commented,
    excerpt,
    few,
    one_line,
    open_lines,
    read_numbers,
    samples,
    uncommented,
    whole,
    write_numbers,
)
from jaxbrdf import MeasuredSamples

_LEAST_COSINE = 1e-4  # nearer to the horizon than this, a value over cos θ tells nothing
_UNIT = 1e-3  # by which a printed vector may be longer or shorter than 1
_ROUNDING = 1e-6  # by which a printed cosine, or the square of a length, may exceed 1
_HALF_TURN = np.array([[-1.0], [-1.0], [1.0]])  # about z
_OURS = "WAVELENGTHS_UM"  # a key of this package: the wavelengths of the P values, in µm
_UNDERSTOOD = {"DIM", "PARAM_IN", "PARAM_OUT", "VS", "SAMPLE", "FORMAT", _OURS}
# X, Y, Z of 1 to linear sRGB, IEC 61966-2-1
_SRGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])


def read_alta(path: AnyPath) -> MeasuredSamples:
    """The samples of an ALTA file in text.

    The name is that of `#SAMPLE`, or else the file's; `origin` holds the comments, the keys that are not
    understood, and what was taken for granted. Where the intervals of the values have widths, the weights
    are 1 / width², of mean 1. Parameterisations of fewer than four numbers are put in the place that ALTA
    puts them, and pairs of which one direction lies below the horizon stay in the record, not valid.

    Raises DataError where the file cannot be read, is binary, cut short or in a parameterisation that does
    not fix a pair of directions, or holds what is no finite number or no direction.
    """
    with open_lines(path) as lines:
        header = _header(lines)
        rows = read_numbers(lines, _columns(lines, header))
    inputs, values = rows[:, : header.n], rows[:, header.n :][:, : header.p]
    angles = _angles(path, header.param_in, inputs)
    values, note = _reflectance(path, header.param_out, values, angles[2])
    return samples(
        path,
        angles,
        values,
        weights=_weights(header, rows[:, header.n + header.p :]),
        wavelengths=header.wavelengths,
        name=header.name,
        origin=[*header.origin, *note],
        below=_INPUTS[header.param_in].below,
    )


def write_alta(path: AnyPath, measured: MeasuredSamples) -> None:
    """Writes samples as an ALTA file, in SPHERICAL_TL_PL_TV_PV: `read_alta` gives them back bit for bit.

    RGB_COLOR for three channels without wavelengths, INV_STERADIAN for all others; the wavelengths stand in
    a line `#WAVELENGTHS_UM`, which ALTA passes over. `name` becomes `#SAMPLE`, `origin` lines of comment;
    line breaks within them are not kept. The file appears complete or not at all.

    Raises ValueError for weights other than 1, which the format has no exact place for, and for what could
    not be read again (NaN, no value ≥ 0, a direction below the horizon); DataError where `path` cannot be
    written.
    """
    check_writable(measured)
    if (measured.weights != 1).any():
        raise ValueError("an ALTA file does not keep weights: write CSV or HDF5, or set them to 1")
    channels = measured.values.shape[1]
    rgb = channels == 3 and measured.wavelengths is None
    header = [
        f'#SAMPLE "{one_line(measured.name)}"',
        *commented(measured.origin),
        f"#DIM 4 {channels}",
        "#PARAM_IN SPHERICAL_TL_PL_TV_PV",
        f"#PARAM_OUT {'RGB_COLOR' if rgb else 'INV_STERADIAN'}",
        "#VS 0",
    ]
    if measured.wavelengths is not None:
        header.append(f"#{_OURS} {' '.join(map(repr, measured.wavelengths.tolist()))}")
    angles = [measured.theta_i, measured.phi_i, measured.theta_o, measured.phi_o]
    write_numbers(path, header, [*angles, *measured.values.T], " ")


def is_alta(head: bytes) -> bool:
    """Whether a file that begins with `head` is one of ALTA's, in text or binary."""
    comments = re.match(rb"(?:#[^\n]*(?:\n|\Z)|[ \t\r]*\n)*", head)
    return comments is not None and re.search(rb"(?m)^#(DIM|PARAM_IN)[ \t]", comments[0]) is not None


# The header


class _Header(NamedTuple):
    n: int
    p: int
    param_in: str
    param_out: str
    intervals: tuple[int, ...]  # as many as the file says: one for each output, or fewer
    wavelengths: np.ndarray | None
    name: str | None
    origin: list[str]


def _header(lines: Lines) -> _Header:
    keys, origin = _keys(lines)
    if keys.get("FORMAT", "").strip().lower() == "binary":
        raise DataError(lines.path, "an ALTA file in text", "#FORMAT binary: let ALTA convert it")
    n, p = _dimensions(lines, keys)
    return _Header(
        n,
        p,
        _param_in(lines, keys, n),
        _param_out(lines, keys, p),
        _intervals(lines, keys, p),
        _wavelengths(lines, keys, p),
        _unquoted(keys.get("SAMPLE")),
        origin,
    )


def _keys(lines: Lines) -> tuple[dict[str, str], list[str]]:
    """What the lines of the header say that are understood, and what the others do. #VS may be repeated."""
    keys: dict[str, str] = {}
    origin: list[str] = []
    for line in _header_lines(lines):
        key, value = [*line[1:].split(maxsplit=1), "", ""][:2]
        if not line[1:2].isalpha():
            origin += [] if line == "#" else [uncommented(line)]
        elif key in _UNDERSTOOD:
            keys[key] = f"{keys.get(key, '')} {value}" if key == "VS" else value
        elif not key.startswith("ALTA"):
            origin.append(line[1:])
    return keys, origin


def _header_lines(lines: Lines) -> list[str]:
    """The lines that begin with `#`, up to one that ends the header (which may also be left out)."""
    ended = False

    def belongs(line: str) -> bool:
        nonlocal ended
        was, ended = ended, ended or re.match(r"#ALTA\b.*\bEND\b", line.replace("_", " ")) is not None
        return line.startswith("#") and not was

    return lines.header(belongs)


def _dimensions(lines: Lines, keys: dict[str, str]) -> tuple[int, int]:
    numbers = [whole(word) for word in keys.get("DIM", "").split()]
    match numbers:
        case [int(n), int(p)] if n > 0 and p > 0:
            return n, p
    found = excerpt(keys["DIM"]) if "DIM" in keys else "no such line"
    raise DataError(lines.path, "#DIM and two whole numbers above 0", found)


def _param_in(lines: Lines, keys: dict[str, str], n: int) -> str:
    name = keys.get("PARAM_IN", "").strip()
    if name not in _INPUTS:
        raise DataError(
            lines.path,
            f"#PARAM_IN and one of {', '.join(_INPUTS)}",
            excerpt(name) if name else "none",
        )
    if n != _INPUTS[name].numbers:
        raise DataError(lines.path, f"#DIM {_INPUTS[name].numbers} …, as {name} has it", f"#DIM {n} …")
    return name


def _param_out(lines: Lines, keys: dict[str, str], p: int) -> str:
    name = keys.get("PARAM_OUT", "").strip()
    if name not in _OUTPUTS:
        known = ", ".join(filter(None, _OUTPUTS))
        raise DataError(lines.path, f"#PARAM_OUT and one of {known}", excerpt(name))
    if _OUTPUTS[name].channels not in (None, p):
        raise DataError(lines.path, f"{_OUTPUTS[name].channels} values, as {name} has it", f"#DIM … {p}")
    return name


def _intervals(lines: Lines, keys: dict[str, str], p: int) -> tuple[int, ...]:
    kinds = keys.get("VS", "").split()
    if len(kinds) > p or any(kind not in ("0", "1", "2") for kind in kinds):
        raise DataError(lines.path, f"#VS 0, 1 or 2, at most {p} of them", excerpt(keys["VS"]))
    return tuple(map(int, kinds))


def _wavelengths(lines: Lines, keys: dict[str, str], p: int) -> np.ndarray | None:
    if _OURS not in keys:
        return None
    words = keys[_OURS].split()
    try:
        wavelengths = np.array([float(word) for word in words])
    except ValueError as error:
        raise DataError(lines.path, f"wavelengths after #{_OURS}", excerpt(keys[_OURS])) from error
    if len(words) != p or not (np.isfinite(wavelengths) & (wavelengths > 0)).all():
        found = f"{len(words)}: {few(wavelengths)}"
        raise DataError(lines.path, f"{p} wavelengths above 0 after #{_OURS}", found)
    return wavelengths


def _unquoted(text: str | None) -> str | None:
    if text is None:
        return None
    quoted = re.fullmatch(r'\s*"(.*)"\s*', text)
    return quoted[1] if quoted else text.strip()


# The columns


def _columns(lines: Lines, header: _Header) -> int:
    """How many columns the rows have. One #VS for several values may mean all of them or the first."""
    sure = header.n + header.p + sum(header.intervals)
    if len(header.intervals) != 1 or header.p == 1:
        return sure
    everywhere = header.n + header.p + header.intervals[0] * header.p
    return everywhere if columns_ahead(lines) == everywhere else sure


def _weights(header: _Header, extra: np.ndarray) -> np.ndarray:
    """1 / width² of mean 1, the width averaged over the values that have one; 1 where one says nothing."""
    ones = np.ones(len(extra))
    if not extra.shape[1]:
        return ones
    kinds = header.intervals
    if extra.shape[1] > sum(kinds):  # one for all
        kinds = kinds * header.p
    with np.errstate(over="ignore"):
        width = _width(kinds, extra)
    if not (np.isfinite(width) & (width > 0)).all():
        return ones
    relative = (width.min() / width) ** 2  # of the narrowest: nothing overflows
    return relative / relative.mean()


def _width(kinds: tuple[int, ...], extra: np.ndarray) -> np.ndarray:
    columns = iter(extra.T)
    widths = [2 * next(columns) if kind == 1 else -next(columns) + next(columns) for kind in kinds if kind]
    return np.mean(widths, axis=0)


# What the outputs mean


class _Output(NamedTuple):
    channels: int | None  # None for any
    reflectance: Callable[[np.ndarray, np.ndarray], np.ndarray]  # of the values and cos θ_v
    note: tuple[str, ...] = ()


def _as_it_is(values: np.ndarray, cos: np.ndarray) -> np.ndarray:
    """1/sr."""
    return values


def _without_cosine(values: np.ndarray, cos: np.ndarray) -> np.ndarray:
    """From the reflectance times cos θ_v; −1, not valid, where that is nothing."""
    return np.where(cos > _LEAST_COSINE, values / np.maximum(cos, _LEAST_COSINE), -1.0)


def _srgb(values: np.ndarray, cos: np.ndarray) -> np.ndarray:
    """From XYZ; a colour outside sRGB has a channel below 0."""
    return values @ _SRGB.T


_TAKEN = ("PARAM_OUT is not said: taken for 1/sr",)
_OUTPUTS = {
    "INV_STERADIAN": _Output(None, _as_it_is),
    "INV_STERADIAN_COSINE_FACTOR": _Output(
        None, _without_cosine, ("PARAM_OUT was INV_STERADIAN_COSINE_FACTOR: divided by cos theta_o",)
    ),
    "RGB_COLOR": _Output(3, _as_it_is),
    "XYZ_COLOR": _Output(3, _srgb, ("PARAM_OUT was XYZ_COLOR: made linear sRGB",)),
    "UNKNOWN_OUTPUT": _Output(None, _as_it_is, _TAKEN),
    "": _Output(None, _as_it_is, _TAKEN),
}


def _reflectance(
    path: AnyPath, name: str, values: np.ndarray, theta_v: np.ndarray
) -> tuple[np.ndarray, tuple[str, ...]]:
    output = _OUTPUTS[name]
    with np.errstate(all="ignore"):
        values = output.reflectance(values, np.cos(theta_v)[:, None])
    if not np.isfinite(values).all():
        raise DataError(path, f"values of {name} that make a finite reflectance", "greater ones")
    return values, output.note


# What the inputs mean: each function takes the columns and gives θ_l, φ_l, θ_v, φ_v


class _Input(NamedTuple):
    numbers: int
    angles: Callable[..., Angles]
    polar: tuple[int, ...] = ()  # the columns that are angles θ, where they are not angles of the pair
    below: bool = False  # whether a direction may lie below the horizon


def _angles(path: AnyPath, name: str, inputs: np.ndarray) -> Angles:
    """The angles of the light and the view. Raises DataError where there are none."""
    parameterisation = _INPUTS[name]
    for column in parameterisation.polar:
        check_angles(path, f"column {column + 1} of {name}", inputs[:, column])
    with np.errstate(all="ignore"):  # what is none is said below
        angles = parameterisation.angles(*inputs.T)
    sound = np.isfinite(angles).all(axis=0)
    if not sound.all():
        row = int(np.argmin(sound))
        raise DataError(path, f"pairs of directions in {name}", f"none in row {row + 1}: {few(inputs[row])}")
    return angles


def _in_plane(theta: np.ndarray, phi: np.ndarray | float = 0.0) -> Angles:
    """Light and view in the same direction."""
    phi = np.broadcast_to(phi, theta.shape)
    return theta, phi, theta, phi


def _half_difference(theta_h, phi_h, theta_d, phi_d) -> Angles:
    """Rusinkiewicz 1998: the view at (θ_d, φ_d) about the half vector, the light opposite to it."""
    d = _vector(theta_d, phi_d)
    return _pair(_about(theta_h, phi_h, d * _HALF_TURN), _about(theta_h, phi_h, d))


def _cos_th(cos_h) -> Angles:
    return _in_plane(_arccos(cos_h))


def _cos_th_td(cos_h, cos_d) -> Angles:
    return _half_difference(_arccos(cos_h), 0.0, _arccos(cos_d), 0.0)


def _rusin_th_td(theta_h, theta_d) -> Angles:
    return _half_difference(theta_h, 0.0, theta_d, np.pi / 2)


def _rusin_th_ph_td(theta_h, phi_h, theta_d) -> Angles:
    return _half_difference(theta_h, phi_h, theta_d, 0.0)


def _rusin_th_td_pd(theta_h, theta_d, phi_d) -> Angles:
    return _half_difference(theta_h, 0.0, theta_d, phi_d)


def _rusin_vh(x, y, z) -> Angles:
    return _in_plane(*_polar(_unit(x, y, z)))


def _tv_tl_dphi(theta_v, theta_l, dphi) -> Angles:
    return theta_l, dphi, theta_v, np.zeros_like(theta_v)


def _tv_proj_dphi(x, y) -> Angles:
    return _tl_tv_proj_dphi(np.zeros_like(x), x, y)


def _tl_tv_proj_dphi(theta_l, x, y) -> Angles:
    return theta_l, np.zeros_like(theta_l), np.hypot(x, y), np.arctan2(y, x)


def _schlick(theta_l, x, y) -> Angles:
    """The view mirrors the reflected light at the back vector, which is at (|(x, y)|, φ) of the normal."""
    light = _vector(theta_l, 0.0)
    reflected, back = light * _HALF_TURN, _vector(np.hypot(x, y), np.arctan2(y, x))
    return _pair(light, 2 * (reflected * back).sum(axis=0) * back - reflected)


def _retro(theta_l, x, y) -> Angles:
    """The view is |(x, y)| from the light, in a direction that is φ from the one to the normal."""
    towards_normal = np.stack([-np.cos(theta_l), np.zeros_like(theta_l), np.sin(theta_l)])
    across = np.array([[0.0], [1.0], [0.0]])
    apart, phi, light = np.hypot(x, y), np.arctan2(y, x), _vector(theta_l, 0.0)
    aside = np.cos(phi) * towards_normal + np.sin(phi) * across
    return _pair(light, np.cos(apart) * light + np.sin(apart) * aside)


def _stark_2d(h, b) -> Angles:
    return _stark_3d(h, b, np.full_like(h, np.pi / 2))


def _stark_3d(h, b, phi) -> Angles:
    """H = (L + V)/2 with |(H_x, H_y)| = h; B = (L − V)/2 upright to H with |B| = b, azimuth φ from H's."""
    H = np.stack([h, np.zeros_like(h), _root(1 - h**2 - b**2)])
    theta_b = np.arctan2(H[2], -h * np.cos(phi))
    return _of_half_and_back(H, b * _vector(theta_b, phi))


def _neumann_2d(h, b) -> Angles:
    return _neumann_3d(h, b, np.full_like(h, np.pi / 2))


def _neumann_3d(h, b, phi) -> Angles:
    """The same of the projections onto the surface: |(H_x, H_y)| = h, |(B_x, B_y)| = b."""
    light, view = ((h + side * b * np.cos(phi), side * b * np.sin(phi)) for side in (1, -1))
    return _pair(*(np.stack([x, y, _root(1 - x**2 - y**2)]) for x, y in (light, view)))


def _spherical(theta_l, phi_l, theta_v, phi_v) -> Angles:
    return theta_l, phi_l, theta_v, phi_v


def _cartesian(vx, vy, vz, lx, ly, lz) -> Angles:
    return _pair(_unit(lx, ly, lz), _unit(vx, vy, vz))


_INPUTS = {
    "COS_TH": _Input(1, _cos_th),
    "COS_TH_TD": _Input(2, _cos_th_td, below=True),
    "RUSIN_TH_TD": _Input(2, _rusin_th_td, (0, 1), below=True),
    "RUSIN_TH_PH_TD": _Input(3, _rusin_th_ph_td, (0, 2), below=True),
    "RUSIN_TH_TD_PD": _Input(3, _rusin_th_td_pd, (0, 1), below=True),
    "RUSIN_TH_PH_TD_PD": _Input(4, _half_difference, (0, 2), below=True),
    "RUSIN_VH": _Input(3, _rusin_vh),
    "ISOTROPIC_TV_TL_DPHI": _Input(3, _tv_tl_dphi),
    "ISOTROPIC_TV_PROJ_DPHI": _Input(2, _tv_proj_dphi),
    "ISOTROPIC_TL_TV_PROJ_DPHI": _Input(3, _tl_tv_proj_dphi),
    "SCHLICK_TL_TK_PROJ_DPHI": _Input(3, _schlick, (0,), below=True),
    "RETRO_TL_TVL_PROJ_DPHI": _Input(3, _retro, (0,), below=True),
    "STARK_2D": _Input(2, _stark_2d, below=True),
    "STARK_3D": _Input(3, _stark_3d, below=True),
    "NEUMANN_2D": _Input(2, _neumann_2d),
    "NEUMANN_3D": _Input(3, _neumann_3d),
    "SPHERICAL_TL_PL_TV_PV": _Input(4, _spherical),
    "CARTESIAN": _Input(6, _cartesian, below=True),
}


# Vectors, (3, N)


def _vector(theta, phi) -> np.ndarray:
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def _about(theta_h, phi_h, d) -> np.ndarray:
    """The vector that is d where the half vector is the z axis: turned by θ_h about y, by φ_h about z."""
    x = np.cos(theta_h) * d[0] + np.sin(theta_h) * d[2]
    z = np.cos(theta_h) * d[2] - np.sin(theta_h) * d[0]
    return np.stack([np.cos(phi_h) * x - np.sin(phi_h) * d[1], np.sin(phi_h) * x + np.cos(phi_h) * d[1], z])


def _of_half_and_back(H: np.ndarray, B: np.ndarray) -> Angles:
    return _pair(H + B, H - B)


def _pair(light: np.ndarray, view: np.ndarray) -> Angles:
    return *_polar(light), *_polar(view)


def _polar(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y, z = vector
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)


def _unit(x, y, z) -> np.ndarray:
    """The vector, NaN where it is not of length 1. Its length does not matter for its angles."""
    vector = np.stack([x, y, z])
    length = np.sqrt((vector**2).sum(axis=0))
    return np.where(np.abs(length - 1) <= _UNIT, vector, np.nan)


def _arccos(cos) -> np.ndarray:
    """NaN beyond 1 and −1, but for rounding."""
    return np.arccos(np.where(np.abs(cos) <= 1 + _ROUNDING, np.clip(cos, -1, 1), np.nan))


def _root(square) -> np.ndarray:
    """NaN below 0, but for rounding."""
    return np.sqrt(np.where(square >= -_ROUNDING, np.maximum(square, 0.0), np.nan))
