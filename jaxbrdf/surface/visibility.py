"""What of a height map a direction sees, and what the map reflects at a single bounce: by tracing rays."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxbrdf.directions import (
    Direction,
    above_horizon,
    as_directions,
    cos_theta,
    dot,
    half_vector,
    or_normal,
    same_rank,
)
from jaxbrdf.fresnel import AbstractFresnel
from jaxbrdf.special import safe_divide, safe_hypot
from jaxbrdf.surface.facets import Facets, facets
from jaxbrdf.surface.heightfield import Heightfield
from jaxbrdf.surface.tracing import clear


def visibility(heightfield: Heightfield, w: ArrayLike, margin: float | None = None) -> Float[Array, "..."]:
    r"""The share of the area facing w that w sees, (...) for w (..., 3): the traced G1(w).

        G1 = Σ V (w·m)+ / (m·n)  /  Σ (w·m)+ / (m·n)

    over facets, the squares of the map, which stand for dx · dy each; V is 1 where a ray towards w escapes.
    Smith's masking claims to be this share, of all facets and of those of each normal. Of all, that is so on
    an endless map, for what w sees of it projects to the area cos θ: G1 = cos θ / σ(w). Fig. 6 (left) of
    Dong et al. 2015 shows visibility against θ. `visible_facets` has V itself, for other means.

    Missing points hide nothing and are not counted. Beyond the border nothing is known, and rays that leave
    the map escape; facets from which less than `margin` µm of the map lie ahead are therefore not counted:
    by default as far as a ray takes to rise by all the relief, peak to valley times tan θ, but at most half
    of what the map spans along w. (To keep the rays that rise in time would favour peaks.)

    The map is not levelled here. 0 for w at and below the horizon, NaN where nothing faces w. Heights are
    linear between neighbouring points: where shadows end V is wrong for some 0.5 % of the facets of a surface
    of slopes 0.35 and a correlation length of 6 pixels. V is a step, of derivative 0; weights have theirs.
    """
    return _visibility(heightfield, as_directions(w, "w"), _traced(margin))


def visible_facets(heightfield: Heightfield, w: ArrayLike) -> Bool[Array, "rows columns"]:
    """Which facets w, (3,), sees: the squares between the points, (ny − 1, nx − 1).

    False for those that face away or have a missing corner; those near the border are seen too often, see
    `visibility`. Raises ValueError for w of another shape.
    """
    w = as_directions(w, "w")
    if w.shape != (3,):
        raise ValueError(f"visible_facets: w must be one direction, (3,); found {w.shape}")
    return _visible_facets(heightfield, w)


def virtual_goniometer(
    heightfield: Heightfield,
    wi: ArrayLike,
    wo: ArrayLike,
    fresnel: AbstractFresnel | None = None,
    width: float = math.radians(4),
    margin: float | None = None,
) -> Float[Array, "..."]:
    r"""The reflectance of the map as a mirror, by its facets that are both lit and seen, 1/sr.

        f = F(θ_d) D_V / (4 cos θ_i cos θ_o),   D_V = Σ V_i V_o / (m·n) / (n Ω),   Ω = 2π (1 − cos width)

    The sum is over facets, n of them, whose normal m is within `width` (radians) of h: D_V is the density of
    lit and seen area, D(h) G in a microfacet model, of which this is the truth without its assumptions on
    shadowing. Light is mirrored once; F is 1 unless a `fresnel` is given. Directions (..., 3) broadcast; the
    result is (...), or (..., C) for a Fresnel term with channels.

    Few facets look at h: the relative error is about one over the root of how many independent ones do; and a
    D that is curved within `width` comes out smoothed, by some width² ∇²D / 8. Missing points and `margin`
    are as for `visibility`, with both directions ahead. 0 where a direction is at or below the horizon, NaN
    where no facet counts. Raises ValueError for a width that is not in (0, π/2].
    """
    if not 0 < width <= math.pi / 2:
        raise ValueError(f"virtual_goniometer: width must be an angle in (0, π/2], in radians; found {width}")
    wi, wo = jnp.broadcast_arrays(*same_rank(as_directions(wi, "wi"), as_directions(wo, "wo")))
    D = _lit_and_seen(heightfield, wi, wo, jnp.asarray(width), _traced(margin))
    both = above_horizon(cos_theta(wi)) & above_horizon(cos_theta(wo))
    f = jnp.where(both, D / jnp.where(both, 4 * cos_theta(wi) * cos_theta(wo), 1), 0)
    if fresnel is None:
        return f
    F = fresnel(dot(wi, half_vector(wi, wo)))
    return F * f.reshape(f.shape + (1,) * (F.ndim - f.ndim))


def _traced(margin: float | None) -> Array | None:
    """As an array, of whose value jit compiles no program of its own."""
    return None if margin is None else jnp.asarray(margin)


@eqx.filter_jit
def _visibility(heightfield: Heightfield, w: Direction, margin: Array | None) -> Float[Array, "..."]:
    of = facets(heightfield)

    def share(w):
        facing = jnp.where(of.known & _ahead(heightfield, w, margin), jnp.maximum(of.towards(w), 0), 0)
        return jnp.sum(jnp.where(clear(heightfield, w), facing, 0)) / jnp.sum(facing)

    shares = jax.lax.map(share, or_normal(w).reshape(-1, 3)).reshape(w.shape[:-1])
    return jnp.where(above_horizon(cos_theta(w)), shares, 0)


@eqx.filter_jit
def _visible_facets(heightfield: Heightfield, w: Float[Array, "3"]) -> Bool[Array, "rows columns"]:
    return _seen(heightfield, facets(heightfield), w)


@eqx.filter_jit
def _lit_and_seen(heightfield: Heightfield, wi: Direction, wo: Direction, width, margin):
    """D_V of `virtual_goniometer` for pairs of one shape."""
    of = facets(heightfield)
    area = jnp.sqrt(1 + of.slope_x**2 + of.slope_y**2)  # 1 / (m·n)

    def density(pair):
        wi, wo = pair
        counted = of.known & _ahead(heightfield, wi, margin) & _ahead(heightfield, wo, margin)
        lit_and_seen = counted & _seen(heightfield, of, wi) & _seen(heightfield, of, wo)
        mirrors = of.towards(half_vector(wi, wo)) >= jnp.cos(width) * area
        return jnp.sum(jnp.where(lit_and_seen & mirrors, area, 0)) / jnp.sum(counted)

    pairs = or_normal(wi).reshape(-1, 3), or_normal(wo).reshape(-1, 3)
    solid_angle = 4 * math.pi * jnp.sin(width / 2) ** 2
    return jax.lax.map(density, pairs).reshape(wi.shape[:-1]) / solid_angle


def _seen(heightfield: Heightfield, of: Facets, w: Float[Array, "3"]) -> Bool[Array, "rows columns"]:
    return of.known & (of.towards(w) > 0) & clear(heightfield, w)


def _ahead(heightfield: Heightfield, w: Float[Array, "3"], margin) -> Bool[Array, "rows columns"]:
    """From which facets the map reaches at least `margin` µm towards w, see `visibility`."""
    (ny, nx), dx, dy = heightfield.z.shape, heightfield.dx, heightfield.dy
    sine = safe_hypot(w[0], w[1])
    cos_phi, sin_phi = safe_divide(w[0], sine), safe_divide(w[1], sine)
    x_end, y_end = (nx - 1) * dx, (ny - 1) * dy
    if margin is None:
        span = jnp.minimum(x_end / jnp.abs(cos_phi), y_end / jnp.abs(sin_phi))
        margin = jnp.minimum(_relief(heightfield) * sine / w[2], span / 2)
    x = (jnp.arange(nx - 1) + 0.5) * dx + margin * cos_phi
    y = (jnp.arange(ny - 1) + 0.5) * dy + margin * sin_phi
    return ((y >= 0) & (y <= y_end))[:, None] & ((x >= 0) & (x <= x_end))[None, :]


def _relief(heightfield: Heightfield) -> Float[Array, ""]:
    """Peak to valley."""
    z, known = heightfield.z, heightfield.valid
    return jnp.max(z, where=known, initial=-jnp.inf) - jnp.min(z, where=known, initial=jnp.inf)
