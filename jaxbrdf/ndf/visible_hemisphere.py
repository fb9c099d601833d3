"""The points of a hemisphere as a direction sees them: what normals of ellipsoids are drawn from."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.directions import Direction, dot, safe_normalize
from jaxbrdf.special import safe_sqrt


def sample_visible_hemisphere(u: Float[Array, "... 2"], w: Direction, pole: Direction) -> Direction:
    r"""Points s of the unit sphere with s·pole > 0 and s·w > 0, of density (s·w) / area, from u in [0, 1)².

    `pole` is a unit vector (3,). What w sees of the hemisphere projects onto a half disk and a half ellipse
    across w: a point of the disk, with the half where the pole hides it pressed into the ellipse, goes up
    to the sphere. Heitz 2018, "Sampling the GGX distribution of visible normals", section 3.
    """
    anywhere = jnp.broadcast_to(_perpendicular(pole), w.shape)
    pole = jnp.broadcast_to(pole, w.shape)
    across = jnp.cross(pole, w)
    apart = dot(across, across)[..., None] > jnp.finfo(w.dtype).eps  # else it is no more than rounding
    across = safe_normalize(jnp.where(apart, across, anywhere))
    up = safe_normalize(jnp.cross(w, across))
    r, phi = safe_sqrt(u[..., 0]), 2 * jnp.pi * u[..., 1]
    x, y = r * jnp.cos(phi), r * jnp.sin(phi)
    share = (1 + dot(w, pole)) / 2
    y = (1 - share) * safe_sqrt(1 - x**2) + share * y
    z = safe_sqrt(1 - x**2 - y**2)
    return x[..., None] * across + y[..., None] * up + z[..., None] * w


def _perpendicular(n: Float[Array, "3"]) -> Float[Array, "3"]:
    """A unit vector across n: off the axis along which n is shortest."""
    return safe_normalize(jnp.cross(n, jnp.eye(3, dtype=n.dtype)[jnp.argmin(jnp.abs(n))]))
