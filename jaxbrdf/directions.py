r"""Unit vectors in the shading frame, spherical angles, half and difference angles both ways.

A direction is an array (..., 3) of unit vectors, z along the macro-normal n; leading axes broadcast.
Angles are in radians, φ in (−π, π]. At the poles, where φ is undefined, φ is 0 and its gradient 0.
"""

from functools import reduce
from operator import add

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxbrdf.arrays import floats
from jaxbrdf.special import arctan2, safe_arctan2, safe_divide, safe_hypot, safe_sqrt

Direction = Float[Array, "... 3"]
Angle = Float[Array, "..."]


NORMAL = (0.0, 0.0, 1.0)  # n, the macro-normal
_UNIT_ERROR = 1e-3  # of the length of a direction; single precision stays far below


def as_directions(w: ArrayLike, name: str) -> Direction:
    """`w` as an array of directions, checked: its shape always, the lengths where values are at hand.

    The zero vector passes: it is `half_vector` of opposite directions. Raises ValueError.
    """
    array = as_floats(w, name, "directions", 3)
    if isinstance(array, jax.core.Tracer):
        return array
    length2 = np.sum(np.square(array), axis=-1)
    wrong = ~(np.abs(length2 - 1) < 2 * _UNIT_ERROR) & (length2 != 0)
    if np.any(wrong):
        raise ValueError(
            f"{name} must hold unit vectors; found one of length {np.sqrt(length2[wrong][0]):.6g}. "
            f"Divide by the length: {name} / norm({name}, axis=-1, keepdims=True)"
        )
    return array


def as_floats(a: ArrayLike, name: str, kind: str, components: int) -> Float[Array, "... components"]:
    """`a` as floating-point numbers with `components` of them along the last axis; else ValueError."""
    array = floats(a)
    if array.ndim == 0 or array.shape[-1] != components:
        raise ValueError(
            f"{name} must hold {kind} along its last axis, shape (..., {components}); found {array.shape}"
        )
    return array


def same_rank(wi: Direction, wo: Direction) -> tuple[Direction, Direction]:
    """Both with as many leading axes, so that they broadcast."""
    rank = max(wi.ndim, wo.ndim)
    return wi.reshape((1,) * (rank - wi.ndim) + wi.shape), wo.reshape((1,) * (rank - wo.ndim) + wo.shape)


def dot(a: Float[Array, "... n"], b: Float[Array, "... n"]) -> Float[Array, "..."]:
    """a · b over the last axis, which should be short.

    Written out, as is all that works on the components of directions: XLA then fuses a whole reflectance into
    one loop, where a reduction over three numbers is a pass over memory of its own.
    """
    return reduce(add, (a[..., i] * b[..., i] for i in range(a.shape[-1])))


def safe_normalize(v: Float[Array, "... n"]) -> Float[Array, "... n"]:
    """v / ‖v‖ over the last axis; the zero vector, with gradient 0, where v = 0."""
    length = safe_sqrt(dot(v, v))
    return jnp.stack([safe_divide(v[..., i], length) for i in range(v.shape[-1])], axis=-1)


def cos_theta(w: Direction) -> Angle:
    """w · n, n being the z axis."""
    return w[..., 2]


def above_horizon(cos_w: Angle) -> Bool[Array, "..."]:
    """Whether a direction of polar cosine cos_w counts as above the horizon.

    It begins where the sixth power of 1 / cos θ, the highest that a gradient meets, is still a number: at
    1e-51, or 5e-7 in single precision.
    """
    return cos_w > jnp.finfo(cos_w.dtype).tiny ** (1 / 6)


def spherical(theta, phi) -> Direction:
    """The direction (sin θ cos φ, sin θ sin φ, cos θ), shape (..., 3); theta and phi broadcast."""
    theta, phi = jnp.broadcast_arrays(theta, phi)
    sin_theta = jnp.sin(theta)
    return jnp.stack([sin_theta * jnp.cos(phi), sin_theta * jnp.sin(phi), jnp.cos(theta)], axis=-1)


def to_spherical(w: Direction) -> tuple[Angle, Angle]:
    """(θ, φ) of a direction, θ in [0, π]; accurate and with finite gradients at the poles."""
    return arctan2(safe_hypot(w[..., 0], w[..., 1]), w[..., 2]), safe_arctan2(w[..., 1], w[..., 0])


def or_normal(w: Direction) -> Direction:
    """w, or the normal where w is not above the horizon."""
    return jnp.where(above_horizon(cos_theta(w))[..., None], w, jnp.array(NORMAL, w.dtype))


def half_vector(wi: Direction, wo: Direction) -> Direction:
    """h = (wi + wo) / ‖wi + wo‖; the zero vector where wi = −wo."""
    return safe_normalize(wi + wo)


def reflect(w: Direction, m: Direction) -> Direction:
    """2 (w · m) m − w: the mirror image of w about the facet normal m."""
    return 2 * dot(w, m)[..., None] * m - w


def to_frame(w: Direction, s: Direction, t: Direction, n: Direction) -> Direction:
    """Components of a world vector w in the orthonormal frame of tangent s, bitangent t and normal n."""
    return jnp.stack([dot(w, s), dot(w, t), dot(w, n)], axis=-1)


def from_frame(w: Direction, s: Direction, t: Direction, n: Direction) -> Direction:
    """The world vector with components w in the orthonormal frame (s, t, n): undoes `to_frame`."""
    return w[..., 0:1] * s + w[..., 1:2] * t + w[..., 2:3] * n


def to_half_difference(wi: Direction, wo: Direction) -> tuple[Angle, Angle, Angle, Angle]:
    r"""Rusinkiewicz's angles (θ_h, φ_h, θ_d, φ_d) of a pair of directions.

        h = (wi + wo) / ‖wi + wo‖,   d = R_y(−θ_h) R_z(−φ_h) wi

    θ_h, φ_h are the spherical angles of h, θ_d, φ_d those of d; θ_d is *half* the angle between wi
    and wo. φ_d lies in (−π, π] and is not folded. Rusinkiewicz 1998, "A new change of variables".
    """
    h = half_vector(wi, wo)
    theta_h, phi_h = to_spherical(h)
    d = rotate_y(rotate_z(wi, -phi_h), -theta_h)
    theta_d, phi_d = to_spherical(d)
    return theta_h, phi_h, theta_d, phi_d


def from_half_difference(theta_h, phi_h, theta_d, phi_d) -> tuple[Direction, Direction]:
    """(wi, wo) of Rusinkiewicz's angles: undoes `to_half_difference`; the four angles broadcast."""
    theta_h, phi_h, theta_d, phi_d = jnp.broadcast_arrays(theta_h, phi_h, theta_d, phi_d)
    wi = rotate_z(rotate_y(spherical(theta_d, phi_d), theta_h), phi_h)
    return wi, reflect(wi, spherical(theta_h, phi_h))


def rotate_x(w: Direction, angle: Angle) -> Direction:
    """R_x(angle) w: active and right-handed, from y towards z."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([w[..., 0], c * w[..., 1] - s * w[..., 2], s * w[..., 1] + c * w[..., 2]], axis=-1)


def rotate_y(w: Direction, angle: Angle) -> Direction:
    """R_y(angle) w: active and right-handed, from z towards x."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * w[..., 0] + s * w[..., 2], w[..., 1], c * w[..., 2] - s * w[..., 0]], axis=-1)


def rotate_z(w: Direction, angle: Angle) -> Direction:
    """R_z(angle) w: active and right-handed, from x towards y."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * w[..., 0] - s * w[..., 1], s * w[..., 0] + c * w[..., 1], w[..., 2]], axis=-1)
