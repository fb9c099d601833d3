r"""Smith's masking of a whole family of distributions, tabulated over its shape parameters.

A fit asks for σ(w) at the same directions again and again, only the shape changes. log σ is a smooth
function of shape and direction, so a local polynomial replaces the integral at a small part of its cost.
"""

from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fitting.parameters import ShapeSpace, combinations
from jaxbrdf.arrays import parameter
from jaxbrdf.directions import Direction, cos_theta
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.tabulated_area import polar_nodes, polar_position
from jaxbrdf.special import lagrange_stencil

_SHAPES = {1: (161,), 2: (97, 33)}  # nodes over the range of each shape parameter
_COSINES = 193
_GRAZING = 1e-5  # the cosine below which they are evenly spaced


class MaskingTable(eqx.Module):
    r"""log σ of a family of isotropic distributions at K fixed directions, by local polynomials of degree 5.

    Measured against the integral for the shifted gamma family (alpha in [1e-5, 2], p in [0, 3]): see
    tests/fitting/test_masking.py, which holds σ to 3e-6 up to 80° and 6e-5 beyond.
    """

    values: Float[Array, "*shapes M"]
    nearest: Int[Array, "K order"]
    weights: Float[Array, "K order"]

    def log_area(self, t: Float[Array, " n"]) -> Float[Array, " K"]:
        """log σ at the table's directions for the shape t."""
        return jnp.sum(_at_shape(self.values, t)[self.nearest] * self.weights, axis=-1)


def masking_table(space: ShapeSpace, cos_w: Float[np.ndarray, " K"]) -> MaskingTable:
    """The table of a family of isotropic distributions for directions of polar cosine `cos_w` in (0, 1].

    Few directions are interpolated once, here; many at each look-up.
    """
    nearest, weights = _stencil(jnp.asarray(cos_w))
    table = log_areas(space)
    if len(cos_w) > _COSINES:
        return MaskingTable(jnp.asarray(table), nearest, weights)
    here = np.einsum("...ko,ko->...k", table[..., np.asarray(nearest)], weights)
    itself = np.arange(len(cos_w))[:, None]
    return MaskingTable(jnp.asarray(here), jnp.asarray(itself), jnp.ones(itself.shape))


class LookedUpNDF(AbstractNDF):
    """A distribution whose σ is looked up in the table of its family: only for evaluation."""

    ndf: AbstractNDF
    log_area: Float[Array, " M"] = parameter(rank=1)

    @property
    def is_isotropic(self) -> bool:
        return True

    def _density(self, m: Direction) -> Float[Array, "..."]:
        return self.ndf._density(m)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        nearest, weights = _stencil(cos_theta(w))
        return jnp.exp(jnp.sum(self.log_area[nearest] * weights, axis=-1))

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        return self.ndf._sample(u)


def looked_up(ndf: AbstractNDF, family: Float[Array, "*shapes M"]) -> LookedUpNDF:
    """The same distribution with σ to the accuracy of `log_areas`, which gives the `family` table."""
    return LookedUpNDF(ndf, _at_shape(family, ShapeSpace(type(ndf)).shape_of(ndf)))


def _stencil(cos_w: Float[Array, "..."]) -> tuple[Int[Array, "... order"], Float[Array, "... order"]]:
    """The nodes next to some cosines and their weights."""
    return lagrange_stencil(polar_position(cos_w, _COSINES, _GRAZING), _COSINES)


def _at_shape(table: Float[Array, "*shapes M"], t: Float[Array, " n"]) -> Float[Array, " M"]:
    """The rows of a table at the shape t."""
    stencils = [lagrange_stencil(jnp.clip(t[k], 0, 1) * (n - 1), n) for k, n in enumerate(table.shape[:-1])]
    first = [nodes[0] for nodes, _ in stencils]
    size = [len(nodes) for nodes, _ in stencils]
    local = jax.lax.dynamic_slice(table, (*first, 0), (*size, table.shape[-1]))
    for _, weights in stencils:
        local = jnp.tensordot(weights, local, axes=1)
    return local


@lru_cache
def log_areas(space: ShapeSpace) -> np.ndarray:
    """log σ at all nodes, from the integral: (*shapes, cosines)."""
    counts = _SHAPES[len(space.names)]
    shapes = combinations(*[np.linspace(0, 1, n) for n in counts])
    cos_w = np.asarray(polar_nodes(_COSINES, _GRAZING))
    directions = jnp.stack([np.sqrt(np.maximum(1 - cos_w**2, 0)), 0 * cos_w, cos_w], axis=-1)
    area = jax.jit(
        lambda shapes: jax.lax.map(lambda t: space.ndf(t).projected_area(directions), shapes, batch_size=64)
    )
    return np.log(area(shapes)).reshape(*counts, _COSINES)
