"""Measured reflectance in the parameterisation that adapts to it: the files of the RGL database."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8, UInt32

from jaxbrdf.brdf.base import AbstractBRDF, both_above
from jaxbrdf.brdf.square_warp import (
    Corners,
    Point,
    SquareWarp,
    flatten,
    interpolate,
    once,
    square_warp,
    unflatten,
)
from jaxbrdf.directions import Direction, cos_theta, dot, half_vector, reflect, spherical, to_spherical
from jaxbrdf.special import safe_divide, safe_sqrt

_POLE = 1e-6  # the least area of a patch of normals: at the pole the mapping has none


class Nodes(NamedTuple):
    """Pairs of directions (..., 3); D(m) / (4 σ(wi)), by which a value is multiplied to be f cos θ_o; and how
    densely the nodes lie, 1/sr."""

    wi: Direction
    wo: Direction
    ratio: Float[Array, "..."]
    density: Float[Array, "..."]


class AdaptiveBRDF(AbstractBRDF):
    r"""A measured reflectance over normals that are dense where the surface reflects much.

        f(wi, wo) cos θ_o = v(s) D(m) / (4 σ(wi)),   m the half vector,

    Dupuy & Jakob 2018, "An adaptive parameterization for efficient material acquisition and rendering". A
    direction's place in the unit square is (√(2θ/π), φ/2π + ½); s is where the density `vndf` of visible
    normals, flattened, takes the place of m. All tables are bilinear over the square, columns along θ, and
    linear between the incidences `theta_i` (T,) and `phi_i` (P,) in radians:

        ndf (M, N)                D
        sigma (M, N)              σ
        vndf (P, T, M, N)         visible normals by incidence, up to a factor
        luminance (P, T, K, K)    what is sampled by
        values (P, T, K, K, C)    v

    With one `phi_i` or two the surface is isotropic, and φ_m counts from φ_i; azimuths over a half or a
    quarter of a turn stand for all by symmetry. Where `jacobian` is 0, v is f cos θ_o itself. `wavelengths`
    (C,) are in micrometres, None for RGB; `origin` holds what the file says of itself; `version` and `valid`
    are the file's own marks, kept but not used. Values may be slightly negative, as measured. Raises
    ValueError where the shapes do not belong together.
    """

    theta_i: Float[np.ndarray, " T"] = eqx.field(metadata={"rank": 1})
    phi_i: Float[np.ndarray, " P"] = eqx.field(metadata={"rank": 1})
    ndf: Float[np.ndarray, "M N"] = eqx.field(metadata={"rank": 2})
    sigma: Float[np.ndarray, "M2 N2"] = eqx.field(metadata={"rank": 2})
    vndf: Float[np.ndarray, "..."] = eqx.field(metadata={"rank": 4})
    luminance: Float[np.ndarray, "..."] = eqx.field(metadata={"rank": 4})
    values: Float[np.ndarray, "..."] = eqx.field(metadata={"rank": 4})
    jacobian: UInt8[np.ndarray, " flags"] = eqx.field(
        metadata={"rank": 1}, default_factory=lambda: np.ones(1, np.uint8)
    )
    wavelengths: Float[np.ndarray, " W"] | None = None
    version: UInt32[np.ndarray, " numbers"] | None = eqx.field(metadata={"rank": 1}, default=None)
    valid: UInt8[np.ndarray, " bytes"] | None = eqx.field(metadata={"rank": 1}, default=None)
    name: str = eqx.field(static=True, default="")
    origin: tuple[str, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        P, T, K = len(self.phi_i), len(self.theta_i), self.luminance.shape[-1]
        expected = {"vndf": (P, T, *self.vndf.shape[2:]), "luminance": (P, T, K, K)}
        expected["values"] = (*expected["luminance"], self.values.shape[-1])
        if self.wavelengths is not None:
            expected["wavelengths"] = self.values.shape[-1:]
        found = {name: getattr(self, name).shape for name in expected}
        if found != expected:
            raise ValueError(
                f"AdaptiveBRDF: for {P} phi_i and {T} theta_i the tables must have the shapes {expected}; "
                f"found {found}"
            )

    @property
    def is_isotropic(self) -> bool:
        """Whether the tables know one azimuth only."""
        return len(self.phi_i) <= 2

    @property
    def anonymous(self) -> "AdaptiveBRDF":
        """The same without name and origin; see `AbstractBRDF.anonymous`."""
        return replace(self, name="", origin=())

    def nodes(self) -> "Nodes":
        """What the entries of `values` belong to, (P, T, K, K). Some wo lie below the horizon: their entries
        serve the pairs nearby."""
        P, T, K = self.luminance.shape[:3]
        wi = spherical(self.theta_i[None, :], self.phi_i[:, None])[:, :, None, None, :]
        wi = jnp.broadcast_to(wi, (P, T, K, K, 3))
        table = jnp.arange(P * T, dtype=jnp.int32).reshape(P, T, 1, 1)
        corners = [(jnp.broadcast_to(table, (P, T, K, K)), jnp.ones((P, T, K, K), wi.dtype))]
        side = jnp.linspace(0, 1, K, dtype=wi.dtype)
        u = jnp.broadcast_to(side, (P, T, K, K)), jnp.broadcast_to(side[:, None], (P, T, K, K))
        point, visible = unflatten(square_warp(_flat(self.vndf)), corners, u)
        m = self._normal(point, wi)
        return Nodes(wi, reflect(wi, m), self._ratio(point, wi), visible / self._solid_angle(point, m, wi))

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        wi, wo = self._folded(wi, wo)
        point, corners = self._place(wi + wo, wi), self._corners(wi)
        s, _ = flatten(square_warp(_flat(self.vndf)), corners, point)
        above = both_above(wi, wo)
        factor = self._ratio(point, wi) / jnp.where(above, cos_theta(wo), 1)  # one division for all channels
        return jnp.where(above, interpolate(_flat(self.values), corners, s) * factor, 0)

    def _ratio(self, point: Point, wi: Direction) -> Float[Array, "..."]:
        """D(m) / (4 σ(wi)) for m at a point of the square; 1 where `jacobian` is 0."""
        alone = [(jnp.zeros(point[0].shape, jnp.int32), jnp.ones(point[0].shape, wi.dtype))]
        D = interpolate(jnp.asarray(self.ndf)[None], alone, point)
        sigma = interpolate(jnp.asarray(self.sigma)[None], alone, _square(*to_spherical(wi)))
        return jnp.where(self.jacobian[0] > 0, safe_divide(D, 4 * sigma), 1)

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        folded, sign = self._fold(wo)
        corners = self._corners(folded)
        s, _ = unflatten(self._shares(), corners, (u[..., 0], u[..., 1]))
        point, _ = unflatten(square_warp(_flat(self.vndf)), corners, s)
        return reflect(folded, self._normal(point, folded)) * sign

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        wo, wi = self._folded(wo, wi)
        m, corners = half_vector(wi, wo), self._corners(wo)
        point = self._place(m, wo)
        s, visible = flatten(square_warp(_flat(self.vndf)), corners, point)
        _, share = flatten(self._shares(), corners, s)
        return visible * share / self._solid_angle(point, m, wo)

    def _solid_angle(self, point: Point, m: Direction, w: Direction) -> Float[Array, "..."]:
        """dω of directions w is mirrored to, for the area of the square around its normal m."""
        d_omega_m = 2 * jnp.pi**2 * point[0] * safe_sqrt(1 - cos_theta(m) ** 2)
        return jnp.maximum(d_omega_m, _POLE) * 4 * jnp.abs(dot(w, m))

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        wo, _ = self._fold(wo)
        mean = jnp.mean(_flat(self.luminance), axis=(-2, -1))
        return jnp.maximum(sum(mean[table] * weight for table, weight in self._corners(wo)), _POLE)

    def _shares(self) -> SquareWarp:
        return square_warp(jnp.maximum(_flat(self.luminance), 0))

    def _corners(self, w: Direction) -> Corners:
        """The two incidences around a direction, or the four where azimuths count."""
        theta, phi = to_spherical(w)
        T = len(self.theta_i)
        return [
            (i * T + j, u * v) for i, u in _around(phi, self.phi_i) for j, v in _around(theta, self.theta_i)
        ]

    def _place(self, m: Direction, wi: Direction) -> Point:
        """Where a normal, of any length, lies in the square, for light from wi."""
        theta, phi = to_spherical(m)
        return once(_square(theta, phi - to_spherical(wi)[1] if self.is_isotropic else phi))

    def _normal(self, point: Point, wi: Direction) -> Direction:
        """The normal at a point of the square: undoes `_place`."""
        phi = (2 * point[1] - 1) * jnp.pi
        phi = phi + to_spherical(wi)[1] if self.is_isotropic else phi
        return spherical(point[0] ** 2 * (jnp.pi / 2), phi)

    def _folded(self, incident: Direction, other: Direction) -> tuple[Direction, Direction]:
        """The pair mirrored or turned so that the first lies among the azimuths of the tables."""
        incident, sign = self._fold(incident)
        return incident, other * sign

    def _fold(self, w: Direction) -> tuple[Direction, Direction]:
        """A direction mirrored or turned to where the tables are, and the signs of x, y, z that do it.

        Tables of a quarter of a turn hold the azimuths in which x and y are negative, those of a half the
        ones in which y is, for a surface that half a turn leaves as it is.
        """
        if self.is_isotropic:
            return w, jnp.ones_like(w)
        parts = jnp.round(2 * jnp.pi / (self.phi_i[-1] - self.phi_i[0]))
        x, y = (jnp.where(w[..., k] > 0, -1, 1).astype(w.dtype) for k in (0, 1))
        sign_x = jnp.where(parts == 4, x, jnp.where(parts >= 2, y, 1))
        sign_y = jnp.where(parts >= 2, y, 1)
        sign = jnp.stack([sign_x, sign_y, jnp.ones_like(x)], axis=-1).astype(w.dtype)
        return w * sign, sign


def _flat(tables: Array | np.ndarray) -> Array:
    """(P, T, …) to (P T, …)."""
    return jnp.asarray(tables).reshape(-1, *tables.shape[2:])


def _square(theta: Float[Array, "..."], phi: Float[Array, "..."]) -> Point:
    """Where a direction lies in the unit square."""
    turn = phi / (2 * jnp.pi) + 0.5
    return safe_sqrt(theta * (2 / jnp.pi)), turn - jnp.floor(turn)


def _around(x: Float[Array, "..."], nodes: Array | np.ndarray) -> Corners:
    """The nodes around x and their weights; outside of all, the nearest."""
    if len(nodes) == 1:
        return [(jnp.zeros(x.shape, jnp.int32), jnp.ones_like(x))]
    at = jnp.asarray(nodes, x.dtype)
    lower = jnp.clip(
        jnp.searchsorted(at, x, side="right", method="compare_all") - 1, 0, len(nodes) - 2
    ).astype(jnp.int32)
    w = jnp.clip((x - at[lower]) / (at[lower + 1] - at[lower]), 0, 1)
    return [(lower, 1 - w), (lower + 1, w)]
