"""A distribution whose projected area is looked up in a table instead of integrated."""

from collections.abc import Callable
from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import Parameter, parameter, per_channel
from jaxbrdf.directions import Direction, cos_theta, spherical
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.special import lagrange_stencil, safe_arctan2, safe_sqrt


class TabulatedArea(AbstractNDF):
    """A distribution with its projected area tabulated; made by `tabulate_projected_area`.

    `area` (2P − 1, A) holds σ over the whole sphere: from the nadir to the normal, and at A even azimuths
    from 0 on (one, where the distribution is isotropic). `grazing` is the cosine below which the polar nodes
    are evenly spaced. Either may have an axis of channels more.
    """

    ndf: AbstractNDF
    area: Float[Array, "P A *channels"] = parameter(rank=2)
    grazing: Parameter = parameter()

    @property
    def is_isotropic(self) -> bool:
        return self.ndf.is_isotropic

    def _density(self, m: Direction) -> Float[Array, "..."]:
        return self.ndf(m)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        """σ(w) by local polynomials of degree 5."""
        polar, azimuths = self.area.shape
        upper = (polar + 1) // 2
        position = polar_position(cos_theta(w), upper, self.grazing) + (upper - 1)
        rows, row_weights = lagrange_stencil(position, polar)
        if azimuths == 1:
            return jnp.sum(self.area[rows, 0] * row_weights, axis=-1)
        phi = safe_arctan2(w[..., 1], w[..., 0])
        columns, weights = lagrange_stencil(phi * (azimuths / (2 * jnp.pi)), azimuths, periodic=True)
        near = self.area[rows[..., :, None], columns[..., None, :]]
        return jnp.sum(near * row_weights[..., :, None] * weights[..., None, :], axis=(-2, -1))

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        return self.ndf.sample(u)


def tabulate_projected_area(ndf: AbstractNDF, nodes: tuple[int, int] | None = None) -> TabulatedArea:
    """The same distribution with σ(w) tabulated, for evaluation at many directions; see `TabulatedArea`.

    `nodes` is the number of polar angles from the horizon to the normal, or that and the number of azimuths:
    193 of an isotropic distribution, (65, 192) of another, unless given; at least 6 of each. Ashikhmin et al.
    2000, section 5.2, take 200: (10, 20).
    """
    polar, azimuths = nodes or ((193, 1) if ndf.is_isotropic else (65, 192))
    area, grazing = _tabulator(polar, azimuths)(ndf)
    return TabulatedArea(ndf, area, grazing)


@lru_cache
def _tabulator(upper: int, azimuths: int) -> Callable[[AbstractNDF], tuple[Array, Array]]:
    """The function from a distribution to its σ at the nodes and to the cosine that places them: 0.4 times
    the least σ at the horizon, where the least rough azimuth begins to be masked."""

    @eqx.filter_jit
    @per_channel
    def table(ndf):
        dtype = jnp.result_type(float, *jax.tree.leaves(ndf))
        phi = jnp.arange(azimuths, dtype=dtype) * (2 * jnp.pi / azimuths)
        on_horizon = ndf.projected_area(spherical(jnp.full_like(phi, jnp.pi / 2), phi))
        grazing = jnp.clip(0.4 * jnp.min(on_horizon), 1e-9, 1)
        cos = polar_nodes(upper, grazing)
        theta = jnp.arccos(jnp.concatenate([-cos[:0:-1], cos]))
        return ndf.projected_area(spherical(theta[:, None], phi[None, :])), grazing

    return table


def polar_nodes(n: int, grazing: Parameter | float) -> Float[Array, " n"]:
    """The cosines at whole positions 0 … n − 1: from the horizon to the normal."""
    t = (
        grazing
        / 2
        * jnp.sinh(jnp.linspace(0, 1, n, dtype=jnp.result_type(float, grazing)) * jnp.arcsinh(2 / grazing))
    )
    return 2 * t / (1 + t**2)


def polar_position(c: Float[Array, "..."], n: int, grazing: Parameter | float) -> Float[Array, "..."]:
    """Where the cosine c lies among the nodes, below the horizon on the negative side: evenly in
    arsinh(2 t / grazing), t = tan((π/2 − θ) / 2)."""
    t = c / (1 + safe_sqrt(1 - c**2))
    return jnp.arcsinh(t * (2 / grazing)) * ((n - 1) / jnp.arcsinh(2 / grazing))
