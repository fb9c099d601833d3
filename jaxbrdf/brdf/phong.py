"""The Phong reflectances: powers of the cosine about the mirror direction and about the half vector."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import NON_NEGATIVE, Parameter, Range, parameter
from jaxbrdf.brdf.base import AbstractBRDF, both_above
from jaxbrdf.brdf.microfacet import mirrored_density, sample_mirrored
from jaxbrdf.directions import NORMAL, Direction, cos_theta, dot, half_vector, reflect
from jaxbrdf.ndf.blinn_phong import BlinnPhong
from jaxbrdf.special import gaussian_ramp, safe_sqrt


class Phong(AbstractBRDF):
    r"""The reciprocal Phong lobe, about the mirror direction.

        f(wi, wo) = (e + 2)/(2π) max(0, r·wo)^e,   r = wi mirrored at the macro-normal

    Phong 1975; Lafortune & Willems 1994, "Using the modified Phong reflectance model for physically based
    rendering". `exponent` e ≥ 0, else ValueError. The albedo is exactly 1 at normal incidence and falls
    towards grazing angles, roughly like cos θ for a sharp lobe. e = 0 is the limit: 1/π within 90° of the
    mirror direction, 0 beyond.
    """

    exponent: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(0.1, 1e6, log=True))

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        lobe = (self.exponent + 2) / (2 * jnp.pi) * cosine_power(mirrored(wi), wo, self.exponent)
        return jnp.where(both_above(wi, wo), lobe, 0)

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        return sample_lobe(u, mirrored(wo), self.exponent)

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return lobe_density(wi, mirrored(wo), self.exponent)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return lobe_cosine(mirrored(wo), self.exponent)


class BlinnPhongBRDF(AbstractBRDF):
    r"""The Blinn–Phong lobe, about the half vector, with neither Fresnel nor shadowing term.

        f(wi, wo) = (e + 2)/(2π) (n·h)^e,   h = (wi + wo) / ‖wi + wo‖

    Blinn 1977. `exponent` e ≥ 0, else ValueError. (e + 2)/(2π) is the normalisation of the distribution
    `BlinnPhong`, which f is at h, not of a reflectance: the albedo is 1 for e = 0, which is Lambertian, but
    tends to 4 cos²θ for a sharp lobe. Use factors below 1/4. The published parameters of the Blinn–Phong
    model of Ngan et al. 2005 belong to this form: with it their peaks and widths agree with those of Ward's.
    """

    exponent: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(0.1, 1e6, log=True))

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return jnp.where(both_above(wi, wo), self._ndf(half_vector(wi, wo)), 0)

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        return sample_mirrored(self._ndf, u, wo)

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return mirrored_density(self._ndf, wi, wo)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        """From 1 for e = 0 to 4 cos²θ for a sharp lobe, halfway at e = 7, as at normal incidence."""
        sharp = 4 * lobe_cosine(wo, self.exponent) ** 2
        return (7 + self.exponent * sharp) / (7 + self.exponent)

    @property
    def _ndf(self) -> BlinnPhong:
        return BlinnPhong(self.exponent)


def mirrored(w: Direction) -> Direction:
    """w mirrored at the macro-normal."""
    return jnp.stack([-w[..., 0], -w[..., 1], w[..., 2]], axis=-1)


def cosine_power(a: Direction, b: Direction, exponent: Float[Array, ""]) -> Float[Array, "..."]:
    """max(0, a·b)^e of unit vectors, 0 from a right angle on even for e = 0.

    a·b = 1 − ‖a − b‖²/2 keeps the digits of a high power, also where rounding has touched the lengths.
    """
    chord2 = dot(a - b, a - b)
    within = chord2 < 2
    return jnp.where(within, jnp.exp(exponent * jnp.log1p(-jnp.where(within, chord2, 0) / 2)), 0)


def sample_lobe(u: Float[Array, "... 2"], axis: Direction, exponent: Float[Array, ""]) -> Direction:
    """A direction of density (e + 1)/(2π) max(0, axis·w)^e: one about n, turned by 180° about n + axis.

    Where axis = −n there is nothing to turn about, and `reflect` turns the direction round.
    """
    log_cos = jnp.log1p(-u[..., 0]) / (exponent + 1)
    sin, phi = safe_sqrt(-jnp.expm1(2 * log_cos)), 2 * jnp.pi * u[..., 1]
    about_n = jnp.stack([sin * jnp.cos(phi), sin * jnp.sin(phi), jnp.exp(log_cos)], axis=-1)
    return reflect(about_n, half_vector(jnp.broadcast_to(jnp.array(NORMAL, axis.dtype), axis.shape), axis))


def lobe_density(w: Direction, axis: Direction, exponent: Float[Array, ""]) -> Float[Array, "..."]:
    """The density of `sample_lobe`."""
    return (exponent + 1) / (2 * jnp.pi) * cosine_power(w, axis, exponent)


def lobe_cosine(axis: Direction, exponent: Float[Array, ""]) -> Float[Array, "..."]:
    """About the mean of max(0, cos θ) over a lobe: that of a Gaussian of its width."""
    return gaussian_ramp(cos_theta(axis), jnp.sqrt(2 / (exponent + 2)))
