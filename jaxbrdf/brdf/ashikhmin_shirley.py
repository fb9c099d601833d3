"""The anisotropic Phong reflectance of Ashikhmin & Shirley: a lobe, and a diffuse part that gives way."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import NON_NEGATIVE, Domain, Parameter, Range, parameter
from jaxbrdf.brdf.base import AbstractBRDF, AbstractSum, both_above
from jaxbrdf.brdf.microfacet import typical_reflectance
from jaxbrdf.directions import Direction, above_horizon, cos_theta, dot, reflect
from jaxbrdf.fresnel import AbstractFresnel, Schlick
from jaxbrdf.ndf.base import from_slopes, slopes
from jaxbrdf.special import log1p_over, safe_divide, safe_sqrt

_SHARE = Domain(0.0, 1.0)


class AshikhminShirley(AbstractSum):
    r"""The whole of it: `AshikhminShirleyDiffuse` and `AshikhminShirleyLobe` with Schlick's Fresnel term.

        f(wi, wo) = 28ρ_d/(23π) (1 − ρ_s) (1 − (1 − cos θ_i/2)^5) (1 − (1 − cos θ_o/2)^5)
                  + √((e_x+1)(e_y+1))/(8π) (n·h)^{e(φ_h)} F(h·wo) / ((h·wo) max(cos θ_i, cos θ_o))
        e(φ) = e_x cos²φ + e_y sin²φ,   F(c) = ρ_s + (1 − ρ_s)(1 − c)^5

    Ashikhmin & Shirley 2000, "An anisotropic Phong BRDF model". `rho_s`, the reflectance of the lobe at
    normal incidence, lies in [0, 1], the exponents are ≥ 0, else ValueError; without `exponent_y` it is
    isotropic. The albedo is at most 1 for ρ_d ≤ 1.
    """

    rho_d: Parameter = parameter(linear=True)
    rho_s: Parameter = parameter(domain=_SHARE, fitted=Range(0.0, 1.0))
    exponent_x: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(0.1, 1e6, log=True))
    exponent_y: Parameter | None = parameter(
        domain=NON_NEGATIVE, optional=True, fitted=Range(0.1, 1e6, log=True)
    )

    @property
    def parts(self) -> tuple[AbstractBRDF, ...]:
        lobe = AshikhminShirleyLobe(Schlick(self.rho_s), self.exponent_x, self.exponent_y)
        return AshikhminShirleyDiffuse(self.rho_d, self.rho_s), lobe


class AshikhminShirleyDiffuse(AbstractBRDF):
    r"""Diffuse light from below a glossy layer, which reflects the more the more grazing it is.

        f(wi, wo) = 28ρ_d/(23π) (1 − ρ_s) (1 − (1 − cos θ_i/2)^5) (1 − (1 − cos θ_o/2)^5)

    Ashikhmin & Shirley 2000. The albedo is ρ_d (1 − ρ_s) (1 − (1 − cos θ/2)^5). `rho_s` in [0, 1],
    else ValueError, is the reflectance of the layer at normal incidence.
    """

    rho_d: Parameter = parameter(linear=True)
    rho_s: Parameter = parameter(domain=_SHARE, fitted=Range(0.0, 1.0))

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        passed = _let_through(cos_theta(wi)) * _let_through(cos_theta(wo))
        f = 28 / (23 * jnp.pi) * self.rho_d * (1 - self.rho_s) * passed
        return jnp.where(both_above(wi, wo), f, 0)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return jnp.abs(self.rho_d) * (1 - self.rho_s) * _let_through(cos_theta(wo))


def _let_through(cos: Float[Array, "..."]) -> Float[Array, "..."]:
    return 1 - (1 - cos / 2) ** 5


class AshikhminShirleyLobe(AbstractBRDF):
    r"""The lobe alone, with any Fresnel term.

        f(wi, wo) = F(θ_d) p(h) / (4 cos θ_d max(cos θ_i, cos θ_o)),   cos θ_d = h·wo
        p(h) = √((e_x+1)(e_y+1))/(2π) (n·h)^{e(φ_h)},   e(φ) = e_x cos²φ + e_y sin²φ

    Ashikhmin & Shirley 2000, eq. 4; sampled as there by half vectors of density p. As f cos θ_i is at most F
    times the density of the samples, the albedo is at most 1 with any F ≤ 1. `exponent_x`, `exponent_y` ≥ 0,
    else ValueError; without `exponent_y` it is isotropic. A direction counts as above the horizon from a
    cosine of 1e-51 on, 5e-7 in single precision.

    Published fits are ρ_s times this: Ngan et al. 2005 with `Schlick(f0)`, Löw et al. 2012 with
    `Dielectric(eta)`.
    """

    fresnel: AbstractFresnel
    exponent_x: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(0.1, 1e6, log=True))
    exponent_y: Parameter | None = parameter(
        domain=NON_NEGATIVE, optional=True, fitted=Range(0.1, 1e6, log=True)
    )

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        above = above_horizon(cos_theta(wi)) & above_horizon(cos_theta(wo))
        larger_cos = jnp.where(above, jnp.maximum(cos_theta(wi), cos_theta(wo)), 1)
        F = self.fresnel(_cos_theta_d(wi, wo))
        return jnp.where(above, F * self._pdf(wi, wo) / larger_cos, 0)

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        """wo mirrored at h: tan φ_h = √((e_x+1)/(e_y+1)) tan 2πu_2, cos θ_h = (1 − u_1)^{1/(e(φ_h)+1)}."""
        e_x, e_y = self._exponents
        psi = 2 * jnp.pi * u[..., 1]
        x, y = jnp.sqrt(e_y + 1) * jnp.cos(psi), jnp.sqrt(e_x + 1) * jnp.sin(psi)
        x, y = x / jnp.hypot(x, y), y / jnp.hypot(x, y)
        log_cos = jnp.log1p(-u[..., 0]) / (e_x * x**2 + e_y * y**2 + 1)
        tan = safe_sqrt(jnp.expm1(-2 * log_cos))
        return reflect(wo, from_slopes(tan * x, tan * y))

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return safe_divide(self._p(wi + wo), 4 * _cos_theta_d(wi, wo))

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return typical_reflectance(self.fresnel, wo)

    def _p(self, h: Direction) -> Float[Array, "..."]:
        """p at a half vector of any length; 0 at and below the horizon."""
        e_x, e_y = self._exponents
        t_x, t_y, above = slopes(h)
        log_power = -(e_x * t_x**2 + e_y * t_y**2) * log1p_over(t_x**2 + t_y**2) / 2
        return jnp.where(above, jnp.sqrt((e_x + 1) * (e_y + 1)) / (2 * jnp.pi) * jnp.exp(log_power), 0)

    @property
    def _exponents(self) -> tuple[Parameter, Parameter]:
        return self.exponent_x, self.exponent_x if self.exponent_y is None else self.exponent_y


def _cos_theta_d(wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """h·wo = ‖wi + wo‖ / 2, which keeps its digits for opposite directions."""
    return safe_sqrt(dot(wi + wo, wi + wo)) / 2
