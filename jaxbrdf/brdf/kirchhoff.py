"""Reflectance of a measured height map by the scalar wave theory of Kirchhoff."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.arrays import NON_NEGATIVE, POSITIVE, Parameter, parameter
from jaxbrdf.brdf.base import AbstractBRDF, both_above, cosine_product
from jaxbrdf.brdf.microfacet import mirrored_density, sample_mirrored, typical_reflectance
from jaxbrdf.directions import Direction, dot, half_vector
from jaxbrdf.fresnel import AbstractFresnel
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.tabulated import TabulatedNDF
from jaxbrdf.shadowing import AbstractShadowing, Uncorrelated


class KirchhoffBRDF(AbstractBRDF):
    r"""The microfacet formula with the Kirchhoff distribution D_K in place of that of the facets.

        f(wi, wo) = D_K(4π h / λ_q) F(θ_d) G(wi, wo) / (4 cos θ_i cos θ_o),   λ_q = λ / cos θ_d

    Dong, Walter, Marschner & Greenberg 2015, eq. 5 and 8 (their θ_d is the whole angle between wi and wo,
    ours half of it). `values` (L, N, N) ≥ 0 holds D_K in 1/sr over the disk, each table laid out as in
    `TabulatedNDF`, at the effective wavelengths `wavelengths_q` (L,), increasing. Between the tables D_K is
    linear in 1/λ_q, which is proportional to the length of the wave vector; outside them the nearest one is
    taken. `wavelengths` λ, () or (C,), are the channels of the result. All wavelengths are in micrometres.

    Shadowing, which the theory lacks, takes its projected area from `ndf`, by default `mean_ndf`. That one
    sums over all cells for each direction: for many pairs or large tables tabulate it once,
    `ndf=tabulate_projected_area(brdf.mean_ndf)`. Sampled by the normals of `mean_ndf`. Raises ValueError for
    other shapes, wavelengths that do not increase or are not positive, and negative values.
    """

    values: Float[Array, "L N N"] = parameter(rank=3, domain=NON_NEGATIVE)
    wavelengths_q: Float[Array, " L"] = parameter(rank=1, domain=POSITIVE)
    wavelengths: Parameter = parameter(domain=POSITIVE)
    fresnel: AbstractFresnel  # type: ignore[misc]  # `parameter()` is no default: all four are required
    shadowing: AbstractShadowing = Uncorrelated()
    ndf: AbstractNDF | None = None

    def __check_init__(self):
        tables, rows, columns = self.values.shape if self.values.ndim == 3 else (0, 0, 0)
        if not (tables and rows and rows == columns):
            raise ValueError(f"KirchhoffBRDF: values must have shape (L, N, N); found {self.values.shape}")
        if self.wavelengths_q.shape != (tables,):
            raise ValueError(
                f"KirchhoffBRDF: wavelengths_q must hold one wavelength for each of the {tables} tables, "
                f"shape ({tables},); found {self.wavelengths_q.shape}"
            )
        if isinstance(self.wavelengths_q, jax.core.Tracer):
            return
        if not np.all(np.diff(self.wavelengths_q) > 0):
            raise ValueError(
                f"KirchhoffBRDF: wavelengths_q must increase; found {self.wavelengths_q}. "
                "Sort the tables by wavelength"
            )

    @property
    def mean_ndf(self) -> TabulatedNDF:
        """The mean of the tables as a distribution of normals; not normalised."""
        return TabulatedNDF(jnp.mean(self.values, axis=0))

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        h = half_vector(wi, wo)
        D = self._distribution(h, dot(wi, h) / self.wavelengths)
        F = self.fresnel(dot(wi, h))
        G = self.shadowing(self.mean_ndf if self.ndf is None else self.ndf, wi, wo)
        return jnp.where(both_above(wi, wo), F * D * G / (4 * cosine_product(wi, wo)), 0)

    def _distribution(self, h: Direction, wavenumber: Float[Array, "..."]) -> Float[Array, "..."]:
        """D_K at h and wavenumber 1/λ_q: the sum over the tables, of which two neighbours have a share."""
        tables = jnp.arange(len(self.values), dtype=wavenumber.dtype)
        position = jnp.interp(-wavenumber, -1 / self.wavelengths_q, tables)

        def add(total, table):
            index, values = table
            share = jnp.maximum(1 - jnp.abs(position - index), 0)
            return total + share * TabulatedNDF(values)._density(h), None

        return jax.lax.scan(add, jnp.zeros_like(position), (tables, self.values))[0]

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        return sample_mirrored(self.mean_ndf, u, wo)

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return mirrored_density(self.mean_ndf, wi, wo)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return typical_reflectance(self.fresnel, wo)
