"""Ashikhmin's generator: from any distribution of facets a reflectance whose energy is accounted for.

Its simple form (Ashikhmin et al. 2000, eq. 27) needs no class: `Lambertian(k_d * rho_d) + k_s *
Microfacet(ndf, Schlick(f0))` with k_d + k_s ≤ 1. Here is the one that fixes both weights by itself.
"""

from collections.abc import Callable
from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxbrdf.arrays import Domain, Parameter, Range, parameter, per_channel
from jaxbrdf.brdf.base import AbstractBRDF, AbstractSum, both_above
from jaxbrdf.brdf.facet_scattering import facet_nodes
from jaxbrdf.brdf.microfacet import Microfacet
from jaxbrdf.directions import Direction, as_directions, cos_theta, dot, reflect
from jaxbrdf.fresnel import Schlick
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.tabulated_area import (
    TabulatedArea,
    interpolate,
    polar_nodes,
    polar_position,
    tabulate_projected_area,
)
from jaxbrdf.quadrature import hemisphere
from jaxbrdf.shadowing import AbstractShadowing, Uncorrelated
from jaxbrdf.special import ORDER, safe_divide, safe_sqrt

_SHARE = Domain(0.0, 1.0)


class HemisphericalReflectance(eqx.Module):
    r"""How much light mirror facets with Schlick's Fresnel term reflect in all, of light along w:

        R(w) = ∫ F D G / (4 (w·n)) dw' = R_0(w) + f_0 (R_1(w) − R_0(w))

    Ashikhmin et al. 2000, eq. 29; made by `tabulate_reflectance`. `values` (2, P, A) hold R_0 and R_1, that
    of f_0 = 0 and 1, from the horizon to the normal and at A even azimuths from 0 on (one, where the
    distribution is isotropic). `grazing` is the cosine below which the polar nodes are evenly spaced. Either
    may have an axis of channels more.
    """

    values: Float[Array, "2 P A *channels"] = parameter(rank=3)
    grazing: Parameter = parameter()

    def __call__(self, f0: ArrayLike, w: ArrayLike) -> Float[Array, "..."]:
        """R(w) above the horizon, (...), or (..., C) where `f0` or the table has C channels."""
        return _reflectance_of((self, Schlick(jnp.asarray(f0))), as_directions(w, "w"))

    def _at(self, f0: Float[Array, ""], w: Direction) -> Float[Array, "..."]:
        """R(w) by local polynomials of degree 5, for one channel; that of the horizon below it."""
        R_0, R_1 = self.values
        position = polar_position(jnp.maximum(cos_theta(w), 0), len(R_0), self.grazing)
        return interpolate(R_0 + f0 * (R_1 - R_0), position, w)


@per_channel
def _reflectance_of(models, w):
    """Table and Fresnel term may both carry channels."""
    table, fresnel = models
    return table._at(fresnel.f0, w)


def tabulate_reflectance(
    ndf: AbstractNDF,
    shadowing: AbstractShadowing = Uncorrelated(),  # noqa: B008  # it has no parameters
    nodes: tuple[int, int] | None = None,
    facets: int = 8192,
) -> HemisphericalReflectance:
    r"""R_0 and R_1 of mirror facets with this distribution and shadowing; see `HemisphericalReflectance`.

        R_F(w) = ⟨F(w·m) G(w, w') / G1(w)⟩,   w' = 2 (w·m) m − w

    over the facets that w sees: R_1 ≤ 1 with `Uncorrelated` and `AzimuthCorrelated` shadowing. `nodes` is the
    number of polar angles from the horizon to the normal and that of azimuths: (65, 1) of an isotropic
    distribution, (33, 48) of another, unless given; the paper takes (10, 20). `facets` is the number of
    normals that the mean is taken over, see `facet_nodes`. σ is tabulated, if it is not yet.

    Absolute error of R: 1e-4 for isotropic distributions (`Velvet` 5e-4) of any width from 1e-5 on; 1e-3 for
    Beckmann 0.05 × 0.5 and Gaussians 0.1 × 0.2 to 0.1 × 1; 4e-3 for cylinders and grooves of width 0.1, where
    R bends sharply with the azimuth. Differentiable by the parameters of both. Raises ValueError for fewer
    than 6 polar angles, or fewer than 6 azimuths of an anisotropic distribution.
    """
    polar, azimuths = nodes or ((65, 1) if ndf.is_isotropic else (33, 48))
    if polar < ORDER or (azimuths < ORDER and not (azimuths == 1 and ndf.is_isotropic)):
        raise ValueError(
            f"nodes must hold at least {ORDER} polar angles and {ORDER} azimuths, or 1 azimuth where the "
            f"distribution is isotropic; found {nodes}"
        )
    return HemisphericalReflectance(*_tabulator(polar, azimuths, facets)((ndf, shadowing)))


@lru_cache
def _tabulator(polar: int, azimuths: int, facets: int) -> Callable[..., tuple[Array, Array]]:
    """The function from a distribution and its shadowing to the two fields of a table."""

    @eqx.filter_jit
    @per_channel
    def table(models):
        ndf, shadowing = models
        ndf = ndf if isinstance(ndf, TabulatedArea) else tabulate_projected_area(ndf)
        m, area = facet_nodes(ndf, facets)

        @jax.checkpoint
        def reflected(w):
            w = w[None, :]
            cosine = jnp.maximum(dot(m, w), 0)
            seen = area * cosine
            G = shadowing(ndf, reflect(w, m), w)
            share = seen / jnp.sum(seen) * G * (ndf._projected_area(w) / cos_theta(w))
            return jnp.stack([jnp.sum(share * (1 - cosine) ** 5), jnp.sum(share)])

        w = _nodes(polar, azimuths, ndf.grazing)
        R = jax.lax.map(reflected, w.reshape(-1, 3)).reshape(polar, azimuths, 2)
        return jnp.moveaxis(R, -1, 0), ndf.grazing

    return table


def _nodes(polar: int, azimuths: int, grazing: Float[Array, ""]) -> Float[Array, "P A 3"]:
    """The directions of a table; those on the horizon a thousandth of a step above it."""
    cos = polar_nodes(polar, grazing)
    cos = jnp.maximum(cos, jnp.maximum(1e-3 * cos[1], 2 * jnp.finfo(cos.dtype).tiny ** (1 / 6)))[:, None]
    phi = jnp.arange(azimuths, dtype=cos.dtype)[None, :] * (2 * jnp.pi / azimuths)
    sin = safe_sqrt(1 - cos**2)
    return jnp.stack(jnp.broadcast_arrays(sin * jnp.cos(phi), sin * jnp.sin(phi), cos), axis=-1)


class CoupledDiffuse(AbstractBRDF):
    r"""What mirror facets leave over, scattered: reciprocal, and no more than there is.

        f(wi, wo) = c ρ_d (a − R(wi))+ (a − R(wo))+,   1/c = ∫ (a − R(w))+ (w·n) dw

    Ashikhmin et al. 2000, eq. 28 to 30, after Shirley et al. 1997. With this c its albedo is ρ_d (a − R(w))+:
    for a = ρ_d = 1 facets and diffuse term together reflect all light, from every direction. `available` a is
    the share of light that is not absorbed, `f0` that of R.
    """

    reflectance: HemisphericalReflectance
    f0: Parameter = parameter(domain=_SHARE)
    rho_d: Parameter = parameter(domain=_SHARE)
    available: Parameter = parameter(domain=_SHARE, default=1.0)

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        left_over = self.rho_d * self._left(wi) * self._left(wo)
        return jnp.where(both_above(wi, wo), safe_divide(left_over, self._total()), 0)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return self.rho_d * self._left(wo)

    def _left(self, w: Direction) -> Float[Array, "..."]:
        """(a − R(w))+."""
        return jnp.maximum(self.available - self.reflectance._at(self.f0, w), 0)

    def _total(self) -> Float[Array, ""]:
        """1/c."""
        azimuths = self.reflectance.values.shape[2]
        w, d_omega = (a.astype(self.f0.dtype) for a in hemisphere(48, azimuths))
        return jnp.sum(self._left(w) * cos_theta(w) * d_omega)


class GeneratedBRDF(AbstractSum):
    r"""Mirror facets of any distribution, and a diffuse term of the light that they leave over:

        f(wi, wo) = F D G / (4 cos θ_i cos θ_o) + c (1 − R(wi))+ (1 − R(wo))+ ρ_d
        F = f_0 + (1 − f_0)(1 − wi·h)^5

    Ashikhmin et al. 2000, eq. 26, 30 and 31; see `Microfacet` and `CoupledDiffuse`. `f0` and `rho_d` in
    [0, 1] are (), or (C,), else ValueError. The generation is `tabulate_reflectance(ndf, shadowing)`, done
    when the model is made unless its result is handed over as `reflectance`; it belongs to this distribution
    and shadowing: one that is changed afterwards (by a fit, say) needs a new model. Tabulate a costly σ
    first, `tabulate_projected_area`. Not for `Unshadowed` facets, which reflect more light than they get.
    """

    ndf: AbstractNDF
    shadowing: AbstractShadowing
    reflectance: HemisphericalReflectance
    f0: Parameter = parameter(domain=_SHARE, fitted=Range(0.0, 1.0))
    rho_d: Parameter = parameter(domain=_SHARE, fitted=Range(0.0, 1.0))

    def __init__(
        self,
        ndf: AbstractNDF,
        f0: ArrayLike,
        rho_d: ArrayLike,
        shadowing: AbstractShadowing = Uncorrelated(),  # noqa: B008
        reflectance: HemisphericalReflectance | None = None,
    ):
        self.ndf, self.shadowing = ndf, shadowing
        self.f0, self.rho_d = jnp.asarray(f0), jnp.asarray(rho_d)
        self.reflectance = tabulate_reflectance(ndf, shadowing) if reflectance is None else reflectance

    @property
    def parts(self) -> tuple[AbstractBRDF, ...]:
        facets = Microfacet(self.ndf, Schlick(self.f0), self.shadowing)
        return CoupledDiffuse(self.reflectance, self.f0, self.rho_d), facets


class GeneratedMetal(AbstractSum):
    r"""`GeneratedBRDF` of a metal, whose diffuse light has been reflected by several facets:

        f(wi, wo) = F D G / (4 cos θ_i cos θ_o) + c (f_0 − R(wi))+ (f_0 − R(wo))+ f_0

    Ashikhmin et al. 2000, section 5.1: f_0 stands for 1 and for ρ_d, and what gets negative is 0. The paper
    does not repeat what c is then; here f_0 of what is left, f_0 − R(w), is scattered. `f0` in [0, 1], () or
    (C,), else ValueError; for the others see `GeneratedBRDF`.
    """

    ndf: AbstractNDF
    shadowing: AbstractShadowing
    reflectance: HemisphericalReflectance
    f0: Parameter = parameter(domain=_SHARE, fitted=Range(0.0, 1.0))

    def __init__(
        self,
        ndf: AbstractNDF,
        f0: ArrayLike,
        shadowing: AbstractShadowing = Uncorrelated(),  # noqa: B008
        reflectance: HemisphericalReflectance | None = None,
    ):
        self.ndf, self.shadowing, self.f0 = ndf, shadowing, jnp.asarray(f0)
        self.reflectance = tabulate_reflectance(ndf, shadowing) if reflectance is None else reflectance

    @property
    def parts(self) -> tuple[AbstractBRDF, ...]:
        facets = Microfacet(self.ndf, Schlick(self.f0), self.shadowing)
        return CoupledDiffuse(self.reflectance, self.f0, self.f0, self.f0), facets
