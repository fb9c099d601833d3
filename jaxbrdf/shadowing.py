"""How much of the surface both directions see: small functions of an NDF's projected area, or of none."""

import math
from abc import abstractmethod
from collections.abc import Callable

import jax.numpy as jnp
from jax.scipy.special import erfc
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Parameter, Parametric, floats, in_chunks, parameter, per_channel
from jaxbrdf.directions import (
    Direction,
    above_horizon,
    as_directions,
    cos_theta,
    dot,
    or_normal,
    safe_normalize,
    same_rank,
)
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.special import (
    gauss_legendre,
    safe_arccos,
    safe_arctan2,
    safe_divide,
    safe_sqrt,
)


class AbstractShadowing(Parametric):
    """A shadowing and masking term: called with (ndf, wi, wo), gives G in [0, 1]; (...), or (..., C).

    Raises ValueError for directions that are not unit vectors (outside jit).
    """

    def __call__(self, ndf: AbstractNDF, wi: ArrayLike, wo: ArrayLike) -> Float[Array, "..."]:
        """G(wi, wo), the fraction of facets that both directions see; 0 where one is below the horizon."""
        wi, wo = same_rank(as_directions(wi, "wi"), as_directions(wo, "wo"))
        return _shadow((self, ndf), wi, wo)

    @abstractmethod
    def _shadow(self, ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        """G for one channel and directions above the horizon."""


@per_channel
def _shadow(models, wi, wo):
    """Term and distribution may both carry channels. No term meets a direction below the horizon, but n."""
    shadowing, ndf = models
    G = shadowing._shadow(ndf, or_normal(wi), or_normal(wo))
    return jnp.where(above_horizon(cos_theta(wi)) & above_horizon(cos_theta(wo)), G, 0)


def smith_G1(ndf: AbstractNDF, w: Direction) -> Float[Array, "..."]:
    """Smith's masking G1(w) = min(1, (w·n)+ / σ(w)), 0 below the horizon; (...), or (..., C)."""
    sigma = ndf.projected_area(w)
    cos_w = jnp.maximum(cos_theta(w), 0)
    return jnp.minimum(1, safe_divide(cos_w.reshape(cos_w.shape + (1,) * (sigma.ndim - cos_w.ndim)), sigma))


class Unshadowed(AbstractShadowing):
    """No shadowing: G = 1 wherever both directions are above the horizon."""

    def _shadow(self, ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return jnp.ones_like(cos_theta(wi) * cos_theta(wo))


class Uncorrelated(AbstractShadowing):
    """Smith's shadowing with independent heights: G = G1(wi) G1(wo) (Bagher 2012, section 3.2)."""

    def _shadow(self, ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return smith_G1(ndf, wi) * smith_G1(ndf, wo)


class HeightCorrelated(AbstractShadowing):
    r"""Smith's shadowing with one height for both directions: a facet high up escapes on both sides.

        G = 1 / (1 + Λ(wi) + Λ(wo)),   Λ(w) = max(0, σ(w) / (w·n) − 1) = 1 / G1(w) − 1
          = G1(wi) G1(wo) / (G1(wi) + G1(wo) − G1(wi) G1(wo))

    Ross, Dion & Potvin 2005; Heitz 2014, eq. 99. The last form stays finite at grazing angles. G lies between
    G1(wi) G1(wo) and min(G1(wi), G1(wo)). Λ is clipped as skewed distributions can have σ(w) < w·n.
    """

    def _shadow(self, ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        a, b = smith_G1(ndf, wi), smith_G1(ndf, wo)
        return safe_divide(a * b, a + b - a * b)


class AzimuthCorrelated(AbstractShadowing):
    r"""Shadowing between independent and shared, by the azimuth φ between the two directions.

        G = (1 − t) G1(wi) G1(wo) + t min(G1(wi), G1(wo)),   t = exp(−φ² / (2 width²))

    φ in [0, π] is the angle between the projections of wi and wo on the tangent plane. Ashikhmin, Premože &
    Shirley 2000, eq. 14. `width` in radians, the paper's 15° unless given. At normal incidence, where φ is
    undefined and taken for 0, nothing is masked and t does not matter. Raises ValueError unless width > 0.
    """

    width: Parameter = parameter(domain=POSITIVE, default=math.radians(15))

    def _shadow(self, ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        a, b = smith_G1(ndf, wi), smith_G1(ndf, wo)
        t = jnp.exp(-((_azimuth_between(wi, wo) / self.width) ** 2) / 2)
        return (1 - t) * a * b + t * jnp.minimum(a, b)


def _azimuth_between(wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """φ_o − φ_i in [−π, π]; 0 with gradient 0 where one of them is undefined.

    Signed, so that the square is smooth at 0; of unit vectors, so that no digit is lost close to the normal.
    """
    p, q = safe_normalize(wi[..., :2]), safe_normalize(wo[..., :2])
    sine = p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]
    return safe_arctan2(sine, dot(p, q))


class VCavity(AbstractShadowing):
    r"""Long symmetric grooves whose two sides are the facet h and its mirror image; the NDF is not asked.

        G = min(1, 2 (n·h)(n·wo) / (wo·h), 2 (n·h)(n·wi) / (wo·h))

    Torrance & Sparrow 1967. With ‖wi + wo‖² = q, n·h = (cos θ_i + cos θ_o) / √q and wo·h = √q / 2, which
    makes it the same to the last digit with the directions exchanged:
    G = min(1, 4 (cos θ_i + cos θ_o) min(cos θ_i, cos θ_o) / q).
    """

    def _shadow(self, ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return v_cavity(wi, wo)


def v_cavity(wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """G of `VCavity` for directions above the horizon."""
    cos_i, cos_o, both = cos_theta(wi), cos_theta(wo), wi + wo
    return jnp.minimum(1, 4 * (cos_i + cos_o) * jnp.minimum(cos_i, cos_o) / dot(both, both))


class FreeTravel(AbstractShadowing):
    r"""Sun's free-travel probability of rays that leave a Gaussian surface; the NDF is not asked.

        G = Γ_0(θ_i) Γ_0(θ_o),   Γ_0(θ) = exp(−tan θ / (√(2π) s) · exp(−s² / (4 tan²θ)))

    Sun 2002, eq. 3.4.23 and 3.5.2. `smoothness` s = τ/σ > 0 is the correlation length over the rms height,
    the correlation exp(−x²/τ²): slopes are those of a Beckmann distribution of roughness 2/s. Γ_0 is the
    probability from mean height, simplified; `probability_from` any height is not. The rate at which rays
    are blocked rests on dimensions alone (eq. 3.4.21). Raises ValueError unless smoothness > 0.
    """

    smoothness: Parameter = parameter(domain=POSITIVE)

    def _shadow(self, ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return self.probability(cos_theta(wi)) * self.probability(cos_theta(wo))

    @per_channel
    def probability(self, cos_w: ArrayLike) -> Float[Array, "..."]:
        """Γ_0(θ) at cos_w = cos θ, (...), or (..., C): 1 at the normal, 0 at and below the horizon."""
        return self._escape(
            lambda t: t / math.sqrt(2 * math.pi) * jnp.exp(-1 / (4 * t**2)),
            floats(cos_w),
        )

    @per_channel
    def probability_from(self, height: ArrayLike, cos_w: ArrayLike) -> Float[Array, "..."]:
        r"""Γ(h, θ) from a height h in units of σ, by quadrature; the two broadcast to (...), or (..., C).

            Γ(h, θ) = exp(−∫_0^∞ Q(ξ) dξ),   Q = erfc(w/√2) / 2,   C = exp(−ξ²),   ξ = x/τ
            w = (h (1 − C) + ξ s cot θ) / √(1 − C²)

        Sun 2002, eq. 3.4.3 to 3.4.15 and 3.4.21, without the straight line of eq. 3.4.18. Absolute error
        below 1e-13 in float64 for heights in [−8, 8].
        """
        return in_chunks(
            lambda h, c: self._escape(lambda t: _blockings(h, t), c),
            floats(height),
            floats(cos_w),
        )

    def _escape(self, exponent: Callable[[Array], Array], cos_w: Float[Array, "..."]) -> Float[Array, "..."]:
        """exp(−exponent(t)), t = tan θ / s; 1 where t < 1/30: the exponent is below 1e-90 there."""
        above = above_horizon(cos_w)
        cos = jnp.where(above, cos_w, 1)
        t = safe_sqrt(1 - cos**2) / (cos * self.smoothness)
        steep = t < 1 / 30
        probability = jnp.exp(-exponent(jnp.where(steep, 1, t)))
        return jnp.where(above, jnp.where(steep, 1, probability), 0)


def _blockings(h: Float[Array, ""], t: Float[Array, ""]) -> Float[Array, ""]:
    r"""∫_0^∞ Q(ξ) dξ: Gauss–Legendre up to u, where w > 10 or C < 1e-15; beyond it w = h + ξ/t:

    ∫_u^∞ Q(ξ) dξ = t (exp(−v²/2) / √(2π) − v erfc(v/√2) / 2),   v = h + u/t
    """
    nodes, weights = gauss_legendre(48, t.dtype)
    u = jnp.minimum(6, (10 + jnp.maximum(-h, 0)) * t)
    xi = u * nodes
    w = h * jnp.sqrt(jnp.tanh(xi**2 / 2)) + xi / (t * jnp.sqrt(-jnp.expm1(-2 * xi**2)))
    v = h + u / t
    tail = jnp.exp(-(v**2) / 2) / math.sqrt(2 * math.pi) - v * _tail_probability(v)
    return u * jnp.sum(weights * _tail_probability(w)) + t * tail


def _tail_probability(w):
    """1 − G(w) of a standard Gaussian variable."""
    return erfc(w / math.sqrt(2)) / 2


class ShiftedGammaShadowing(AbstractShadowing):
    r"""Bagher's closed approximation of the shifted gamma distribution's masking; the NDF is not asked.

        G1(θ) = 1 + λ (1 − exp(c (θ − θ_0)^k))   for θ > θ_0, else 1
        θ_0 = π/2 − (log(1 + 1/λ) / c)^{1/k},   so that G1(π/2) = 0;   G = G1(wi) G1(wo)

    Bagher et al. 2012, eq. 9. `lam`, `c`, `k` > 0; published c reach 1e109 with k in the hundreds, so
    c (θ − θ_0)^k is computed as an exponential. `fitting.fit_masking` finds the three for an NDF.
    """

    lam: Parameter = parameter()
    c: Parameter = parameter()
    k: Parameter = parameter()

    def _shadow(self, ndf: AbstractNDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return self.G1(cos_theta(wi)) * self.G1(cos_theta(wo))

    @property
    def theta_0(self) -> Float[Array, "..."]:
        """θ_0, the angle up to which nothing is masked; negative for rough materials."""
        return jnp.pi / 2 - jnp.exp((jnp.log(jnp.log1p(1 / self.lam)) - jnp.log(self.c)) / self.k)

    def G1(self, cos_w: Float[Array, "..."]) -> Float[Array, "..."]:
        """Masking towards a direction at polar cosine cos_w."""
        beyond = safe_arccos(cos_w) - self.theta_0
        masked = (beyond > 0) & (cos_w > 0)
        exponent = jnp.log(self.c) + self.k * jnp.log(jnp.where(masked, beyond, 1))
        growth = jnp.exp(jnp.where(masked, exponent, 0))
        return jnp.where(cos_w > 0, jnp.where(masked, 1 - self.lam * jnp.expm1(growth), 1), 0)
