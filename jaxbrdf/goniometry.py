r"""What a gonioreflectometer sees of a distribution of normals: effective D, blur by the instrument, plans.

Dong et al. 2015, section 7: light and detector keep the angle between them while the sample turns, so that
h runs over the hemisphere, and what reflects is read as a distribution of mirrors.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxbrdf.arrays import floats
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.directions import (
    NORMAL,
    above_horizon,
    as_directions,
    cos_theta,
    dot,
    from_half_difference,
    spherical,
    to_spherical,
)
from jaxbrdf.fresnel import AbstractFresnel
from jaxbrdf.ndf.tabulated import TabulatedNDF, cell_area, disk_cells
from jaxbrdf.special import safe_sqrt

BETWEEN = math.radians(14.14)  # from light to detector (Dong et al. 2015, section 7)
RESOLUTION = math.radians(1.5)  # what their instrument resolves


def effective_density(
    brdf: AbstractBRDF,
    fresnel: AbstractFresnel,
    h: ArrayLike,
    between: float = BETWEEN,
    phi_d: float = math.pi / 2,
) -> Float[Array, "..."]:
    r"""The density of mirrors that would reflect like `brdf` at half directions h (..., 3), 1/sr.

        D(h) ≈ 4 (i·n)(o·n) f_r(i, o) / F(between / 2)          (Dong et al. 2015, eq. 9, with G = 1)

    (...), or (..., C) for a reflectance or Fresnel term with channels; not normalised. `between` is the angle
    from i to o in radians, twice Rusinkiewicz's θ_d. The paper leaves open in which plane about h the two
    lie; here `phi_d` says it, by default across the plane of h and n: both are then inclined alike,
    i·n = o·n = h·n cos(between / 2), and above the horizon whenever h is. NaN where one of them is not, and
    where a measurement has no value.
    """
    h = as_directions(h, "h")
    i, o = from_half_difference(
        *to_spherical(h), jnp.asarray(between / 2, h.dtype), jnp.asarray(phi_d, h.dtype)
    )
    both_above = above_horizon(cos_theta(i)) & above_horizon(cos_theta(o))
    cosines = jnp.where(both_above, cos_theta(i) * cos_theta(o), jnp.nan)
    cosines, f, F = _channels_last(cosines, brdf(i, o), fresnel(dot(i, h)))
    return 4 * cosines * f / F


def effective_ndf(
    brdf: AbstractBRDF, fresnel: AbstractFresnel, size: int = 1025, between: float = BETWEEN
) -> TabulatedNDF:
    """`effective_density` at the cells of a table, to be held against what a height map predicts.

    `size` is N. 0 outside the disk; NaN where a measurement has no value.
    """
    m = disk_cells(size)
    inside = m[2] > 0
    rows = jnp.moveaxis(jnp.where(inside, m, np.reshape(NORMAL, (3, 1, 1))), 0, -1)
    D = _density_of_rows(brdf.anonymous, fresnel, rows, between)
    return TabulatedNDF(jnp.where(inside.reshape(inside.shape + (1,) * (D.ndim - 2)), D, 0))


def scattering_wavelength(wavelength: ArrayLike, between: float = BETWEEN) -> Float[Array, "..."]:
    """λ_q = λ / cos(between / 2), at which `kirchhoff_ndf` predicts light of wavelength λ; in its unit.

    Dong et al. 2015, section 6: λ = 0.550 µm reads λ_q = 0.554 µm there (printed as 555 nm).
    """
    return floats(wavelength) / math.cos(between / 2)


class AbstractSignature(eqx.Module):
    """How an instrument spreads the image of a perfect mirror: K(γ) at the angle γ between half directions.

    Over the sphere ∫ K dω = 1, 1/sr. Called with the square of the chord, |m − m'|² = 2 − 2 cos γ.
    """

    @abstractmethod
    def __call__(self, chord2: Float[Array, "..."]) -> Float[Array, "..."]:
        """K."""

    @property
    @abstractmethod
    def width(self) -> float:
        """The full width at half maximum, radians."""

    @property
    @abstractmethod
    def reach(self) -> float:
        """The chord beyond which K is negligible."""


class GaussianSignature(AbstractSignature):
    r"""The sphere's Gaussian (von Mises and Fisher's), of full `width` at half maximum in radians.

        K = κ exp(−κ (1 − cos γ)) / (2π (1 − exp(−2κ))),   κ = ln 2 / (1 − cos(width / 2))

    By default the 1.5° that Dong et al. 2015 (section 7) name as their resolution. Raises ValueError for a
    width that is not in (0, π).
    """

    width: float = eqx.field(static=True, converter=float, default=RESOLUTION)

    def __check_init__(self):
        if not 0 < self.width < math.pi:
            raise ValueError(f"GaussianSignature: width must be in (0, π), in radians; found {self.width}")

    @property
    def kappa(self) -> float:
        return math.log(2) / (2 * math.sin(self.width / 4) ** 2)

    @property
    def reach(self) -> float:
        """All but 1e-5 of K lies within."""
        return min(2, math.sqrt(2 * math.log(1e5) / self.kappa))

    def __call__(self, chord2: Float[Array, "..."]) -> Float[Array, "..."]:
        peak = self.kappa / (2 * math.pi * -math.expm1(-2 * self.kappa))
        return peak * jnp.exp(-self.kappa / 2 * chord2)


def _numbers(values: ArrayLike | Sequence) -> tuple[float, ...]:
    return tuple(np.ravel(np.asarray(values, float)).tolist())


class MeasuredSignature(AbstractSignature):
    r"""A signature measured on a mirror: a `value` in any unit at each `angle` from its centre, in radians.

    Linear between these angles, in the chord 2 sin(γ/2), and 0 beyond the last; scaled so that ∫ K dω = 1.
    Raises ValueError unless there are as many values as angles, two at least, the angles grow from 0 to at
    most π, and the values are ≥ 0 and the first the largest.
    """

    angle: tuple[float, ...] = eqx.field(static=True, converter=_numbers)
    value: tuple[float, ...] = eqx.field(static=True, converter=_numbers)

    def __check_init__(self):
        angle, value = np.array(self.angle), np.array(self.value)
        if angle.size != value.size or angle.size < 2:
            raise ValueError(
                "MeasuredSignature: as many values as angles are needed, two at least; found "
                f"{value.size} and {angle.size}"
            )
        if not (angle[0] == 0 and np.all(np.diff(angle) > 0) and angle[-1] <= math.pi):
            raise ValueError("MeasuredSignature: angles must grow from 0 to at most π, in radians")
        if not (value[0] > 0 and np.all((value >= 0) & (value <= value[0]))):
            raise ValueError("MeasuredSignature: values must be ≥ 0 and largest at the angle 0")

    @property
    def width(self) -> float:
        angle, value = np.append(self.angle, self.angle[-1]), np.append(self.value, 0) / self.value[0]
        k = int(np.argmax(value <= 0.5))
        return 2 * float(np.interp(0.5, value[[k, k - 1]], angle[[k, k - 1]]))

    @property
    def reach(self) -> float:
        return 2 * math.sin(self.angle[-1] / 2)

    def __call__(self, chord2: Float[Array, "..."]) -> Float[Array, "..."]:
        """A sum of ramps, one from each angle on: without look-ups, which are slow."""
        c, value = 2 * np.sin(np.array(self.angle) / 2), np.array(self.value)
        chord, slope = safe_sqrt(chord2), np.diff(value / self._integral()) / np.diff(c)
        K = value[0] / self._integral() + float(slope[0]) * chord
        for bend, at in zip(np.diff(slope).tolist(), c[1:-1].tolist(), strict=True):
            K = K + bend * jnp.maximum(chord - at, 0)
        return jnp.where(chord <= float(c[-1]), K, 0)

    def _integral(self) -> float:
        """2π ∫ value c dc, for dω = 2π sin γ dγ = 2π c dc; Simpson's rule is exact for it."""
        c, value = 2 * np.sin(np.array(self.angle) / 2), np.array(self.value)
        middle = (c[1:] + c[:-1]) * (value[1:] + value[:-1])
        ends = c[1:] * value[1:] + c[:-1] * value[:-1]
        return float(2 * math.pi * np.sum(np.diff(c) * (ends + middle)) / 6)


def blurred(ndf: TabulatedNDF, signature: AbstractSignature | None = None) -> TabulatedNDF:
    r"""A table as an instrument of this signature would see it.

        D_b(m) = ∫ K(∠(m, m')) D(m') dm'

    over the hemisphere: on the sphere, not on the disk, so that a spot is blurred by the same angle wherever
    it is. What is kept is ∫ D dm, but for what is blurred over the horizon, below which D is 0; ∫ D (m·n) dm
    is multiplied by the mean cosine of K, 0.9999 for the default, `GaussianSignature()`, of 1.5°. Of a table
    of a window nothing is known outside: D is 0 there, and what is blurred out of the window is lost.

    A direct sum over cells of solid angle dA / m_z: its error is 1e-5 by the cut of K, and grows near the rim
    to some 1 % where a cell spans 0.8 widths (above 84° for N = 1025 and 1.5°). It takes N² (N · reach)²
    steps, reach in units of the extent. Raises ValueError where cells are larger than half the width.
    """
    signature = GaussianSignature() if signature is None else signature
    n, extent = ndf.values.shape[0], ndf.extent
    if ndf.values.ndim > 2 and ndf.values.shape[1] != n:
        raise ValueError("blurred: one table at a time; jax.vmap over a batch of them")
    if 4 * max(extent) / n > signature.width:
        raise ValueError(
            f"blurred: a signature {signature.width:.3g} rad wide needs a table of at least "
            f"{math.ceil(4 * max(extent) / signature.width)} cells a side; found {n}"
        )
    radii = tuple(min(n, math.ceil(signature.reach * n / (2 * half))) for half in extent)
    blur = partial(_blurred, signature=signature, extent=extent, radii=radii)
    over_channels = jax.vmap(blur, -1, -1) if ndf.values.ndim > 2 else blur
    return TabulatedNDF(over_channels(ndf.values), extent)


def half_directions(
    count: int = 4000, theta_max: float = math.radians(60), core: float = math.radians(10)
) -> Float[Array, "count 3"]:
    r"""A plan for a measurement: half directions on a spiral around the normal, dense where D is sharp.

        θ_k = core √((1 + theta_max² / core²)^{u_k} − 1),   u_k = (k + 1/2) / count,   φ_k = k π (3 − √5)

    Steps grow in proportion to √(θ² + core²); near the normal they are core √(π ln(1 + theta_max²/core²) /
    count), 0.53° by default, and 3.2° at 60°. Dong et al. 2015 (section 7) measured about 4,000 in a pattern
    of their own, which is not printed. (count, 3); angles in radians. Raises ValueError unless
    0 < theta_max < π/2 and core > 0.
    """
    if not (count > 0 and 0 < theta_max < math.pi / 2 and core > 0):
        raise ValueError(
            "half_directions: count and core must be greater than 0 and theta_max in (0, π/2), in radians; "
            f"found {count}, {core} and {theta_max}"
        )
    k = np.arange(count)
    theta = core * np.sqrt(np.expm1(np.log1p((theta_max / core) ** 2) * (k + 0.5) / count))
    return spherical(jnp.asarray(theta), jnp.asarray(k * (math.pi * (3 - math.sqrt(5))) % (2 * math.pi)))


def _channels_last(*arrays: Array) -> list[Array]:
    """Arrays with and without channels, so that they broadcast."""
    rank = max(a.ndim for a in arrays)
    return [a.reshape(a.shape + (1,) * (rank - a.ndim)) for a in arrays]


@eqx.filter_jit
def _density_of_rows(brdf, fresnel, rows: Float[Array, "N N 3"], between: float) -> Float[Array, "N N ..."]:
    return jax.lax.map(lambda row: effective_density(brdf, fresnel, row, between), rows)


@partial(jax.jit, static_argnames=("extent", "radii"))
def _blurred(
    values: Float[Array, "N N"],
    signature: AbstractSignature,
    extent: tuple[float, float],
    radii: tuple[int, int],
) -> Float[Array, "N N"]:
    """Row by row of the result; for each, one column of the cells within `radii` after another."""
    n = len(values)
    m_z = jnp.asarray(disk_cells(n, extent)[2], values.dtype)
    weighed = jnp.where(m_z > 0, values * cell_area(n, extent) / jnp.where(m_z > 0, m_z, 1), 0)
    weighed, height = (jnp.pad(a, [(r, r) for r in radii[::-1]]) for a in (weighed, m_z))
    x, y = (
        half * (2 / n) * jnp.arange(-radius, radius + 1, dtype=values.dtype)
        for half, radius in zip(extent, radii, strict=True)
    )

    def row(i):
        near, above = (jax.lax.dynamic_slice_in_dim(a, i, len(y)) for a in (weighed, height))

        def add(total, b):
            source, z = (jax.lax.dynamic_slice_in_dim(a, b, n, axis=1) for a in (near, above))
            chord2 = (x[b] ** 2 + y**2)[:, None] + (z - m_z[i][None, :]) ** 2
            return total + jnp.sum(signature(chord2) * source, axis=0), None

        return jax.lax.scan(add, jnp.zeros(n, values.dtype), jnp.arange(len(x)))[0]

    return jnp.where(m_z > 0, jax.lax.map(row, jnp.arange(n)), 0)
