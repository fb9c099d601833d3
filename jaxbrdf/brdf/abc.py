r"""The ABC models: lobes that fall like a power of the angle, as those of polished surfaces do.

Both are F(θ_d) S, S an inverse power that stands for the power spectrum of a surface in the theory of
Rayleigh and Rice. `ABC` takes it of the half vector, as a distribution of facets, `SmoothABC` of the distance
to the mirror direction. For their diffuse part add a `Lambertian`.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import NON_NEGATIVE, POSITIVE, Parameter, Range, parameter
from jaxbrdf.brdf.base import AbstractBRDF, both_above, cosine_product
from jaxbrdf.brdf.microfacet import typical_reflectance
from jaxbrdf.directions import Direction, cos_theta, dot, half_vector, or_normal, reflect
from jaxbrdf.fresnel import Dielectric
from jaxbrdf.shadowing import v_cavity
from jaxbrdf.special import safe_divide, safe_hypot, safe_sqrt


class ABC(AbstractBRDF):
    r"""The ABC model over half vectors: facets of V-shaped grooves, not normalised.

        f(wi, wo) = F(θ_d) G S(1 − cos θ_h) / (π cos θ_i cos θ_o),   S(x) = a / (1 + b x)^c
        G = min(1, 2 cos θ_h min(cos θ_i, cos θ_o) / cos θ_d),   F = Dielectric(eta)

    Löw, Kronander, Ynnerman & Unger 2012, their microfacet variant, in the normalisation of the published
    tables, of which `data_loaders.published("abc", material)` makes such models. The 1/π stands where the
    microfacet theory has 1/4. `a` ≥ 0 is the height of the lobe, `b` > 0 sets its width √(2/b), `c` ≥ 0 how
    fast it falls, `eta` > 0 is the index of refraction; else ValueError. Nothing keeps the albedo below 1: at
    the normal it is about 8 a F (1 − (1 + b)^{1−c}) / (b (c − 1)). Sampled by half vectors of density ∝ S.
    """

    a: Parameter = parameter(domain=NON_NEGATIVE, linear=True)
    b: Parameter = parameter(domain=POSITIVE, fitted=Range(1.0, 1e7, log=True))
    c: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(0.02, 5.0, log=True))
    eta: Parameter = parameter(domain=POSITIVE, fitted=Range(1.01, 100.0, log=True))

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        h = half_vector(wi, wo)
        F = Dielectric(self.eta)(dot(wi, h))
        S = self.a * _power(_one_minus_cos(h), self.b, -self.c)
        return F * S * _groove_visibility(wi, wo) / jnp.pi

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        x, phi = _draw(u[..., 0], self.b, self.c, 1), 2 * jnp.pi * u[..., 1]
        sin = safe_sqrt(x * (2 - x))
        return reflect(wo, jnp.stack([sin * jnp.cos(phi), sin * jnp.sin(phi), 1 - x], axis=-1))

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        h = half_vector(wi, wo)
        density = _density(_one_minus_cos(h), self.b, self.c, 1) / (2 * jnp.pi)
        return safe_divide(density, 4 * dot(wo, h))

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return 8 * self.a * _mass(self.b, self.c, 1) * typical_reflectance(Dielectric(self.eta), wo)


class SmoothABC(AbstractBRDF):
    r"""The ABC model over projected deviations, after the Rayleigh–Rice theory of smooth surfaces.

        f(wi, wo) = F(θ_d) S(‖D_p‖),   S(x) = a / (1 + b x²)^c,   F = Dielectric(eta)

    D_p = (wi_x + wo_x, wi_y + wo_y) leads from the mirror direction of wo to wi, both projected on the
    tangent plane: Löw, Kronander, Ynnerman & Unger 2012, eq. 10 and 12. `a` ≥ 0 in 1/sr, `b` > 0, `c` ≥ 0,
    `eta` > 0 as for `ABC`, else ValueError. On that plane the lobe has one shape at all angles, cut off at
    the rim. Sampled by D_p of density ∝ S, for any c: f cos θ_i / pdf is F times a function of θ_o alone.
    """

    a: Parameter = parameter(domain=NON_NEGATIVE, linear=True)
    b: Parameter = parameter(domain=POSITIVE, fitted=Range(1.0, 1e7, log=True))
    c: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(0.02, 5.0, log=True))
    eta: Parameter = parameter(domain=POSITIVE, fitted=Range(1.01, 100.0, log=True))

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        F = Dielectric(self.eta)(dot(wi, half_vector(wi, wo)))
        S = self.a * _power(_deviation2(wi, wo), self.b, -self.c)
        return jnp.where(both_above(wi, wo), F * S, 0)

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        length = safe_sqrt(_draw(u[..., 0], self.b, self.c, _largest_deviation2(wo)))
        phi = 2 * jnp.pi * u[..., 1]
        D_p = jnp.stack([length * jnp.cos(phi), length * jnp.sin(phi)], axis=-1)
        return _lifted(D_p - wo[..., :2])

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        density = _density(_deviation2(wi, wo), self.b, self.c, _largest_deviation2(wo))
        return density / jnp.pi * cos_theta(wi)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        area = jnp.pi * _mass(self.b, self.c, _largest_deviation2(wo))
        return self.a * area * typical_reflectance(Dielectric(self.eta), wo)


def _one_minus_cos(h: Direction) -> Float[Array, "..."]:
    """1 − cos θ_h of a half vector above the horizon, with all its digits close to the normal."""
    return (h[..., 0] ** 2 + h[..., 1] ** 2) / (1 + jnp.maximum(cos_theta(h), 0))


def _groove_visibility(wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """G / (cos θ_i cos θ_o), G that of `VCavity`; 0 below the horizon."""
    G = v_cavity(or_normal(wi), or_normal(wo))
    return jnp.where(both_above(wi, wo), G / cosine_product(wi, wo), 0)


def _deviation2(wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """‖D_p‖²."""
    return (wi[..., 0] + wo[..., 0]) ** 2 + (wi[..., 1] + wo[..., 1]) ** 2


def _largest_deviation2(wo: Direction) -> Float[Array, "..."]:
    """The largest ‖D_p‖² of any wi: (1 + sin θ_o)²."""
    return (1 + safe_hypot(wo[..., 0], wo[..., 1])) ** 2


def _lifted(p: Float[Array, "... 2"]) -> Direction:
    """The direction above a point of the unit disk; points outside go below the horizon, to p / ‖p‖²."""
    r2 = jnp.sum(p * p, axis=-1, keepdims=True)
    p = p / jnp.maximum(r2, 1)
    z = safe_sqrt(1 - jnp.sum(p * p, axis=-1, keepdims=True))
    return jnp.concatenate([p, jnp.where(r2 < 1, z, -z)], axis=-1)


# The density ∝ (1 + b t)^{−c} of t between 0 and an end


def _draw(u: Float[Array, "..."], b: Parameter, c: Parameter, end) -> Float[Array, "..."]:
    """t from u in [0, 1): with k = 1 − c, (1 + b t)^k goes evenly from 1 to (1 + b end)^k."""
    k = _integrated_exponent(c)
    return jnp.expm1(jnp.log1p(u * jnp.expm1(k * jnp.log1p(b * end))) / k) / b


def _density(t: Float[Array, "..."], b: Parameter, c: Parameter, end) -> Float[Array, "..."]:
    """The density of `_draw`."""
    return _power(t, b, _integrated_exponent(c) - 1) / _mass(b, c, end)


def _mass(b: Parameter, c: Parameter, end) -> Float[Array, "..."]:
    """∫ (1 + b t)^{−c} dt = ((1 + b end)^k − 1) / (k b),   k = 1 − c."""
    k = _integrated_exponent(c)
    return jnp.expm1(k * jnp.log1p(b * end)) / (k * b)


def _power(t: Float[Array, "..."], b: Parameter, exponent: Parameter) -> Float[Array, "..."]:
    """(1 + b t)^exponent."""
    return jnp.exp(exponent * jnp.log1p(b * t))


def _integrated_exponent(c: Parameter) -> Parameter:
    """k = 1 − c; next to c = 1, where the integral is a logarithm, √ε, so that one formula serves all c.

    Draw and density share it: they agree, whatever it is.
    """
    k, least = 1 - c, jnp.sqrt(jnp.finfo(c.dtype).eps)
    return jnp.where(jnp.abs(k) < least, least, k)
