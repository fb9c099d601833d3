"""The facets of a height map: the squares between its points."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxbrdf.directions import Direction
from jaxbrdf.surface.heightfield import Heightfield

Squares = Float[Array, "rows columns"]


class Facets(NamedTuple):
    """The squares between the points of a map, (ny − 1, nx − 1): the mean height and the mean slopes of the
    four corners; are all of them known?"""

    height: Squares
    slope_x: Squares
    slope_y: Squares
    known: Bool[Array, "rows columns"]

    def towards(self, w: Direction) -> Squares:
        """(w·m) / (m·n) = w_z − w_x ∂z/∂x − w_y ∂z/∂y: a facet's area as w sees it over that on the map."""
        return w[2] - w[0] * self.slope_x - w[1] * self.slope_y


def facets(heightfield: Heightfield) -> Facets:
    """The facets of a map."""
    z, known = heightfield.heights, heightfield.valid
    along_x, along_y = jnp.diff(z, axis=1) / heightfield.dx, jnp.diff(z, axis=0) / heightfield.dy
    return Facets(
        (z[:-1, :-1] + z[:-1, 1:] + z[1:, :-1] + z[1:, 1:]) / 4,
        (along_x[:-1] + along_x[1:]) / 2,
        (along_y[:, :-1] + along_y[:, 1:]) / 2,
        known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:],
    )
