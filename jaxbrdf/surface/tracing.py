r"""Which facets of a height map a direction sees: all rays of one direction at once, column by column.

A facet is the square between four points of the map. Its ray towards w is clear if everything it passes over
lies below it. Along a line in w's azimuth that is a running maximum from the far end, of heights that sink
by what a ray rises from column to column; lines that are parallel and one pixel apart cover the map.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxbrdf.special import safe_divide
from jaxbrdf.surface.facets import Squares
from jaxbrdf.surface.heightfield import Heightfield


def clear(heightfield: Heightfield, w: Float[Array, "3"]) -> Bool[Array, "rows columns"]:
    """Whether the ray from each facet's centre towards w passes above all points beyond, (ny − 1, nx − 1).

    w is above the horizon. Heights are linear between neighbouring points; between a missing point and
    any other nothing stands, and nothing beyond the border. What is said of facets that are not known, or
    that face away, means nothing.
    """
    z, known = heightfield.heights, heightfield.valid
    u, v = jnp.abs(w[0]) / heightfield.dx, jnp.abs(w[1]) / heightfield.dy  # pixels along each axis

    def x_leads():
        return _clear(z.T, known.T, w[0], w[1] < 0, heightfield.dx * w[2], safe_divide(v, u)).T

    def y_leads():
        return _clear(z, known, w[1], w[0] < 0, heightfield.dy * w[2], safe_divide(u, v))

    return jax.lax.cond(u >= v, x_leads, y_leads)


def _clear(z, known, leading, flip, rise, lean) -> Bool[Array, "rows columns"]:
    """`clear` for rays that go along the first axis, by −1 where `leading`, w's part along it, is negative.

    They go along the second by `lean` in [0, 1] for each step, or by −lean where `flip`. Heights times
    |leading| are compared, in which a ray rises by `rise` each step: good at all angles, the normal too.
    """

    def turned(a):
        a = jnp.where(leading < 0, a[::-1], a)
        return jnp.where(flip, a[:, ::-1], a)

    z = turned(z * jnp.abs(leading))
    centre = (z[:-1, :-1] + z[:-1, 1:] + z[1:, :-1] + z[1:, 1:]) / 4
    standing = jnp.where(turned(known), z, -_depth(z))
    return turned(centre >= _horizon(standing, rise, lean))


def _horizon(z: Float[Array, "steps lines"], rise, lean) -> Squares:
    """The height from which a ray is clear, at the centre of each square; the ray goes as in `_clear`.

    The line of index i passes step j at i + part[j], i + whole[j] being its index at the next; `highest` is
    the maximum along each line from there on, as it stands above a ray.
    """
    steps, count = z.shape
    moved = lean * jnp.arange(steps + 1, dtype=z.dtype)
    part, whole = moved[:-1] - jnp.floor(moved[:-1]), jnp.diff(jnp.floor(moved))

    def nearer(highest, step):
        z, part, whole = step
        highest = jnp.maximum(_at(z, part), _at(highest, whole) - rise)
        return highest, _at(highest, (1 + lean) / 2 - part)[: count - 1] - rise / 2

    nothing = jnp.full(count, -_depth(z), z.dtype)
    return jax.lax.scan(nearer, nothing, (z[1:], part[1:], whole[1:]), reverse=True)[1]


def _at(values: Float[Array, " n"], offset: Float[Array, ""]) -> Float[Array, " n"]:
    """Values at i + offset, −1 ≤ offset < 2, linear in between; nothing stands beyond the ends."""
    padded = jnp.pad(values, (1, 3), constant_values=-_depth(values))
    whole = jnp.floor(offset)
    near = jax.lax.dynamic_slice(padded, (1 + whole.astype(int),), (len(values) + 1,))
    return near[:-1] + (offset - whole) * (near[1:] - near[:-1])


def _depth(values: Array) -> float:
    """So far below all heights that a share of it is too, and no sum of them overflows."""
    return float(jnp.finfo(values.dtype).max) ** 0.5
