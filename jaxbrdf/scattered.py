r"""Scattered samples of a reflectance, interpolated and integrated: numpy on the host, no jit, no gradients.

Both hold to the samples and know no model. Interpolation works in coordinates in which pairs of directions
that every reflectance has to treat alike are one point; integration is over the disk of outgoing directions.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, QhullError, cKDTree

from jaxbrdf.directions import as_directions
from jaxbrdf.samples import MeasuredSamples

# Chosen by leaving samples out: of two paints from Cornell, four from a Mini-Diff, and GGX at random pairs.
_STRETCH = 3.0  # of √θ_h against θ_d
_SHRINK = 0.5  # of the part that φ_d plays
_RIM = 1.1  # of the distance to the farthest neighbour: where weights end, so that none appears at once
_RIDGE = 1e-3  # flattens the slope along which the neighbours do not spread
_SMALL = 1e-2  # of the median: reflectances above are told apart by their ratio, below by their difference

_SAME = 1e-6  # in the coordinates, where √θ_h makes 3e-8 of rounding
_SAME_INCIDENCE = 1e-3  # between unit vectors: radians
_FEWEST = 10  # samples of which an albedo is made
_AT_ONCE = 16384  # queries, which bounds the memory


class SampleAlbedos(NamedTuple):
    """Directional albedos (K, C) at K incidences, in order of θ_i; see `sample_albedos`."""

    theta_i: Float[np.ndarray, " K"]
    phi_i: Float[np.ndarray, " K"]
    albedo: Float[np.ndarray, "K C"]
    covered: Float[np.ndarray, " K"]


def interpolate(
    samples: MeasuredSamples,
    wi: ArrayLike,
    wo: ArrayLike,
    reach: float | None = None,
    isotropic: bool = True,
) -> Float[np.ndarray, "... C"]:
    r"""The reflectance in 1/sr of samples at any pairs of directions: wi, wo (..., 3) broadcast to (..., C).

    The samples are points with the coordinates

        (3 √θ_h,  θ_d,  ½ sin θ_h sin θ_d cos 2φ_d),

    the same for a pair, its exchange and its mirror image; for a surface that is not `isotropic`, φ_h counts
    too and mirror images differ. Near a query log(f + ε) is a linear function of them, ε being 1 % of the
    median f: that of least squares over the 12 nearest points (20 where φ_h counts), weighted by distance and
    by the samples' own weights (moving least squares: Lancaster & Salkauskas 1981), and kept between their
    values. So samples are reproduced, those at one point by their mean, and peaks between samples are cut.

    NaN where a direction is not above the horizon, where a channel has no valid sample, and where the nearest
    is farther than `reach` in these coordinates: by default three times the median distance from a point to
    its fourth neighbour, np.inf for no limit. Raises ValueError for what holds no unit vectors, and for
    samples of which none is valid with a weight above 0.
    """
    wi, wo = np.broadcast_arrays(_directions(wi, "wi"), _directions(wo, "wo"))
    used = samples.valid & (samples.weights > 0)[:, None]
    if not used.any():
        raise ValueError("samples must hold a valid one of weight above 0; found none: see MeasuredSamples")
    coordinates = _isotropic if isotropic else _anisotropic
    points = coordinates(samples.wi, samples.wo)
    above = (wi[..., 2] > 0) & (wo[..., 2] > 0)
    queries, places = coordinates(wi[above], wo[above]), np.flatnonzero(above)
    f = np.full((above.size, used.shape[1]), np.nan)
    for rows, channels in _alike(used):
        values = samples.values[np.ix_(rows, channels)]
        f[np.ix_(places, channels)] = _interpolated(
            points[rows], values, samples.weights[rows], queries, reach
        )
    return f.reshape(*above.shape, used.shape[1])


def sample_albedos(samples: MeasuredSamples) -> SampleAlbedos:
    r"""The directional albedo ∫ f cos θ_o dω_o at each incidence at which there are enough samples.

        cos θ_o dω_o = dx dy,    (x, y) = sin θ_o (cos(φ_o − φ_i), sin(φ_o − φ_i))

    f is linear in each triangle of a Delaunay triangulation of the samples in this disk, and left out beyond
    them: `covered` is the share of its area π that they span. Where they lie on one side of the plane of
    incidence, the surface is taken to be isotropic and they are mirrored. Incidences within 1e-3 rad of each
    other are one. Those with fewer than 10 samples valid in all channels, or with all of them in one line
    to 1e-3, are left out; no incidence may be left.
    """
    usable = samples.valid.all(axis=1) & (samples.weights > 0)
    rows = np.lexsort((samples.phi_i, samples.theta_i))
    rows = rows[usable[rows]]
    groups = [rows[members] for members in _incidences(samples.wi[rows])]
    integrals = {group[0]: found for group in groups if (found := _integral(samples, group)) is not None}
    first = np.array(list(integrals), int)
    albedo = np.array([albedo for albedo, _ in integrals.values()], float)
    covered = np.array([covered for _, covered in integrals.values()], float)
    albedo = albedo.reshape(len(first), samples.values.shape[1])
    return SampleAlbedos(samples.theta_i[first], samples.phi_i[first], albedo, covered)


def _directions(w: ArrayLike, name: str) -> Float[np.ndarray, "... 3"]:
    """Directions in double precision, whatever JAX is set to: in less, few queries would hit their sample."""
    as_directions(w, name)
    return np.asarray(w, float)


def _isotropic(wi: Float[np.ndarray, "N 3"], wo: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    r"""The coordinates of pairs, all of them continuous where φ_d is undefined, with

    c = (cos θ_i − cos θ_o) / 2 = −sin θ_h sin θ_d cos φ_d = −s cos φ_d,    s cos 2φ_d = 2 c² / s − s
    """
    h, _, theta_d = _half_difference(wi, wo)
    sin_theta_h = np.hypot(h[:, 0], h[:, 1])
    s, c = sin_theta_h * np.sin(theta_d), (wi[:, 2] - wo[:, 2]) / 2
    s_cos = 2 * np.divide(c**2, s, out=np.zeros_like(s), where=s > 0) - s
    return np.stack([_STRETCH * np.sqrt(np.arctan2(sin_theta_h, h[:, 2])), theta_d, _SHRINK * s_cos], axis=-1)


def _anisotropic(wi: Float[np.ndarray, "N 3"], wo: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 5"]:
    r"""The same where φ_h counts: (3 √θ_h (cos φ_h, sin φ_h),  θ_d,  ½ sin θ_d (cos 2a, sin 2a)).

    a is the azimuth of wi − wo after the shortest rotation that takes h to the normal, φ_h + φ_d: unlike φ_d
    it is defined at θ_h = 0.
    """
    h, d, theta_d = _half_difference(wi, wo)
    sin_theta_h = np.hypot(h[:, 0], h[:, 1])
    r = _STRETCH * np.sqrt(np.arctan2(sin_theta_h, h[:, 2]))
    along = np.divide(r, sin_theta_h, out=np.zeros_like(r), where=sin_theta_h > 0)
    turned = d[:, :2] - h[:, :2] * (d[:, 2] / (1 + h[:, 2]))[:, None]
    z = turned[:, 0] + 1j * turned[:, 1]  # sin θ_d exp(ia)
    z2 = _SHRINK * np.divide(z**2, np.abs(z), out=np.zeros_like(z), where=z != 0)
    return np.stack([along * h[:, 0], along * h[:, 1], theta_d, z2.real, z2.imag], axis=-1)


def _half_difference(wi: Float[np.ndarray, "N 3"], wo: Float[np.ndarray, "N 3"]):
    """h, (wi − wo) / 2 and θ_d; pairs are above the horizon, so that wi + wo is not 0."""
    d, middle = (wi - wo) / 2, (wi + wo) / 2
    cos_theta_d = np.linalg.norm(middle, axis=-1)
    return middle / cos_theta_d[:, None], d, np.arctan2(np.linalg.norm(d, axis=-1), cos_theta_d)


def _alike(used: Bool[np.ndarray, "N C"]) -> Iterator[tuple[Int[np.ndarray, " n"], Int[np.ndarray, " c"]]]:
    """The samples that channels use, and those channels: together where they use the same."""
    patterns, pattern = np.unique(used, axis=1, return_inverse=True)
    for index, rows in enumerate(patterns.T):
        if rows.any():
            yield np.flatnonzero(rows), np.flatnonzero(pattern.ravel() == index)


def _interpolated(
    points: Float[np.ndarray, "n d"],
    values: Float[np.ndarray, "n c"],
    weights: Float[np.ndarray, " n"],
    queries: Float[np.ndarray, "Q d"],
    reach: float | None,
) -> Float[np.ndarray, "Q c"]:
    """`interpolate` in coordinates, for samples that all channels use."""
    points, values, weights = _merged(points, values, weights)
    tree = cKDTree(points)
    count = np.arange(1, min(4 * points.shape[1], len(points)) + 1)
    if reach is None:
        reach = 3 * np.median(tree.query(points, count[:5])[0][:, -1])  # the first is the point itself
    small = _SMALL * np.ma.median(np.ma.masked_less_equal(values, 0), axis=0).filled(1.0)
    f = np.empty((len(queries), values.shape[1]))
    for start in range(0, len(queries), _AT_ONCE):
        here = slice(start, start + _AT_ONCE)
        distance, near = tree.query(queries[here], count)
        shares = _shares(distance, points[near] - queries[here, None], weights[near])
        smooth = np.exp(_weighted(shares, np.log(values + small)[near])) - small
        f[here] = np.clip(smooth, values[near].min(axis=1), values[near].max(axis=1))
        f[here][distance[:, 0] > max(reach, _SAME)] = np.nan
    return f


def _shares(
    distance: Float[np.ndarray, "Q k"], offset: Float[np.ndarray, "Q k d"], weight: Float[np.ndarray, "Q k"]
) -> Float[np.ndarray, "Q k"]:
    r"""What each neighbour contributes at offset 0 to the linear function of least squares; they sum to 1.

        w_k (1 − x̄ᵀ (Σ w x xᵀ + ridge)⁻¹ x_k),    w ∝ weight (1 / distance − 1 / R)²,    Σ w = 1,

    x being the offsets from their mean x̄ in units of the farthest, and R a little beyond that. The weights
    are those of Franke & Nielson 1980, "Smooth interpolation of large sets of scattered data".
    """
    distance = np.where(distance < 2 * _SAME, _SAME**2, distance)  # there the sample outweighs all others
    farthest = distance[:, -1:]
    w = weight * (distance[:, :1] / distance - distance[:, :1] / (_RIM * farthest)) ** 2
    w /= w.sum(axis=1, keepdims=True)
    x = offset / farthest[..., None]
    mean = _weighted(w, x)
    x = x - mean[:, None]
    spread = np.matmul((w[..., None] * x).swapaxes(1, 2), x) + _RIDGE * np.eye(x.shape[-1])
    return w * (1 - np.matmul(x, np.linalg.solve(spread, mean[..., None]))[..., 0])


def _weighted(w: Float[np.ndarray, "Q k"], a: Float[np.ndarray, "Q k n"]) -> Float[np.ndarray, "Q n"]:
    """Σ w_k a_k."""
    return np.matmul(w[:, None], a)[:, 0]


def _merged(
    points: Float[np.ndarray, "N d"], values: Float[np.ndarray, "N c"], weights: Float[np.ndarray, " N"]
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n c"], Float[np.ndarray, " n"]]:
    """Points of which no two are the same, the weighted means of their values, and their weights together."""
    merged, place = np.unique(np.round(points / _SAME) + 0.0, axis=0, return_inverse=True)
    place = place.ravel()
    total = np.bincount(place, weights)
    sums = np.zeros((len(merged), values.shape[1]))
    np.add.at(sums, place, values * weights[:, None])
    return merged * _SAME, sums / total[:, None], total


def _incidences(wi: Float[np.ndarray, "N 3"]) -> Iterator[Int[np.ndarray, " n"]]:
    """The samples of each incidence: of the first direction that is left, and those next to it."""
    tree, left = cKDTree(wi), np.ones(len(wi), bool)
    while left.any():
        near = np.array(sorted(tree.query_ball_point(wi[np.argmax(left)], _SAME_INCIDENCE)))
        near = near[left[near]]
        left[near] = False
        yield near


def _integral(
    samples: MeasuredSamples, rows: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " C"], float] | None:
    """∫ f cos θ_o dω_o over what the samples of one incidence span, and the share of that; or None."""
    disk = np.sin(samples.theta_o[rows]) * np.exp(1j * (samples.phi_o[rows] - samples.phi_i[rows[0]]))
    points = np.stack([disk.real, disk.imag], axis=-1)
    points, values, _ = _merged(points, samples.values[rows], samples.weights[rows])
    if len(points) < _FEWEST:
        return None
    points, values = _on_both_sides(points, values)
    try:
        corners = Delaunay(points).simplices
    except QhullError:  # in one line
        return None
    a, b, c = np.moveaxis(points[corners], 1, 0)
    area = np.abs(np.linalg.det(np.stack([b - a, c - a], axis=-1))) / 2
    if area.sum() < 2 * _SAME_INCIDENCE:  # in one line but for errors: the disk is 2 across
        return None
    return area @ values[corners].mean(axis=1), float(area.sum() / np.pi)


def _on_both_sides(
    points: Float[np.ndarray, "n 2"], values: Float[np.ndarray, "n C"]
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m C"]]:
    """Points of the disk and values; with their mirror images where all lie on one side of y = 0."""
    y = points[:, 1]
    if y.min() < -_SAME_INCIDENCE and y.max() > _SAME_INCIDENCE:
        return points, values
    off = np.abs(y) > _SAME_INCIDENCE
    return np.concatenate([points, points[off] * [1, -1]]), np.concatenate([values, values[off]])
