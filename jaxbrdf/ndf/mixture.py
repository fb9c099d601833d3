"""Mixtures of distributions, weighed by how much facet area each has."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxbrdf.arrays import NON_NEGATIVE, Simplex, parameter, precision
from jaxbrdf.directions import Direction
from jaxbrdf.ndf.base import AbstractNDF, pick
from jaxbrdf.quadrature import hemisphere


class Mixture(AbstractNDF):
    r"""D = Σ_i s_i D_i, and so is σ. `shares` s_i ≥ 0 are of *projected* area and sum to 1: (K,), or (K, C).

    `mixture` makes one from weights of facet area.
    """

    shares: Float[Array, "K *channels"] = parameter(rank=1, domain=NON_NEGATIVE, fitted=Simplex())
    ndfs: tuple[AbstractNDF, ...]  # type: ignore[misc]  # `parameter()` is no default

    @property
    def is_isotropic(self) -> bool:
        return all(ndf.is_isotropic for ndf in self.ndfs)

    def _density(self, m: Direction) -> Float[Array, "..."]:
        return sum(s * ndf._density(m) for s, ndf in zip(self.shares, self.ndfs, strict=True))

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        return sum(s * ndf._projected_area(w) for s, ndf in zip(self.shares, self.ndfs, strict=True))

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        weights = jnp.broadcast_to(self.shares, (*u.shape[:-1], len(self.ndfs)))
        index, rest = pick(weights, u[..., 0])
        u = jnp.stack([rest, u[..., 1]], axis=-1)
        samples = jnp.stack([ndf._sample(u) for ndf in self.ndfs])
        return jnp.take_along_axis(samples, index[None, ..., None], axis=0)[0]


def mixture(weights: ArrayLike | Sequence[float], ndfs: Sequence[AbstractNDF]) -> Mixture:
    r"""A mixture of distributions by weights of facet *area*, Ashikhmin's p(h) = Σ_i w_i p_i(h).

        D = Σ_i s_i D_i,   s_i = w_i ⟨h·n⟩_i / Σ_j w_j ⟨h·n⟩_j,   1 / ⟨h·n⟩_i = ∫ D_i dm

    `weights` ≥ 0, (K,) or (K, C), need not sum to 1. Ashikhmin et al. 2000, section 6.3: satin is
    mixture([0.7, 0.3], [GaussianCylinder(0.1), GaussianCylinder(0.3)]). Raises ValueError for negative
    weights, for none above 0, or where their number is not that of the distributions.
    """
    ndfs = tuple(ndfs)
    weights = jnp.asarray(weights, precision(ndfs))
    if weights.ndim == 0 or not ndfs or len(weights) != len(ndfs):
        raise ValueError(
            f"mixture takes one weight for each distribution; found weights of shape {weights.shape} and "
            f"{len(ndfs)} distributions"
        )
    if not isinstance(weights, jax.core.Tracer) and not (
        np.all(weights >= 0) and np.all(np.sum(weights, axis=0) > 0)
    ):
        raise ValueError(f"the weights of a mixture must be at least 0, and one above; found {weights}")
    areas = jnp.stack(jnp.broadcast_arrays(*[facet_area(ndf) for ndf in ndfs]))
    shares = weights.reshape(weights.shape + (1,) * (areas.ndim - weights.ndim)) / areas
    return Mixture(shares / jnp.sum(shares, axis=0, keepdims=True), ndfs)


def facet_area(ndf: AbstractNDF) -> Float[Array, "..."]:
    r"""∫ D dm, the area of all facets per unit of macro-surface, 1 / ⟨h·n⟩; (), or (C,).

    Cauchy's theorem: a facet's mean projected area over all directions is a quarter of its area, so
    ∫ σ(w) dw = π ∫ D dm. To 2e-9 for cylinders, whose σ bends most sharply with the azimuth.
    """
    w, weight = (a.astype(precision(ndf)) for a in hemisphere(64, 256))
    total = ndf.projected_area(w) + ndf.projected_area(-w)
    return jnp.tensordot(weight, total, axes=1) / jnp.pi
