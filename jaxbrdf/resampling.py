r"""One record of reflectance as another: scattered samples, a table over half and difference angles, or the
adaptive tables of the RGL database; and the error that makes.

Host code: numpy in and out, a model or a table being evaluated a block of pairs at a time.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt

from jaxbrdf import checks
from jaxbrdf.arrays import channel_count
from jaxbrdf.brdf.adaptive import AdaptiveBRDF
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.brdf.measured import MeasuredBRDF
from jaxbrdf.directions import from_half_difference, spherical, to_spherical
from jaxbrdf.quadrature import HalfDifferenceGrid, merl_grid
from jaxbrdf.samples import MeasuredSamples
from jaxbrdf.scattered import interpolate

Measurement = MeasuredSamples | MeasuredBRDF | AdaptiveBRDF
Reflectance = AbstractBRDF | MeasuredSamples
Directions = Float[np.ndarray, "... 3"]

_BLOCK = 1 << 16  # pairs evaluated at once
_COMPARED = 50_000  # pairs that `resampling_error` looks at
_GRAZING = np.radians(80)  # beyond, what is measured may be anything
_STEEPEST = 1.5707  # θ_i of a node: just above the horizon
_HORIZON = 1e-2  # cos θ of 89.4 degrees: nearer to the horizon f cos θ says nothing about f

# An adaptive table: incidences, azimuths, nodes of the values (a side), rows of normals
_INCIDENCES, _AZIMUTHS, _SIDE, _NORMALS = 16, 17, 32, 128
_DIFFERENCES = np.array([0.0, 15, 30, 45, 60])  # degrees, where facets are looked for
_UP = np.array([0.0, 0.0, 1.0])
_EVEN = 0.1  # the share of facets that look everywhere, so that no direction is without nodes


class ResamplingError(NamedTuple):
    """How far two records are from each other, for each channel (C,); see `resampling_error`."""

    relative_l2: Float[np.ndarray, " C"]
    median: Float[np.ndarray, " C"]
    pairs: int


def count_channels(reflectance: Reflectance) -> int:
    """How many numbers `evaluate` gives for each pair."""
    if isinstance(reflectance, MeasuredSamples):
        return reflectance.values.shape[1]
    return channel_count(reflectance) or 1


def evaluate(
    reflectance: Reflectance, wi: Directions, wo: Directions, reach: float | None = None
) -> Float[np.ndarray, "N C"]:
    """f at pairs of directions (N, 3), (N, C), of a model or a measurement; (N, 1) of a grey model.

    Between samples it is interpolated, and beyond their `reach` it is NaN, see `scattered.interpolate`.
    """
    if isinstance(reflectance, MeasuredSamples):
        return interpolate(reflectance, wi, wo, reach)
    brdf = reflectance.anonymous
    starts = range(0, max(len(wi), 1), _BLOCK)  # one block at least, which says how many channels there are
    f = np.concatenate([_evaluate_block(brdf, wi[i : i + _BLOCK], wo[i : i + _BLOCK]) for i in starts])
    return f if f.ndim == 2 else f[:, None]


def resampling_error(before: Reflectance, after: Reflectance) -> ResamplingError:
    r"""How far `after` is from `before` where `before` is known, both directions below 80 degrees.

        relative_l2    √(Σ (f' − f)² / Σ f²),    median    of |f' − f| / f where f > 0

    over the samples of a measurement, in each channel the valid ones (at most 50,000 pairs, the same ones
    every time), or of `as_samples`. Pairs that `after` lacks count as 0 in the first and are left out of the
    second. Samples of the same pairs are compared one by one. NaN where there is nothing to compare. Raises
    ValueError where the channels are not as many, unless one of both is grey.
    """
    known = as_samples(before)
    channels = count_channels(known), count_channels(after)
    if 1 not in channels and channels[0] != channels[1]:
        raise ValueError(f"channels must be as many in both, or one; found {channels[0]} and {channels[1]}")
    rows = np.flatnonzero((np.maximum(known.theta_i, known.theta_o) < _GRAZING) & known.valid.any(axis=1))
    rows = np.random.default_rng(0).permutation(rows)[:_COMPARED]
    f = np.where(known.valid, known.values, np.nan)[rows]
    there = _at(after, known, rows)
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.where((f > 0) & np.isfinite(there), np.abs(there - f) / f, np.nan)
        l2 = np.sqrt(np.nansum((np.nan_to_num(there) - f) ** 2, axis=0) / np.nansum(f**2, axis=0))
    return ResamplingError(l2, _nanmedian(relative), len(rows))


def _at(reflectance: Reflectance, known: MeasuredSamples, rows: np.ndarray) -> Float[np.ndarray, "n C"]:
    """f at some pairs of `known`."""
    angles = ("theta_i", "phi_i", "theta_o", "phi_o")
    if isinstance(reflectance, MeasuredSamples) and all(
        np.array_equal(getattr(reflectance, name), getattr(known, name)) for name in angles
    ):
        return np.where(reflectance.valid, reflectance.values, np.nan)[rows]
    return evaluate(reflectance, known.wi[rows], known.wo[rows])


# Samples


def as_samples(reflectance: Reflectance) -> MeasuredSamples:
    """Any reflectance as samples: of a measurement all that it holds, of a model some 24,000.

    Of a table they are the cells above the horizon, of adaptive tables the nodes less than 89.4 degrees from
    the normal; a model is looked at on a grid over half and difference angles, with an azimuth of the half
    vector besides where it is anisotropic. `wavelengths`, `name` and `origin` come along.
    """
    if isinstance(reflectance, MeasuredSamples):
        return reflectance
    if isinstance(reflectance, MeasuredBRDF):
        return _samples_of_table(reflectance)
    if isinstance(reflectance, AdaptiveBRDF):
        return _samples_of_nodes(reflectance)
    wi, wo = _above(*_model_pairs(bool(checks.is_isotropic(reflectance))))
    return _samples(wi, wo, evaluate(reflectance, wi, wo), reflectance)


def _samples_of_table(table: MeasuredBRDF) -> MeasuredSamples:
    wi, wo = (np.asarray(w)[table.above_horizon] for w in table.grid.directions())
    values = table.raw[table.above_horizon] * table.scale
    values = np.where(np.isfinite(values), values, -1)
    known = (values >= 0).any(axis=-1)
    return _samples(wi[known], wo[known], values[known], table)


def _samples_of_nodes(brdf: AdaptiveBRDF) -> MeasuredSamples:
    nodes = _nodes(brdf.anonymous)
    wi, wo = _above(np.asarray(nodes.wi, float).reshape(-1, 3), np.asarray(nodes.wo, float).reshape(-1, 3))
    return _samples(wi, wo, evaluate(brdf, wi, wo), brdf)


def _samples(wi: Directions, wo: Directions, values: np.ndarray, source: Reflectance) -> MeasuredSamples:
    (theta_i, phi_i), (theta_o, phi_o) = (map(np.asarray, to_spherical(jnp.asarray(w))) for w in (wi, wo))
    return MeasuredSamples(theta_i, phi_i, theta_o, phi_o, values, np.ones(len(wi)), **_about(source))


def _model_pairs(isotropic: bool) -> tuple[Directions, Directions]:
    """Pairs over half and difference angles, √θ_h evenly spaced; (N, 3) each."""
    H, D, P, turns = (45, 30, 24, 1) if isotropic else (24, 20, 12, 24)
    axes = [((np.arange(n) + 0.5) / n) for n in (H, turns, D, P)]
    h, turn, d, p = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    half = np.pi / 2
    wi, wo = from_half_difference(half * h**2, 2 * np.pi * turn * (turns > 1), half * d, np.pi * p)
    return np.asarray(wi), np.asarray(wo)


def _above(wi: Directions, wo: Directions) -> tuple[Directions, Directions]:
    steep = (wi[:, 2] > _HORIZON) & (wo[:, 2] > _HORIZON)
    return wi[steep], wo[steep]


# Table


def as_table(reflectance: Reflectance, grid: HalfDifferenceGrid | None = None) -> MeasuredBRDF:
    """Any isotropic reflectance as a table on a grid, by default MERL's.

    A table on that grid is left as it is. Such a table is reciprocal: where f(wi, wo) and f(wo, wi) differ,
    as in some measurements, it holds their mean. Cells that samples do not reach are invalid, −1, as are
    those below the horizon. Samples count as those of an isotropic surface. Raises ValueError for any other
    reflectance that is not isotropic.
    """
    grid = merl_grid() if grid is None else grid
    if isinstance(reflectance, MeasuredBRDF) and _same_grid(reflectance.grid, grid):
        return reflectance
    if isinstance(reflectance, AbstractBRDF) and not _is_isotropic(reflectance):
        raise ValueError(
            "a table over half and difference angles holds an isotropic reflectance; this one depends on the "
            "azimuth: keep it as samples or as adaptive tables"
        )
    cos_i, cos_o = grid.cosines()
    above = np.asarray((cos_i > 0) & (cos_o > 0))
    wi, wo = (np.asarray(w)[above] for w in grid.directions())
    f = evaluate(reflectance, wi, wo)
    if isinstance(reflectance, AbstractBRDF):
        f = (f + evaluate(reflectance, wo, wi)) / 2
    raw = np.full((*grid.shape, f.shape[1]), -1.0)
    raw[above] = np.where(np.isfinite(f), f, -1)
    return MeasuredBRDF(raw, np.ones(f.shape[1]), grid, **_about(reflectance))


def _same_grid(a: HalfDifferenceGrid, b: HalfDifferenceGrid) -> bool:
    return a.shape == b.shape and all(
        np.allclose(getattr(a, axis), getattr(b, axis)) for axis in ("theta_h", "theta_d", "phi_d")
    )


def _is_isotropic(brdf: AbstractBRDF) -> bool:
    """Of adaptive tables it is known; of any other it is tried."""
    return brdf.is_isotropic if isinstance(brdf, AdaptiveBRDF) else bool(checks.is_isotropic(brdf.anonymous))


def _about(reflectance: Reflectance) -> dict:
    """What a measurement says of itself, for the record that it becomes."""
    if not isinstance(reflectance, Measurement):
        return {}
    return {name: getattr(reflectance, name) for name in ("wavelengths", "name", "origin")}


# Adaptive tables


def as_adaptive(reflectance: Reflectance) -> AdaptiveBRDF:
    r"""Any reflectance in the adaptive parameterisation of Dupuy & Jakob 2018, in single precision.

    Nodes lie where facets are seen that would reflect about as f does, and some everywhere. The table holds
    f cos θ_o over their density D / (4 σ), so that a poor guess of D costs resolution and nothing else. There
    are 16 incidences, or the measured ones where they are few, 17 azimuths where f depends on them, and
    32 × 32 outgoing directions each. Directions that a measurement does not reach take the value of the
    nearest that it does. Samples are taken to be those of an isotropic surface.
    """
    if isinstance(reflectance, AdaptiveBRDF):
        return reflectance
    isotropic = isinstance(reflectance, MeasuredSamples) or _is_isotropic(reflectance)
    frame = _frame(reflectance, isotropic)
    wi, wo, ratio, density = (np.asarray(part, float) for part in _nodes(frame))
    light = _light(reflectance, wi, wo)
    return AdaptiveBRDF(
        **{name: getattr(frame, name) for name in ("theta_i", "phi_i", "ndf", "sigma", "vndf")},
        luminance=_single(np.maximum(light.mean(axis=-1), 0) / density),
        values=_single(light / ratio[..., None]),
        **_about(reflectance),
    )


def _frame(reflectance: Reflectance, isotropic: bool) -> AdaptiveBRDF:
    """Adaptive tables whose nodes suit a reflectance, with values still to come."""
    phi_i = np.zeros(1) if isotropic else np.linspace(-np.pi, np.pi, _AZIMUTHS)
    theta_i = _incidences(reflectance)
    w = np.asarray(spherical(theta_i, phi_i[:, None]))
    m, area = _normals(_NORMALS, _NORMALS)
    D = _facets(reflectance, m[:1] if isotropic else m, area)
    facets = np.broadcast_to(D * area, m.shape[:2])
    around = _normals(2 if isotropic else _AZIMUTHS, _NORMALS)[0]
    blank = np.ones((*w.shape[:2], _SIDE, _SIDE, 1), np.float32)
    return AdaptiveBRDF(
        theta_i=_single(theta_i),
        phi_i=_single(phi_i),
        ndf=_single(np.repeat(D, 2, axis=0) if isotropic else D),  # two rows, the least between which to mix
        sigma=_single(np.apply_along_axis(lambda v: _integral(np.maximum(m @ v, 0) * facets), -1, around)),
        vndf=_single(_visible(w, m, facets)),
        luminance=blank[..., 0],
        values=blank,
    )


def _incidences(reflectance: Reflectance) -> Float[np.ndarray, " T"]:
    """θ_i of the nodes: those that were measured if they are few, else dense towards grazing."""
    if isinstance(reflectance, MeasuredSamples):
        theta_i = reflectance.theta_i[reflectance.valid.any(axis=1)]
        measured = np.unique(np.clip(np.round(theta_i, 4), 0, _STEEPEST))
        if _INCIDENCES // 2 <= len(measured) <= 2 * _INCIDENCES:
            return measured
    return np.radians(89) * np.sin(np.linspace(0, np.pi / 2, _INCIDENCES))


def _normals(rows: int, columns: int) -> tuple[Directions, Float[np.ndarray, " columns"]]:
    """Normals (rows, columns, 3) at the nodes of a table over the unit square; solid angle for its area."""
    theta = np.pi / 2 * np.linspace(0, 1, columns) ** 2
    m = spherical(theta, np.pi * np.linspace(-1, 1, rows)[:, None])
    return np.asarray(m), 2 * np.pi**2 * np.linspace(0, 1, columns) * np.sin(theta)


def _facets(reflectance: Reflectance, m: Directions, area: np.ndarray) -> np.ndarray:
    """D at normals (rows, columns, 3): as the light that facets there would reflect, and some everywhere.

    f cos θ is averaged over pairs that lie symmetrically about a normal, 2 θ_d apart and both above the
    horizon, as far as they are known; of the channels the brightest counts.
    """
    theta, phi = (np.asarray(angle).reshape(-1, 1) for angle in to_spherical(jnp.asarray(m)))
    pairs = from_half_difference(theta, phi, np.radians(_DIFFERENCES), np.full_like(theta, np.pi / 2))
    wi, wo = (np.asarray(w).reshape(-1, 3) for w in pairs)
    light = evaluate(reflectance, wi, wo, np.inf) * wo[:, 2:]
    light = light.reshape(len(theta), len(_DIFFERENCES), -1)
    known = np.isfinite(light)
    mean = np.where(known, light, 0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    D = np.maximum(mean.max(axis=-1), 0).reshape(m.shape[:2])
    whole = _integral(D * m[..., 2] * area)
    return (1 - _EVEN) * D / whole + _EVEN / np.pi if whole > 0 else np.full_like(D, 1 / np.pi)


def _visible(w: Directions, m: Directions, facets: np.ndarray) -> np.ndarray:
    """How densely the nodes lie for light from w (P, T, 3): as facets are seen, and half of them evenly."""
    seen = np.maximum(np.einsum("ptk,mnk->ptmn", w, m), 0) * facets
    return 0.5 + 0.5 * seen / seen.mean(axis=(-2, -1), keepdims=True)


def _integral(table: np.ndarray) -> float:
    """∫ over the unit square of a table that is periodic across its rows, or the same in all of them."""
    once = table[:-1] if len(table) > 1 else table
    return float(np.trapezoid(once.mean(axis=0), dx=1 / (table.shape[1] - 1)))


def _light(reflectance: Reflectance, wi: Directions, wo: Directions) -> np.ndarray:
    """f cos θ_o, (P, T, K, K, C), for wo below the horizon that at the horizon; of samples however far."""
    z = np.maximum(wo[..., 2:], 1e-3)
    wo = np.concatenate([wo[..., :2], z], axis=-1)
    wo /= np.linalg.norm(wo, axis=-1, keepdims=True)
    f = evaluate(reflectance, wi.reshape(-1, 3), wo.reshape(-1, 3), np.inf)
    return _filled(f.reshape(*z.shape[:-1], -1)) * wo[..., 2:]


def _filled(values: np.ndarray) -> np.ndarray:
    """Tables (P, T, K, K, C) in which NaN has become the nearest number of the same outgoing tile, else 0."""
    holes = ~np.isfinite(values)
    for p, t, c in np.argwhere(holes.any(axis=(2, 3))):
        hole = holes[p, t, :, :, c]
        rows, columns = distance_transform_edt(hole, return_distances=False, return_indices=True)
        values[p, t, :, :, c] = 0 if hole.all() else values[p, t, rows, columns, c]
    return values


# Helpers


_nodes = eqx.filter_jit(AdaptiveBRDF.nodes)


def _evaluate_block(brdf: AbstractBRDF, wi: Directions, wo: Directions) -> np.ndarray:
    """One block, filled up to a power of two, so that jit compiles for few sizes."""
    n = len(wi)
    count = 1 << max(n - 1, 0).bit_length()
    wi, wo = (np.concatenate([w, np.broadcast_to(_UP, (count - n, 3))]) for w in (wi, wo))
    return np.asarray(checks.evaluate(brdf, jnp.asarray(wi), jnp.asarray(wo)), float)[:n]


def _nanmedian(a: np.ndarray) -> np.ndarray:
    """The median down the first axis without NaN; NaN where nothing else is."""
    return np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan for c in a.T])


def _single(a: np.ndarray) -> np.ndarray:
    return np.asarray(a, np.float32)
