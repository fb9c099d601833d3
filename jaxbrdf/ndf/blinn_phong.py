"""The Phong-like distributions: powers of the cosine."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import NON_NEGATIVE, Parameter, Range, in_chunks, parameter
from jaxbrdf.directions import Direction
from jaxbrdf.ndf.base import AbstractNDF, from_slopes, slopes
from jaxbrdf.ndf.student_t import student_area, student_sample
from jaxbrdf.special import (
    exponential_nodes,
    fold,
    gauss_legendre,
    log1p_over,
    safe_arctan2,
    safe_sqrt,
)


class BlinnPhong(AbstractNDF):
    r"""Blinn–Phong distribution: a power of the cosine.

        D(m) = (e + 2)/(2π) cos^e θ

    Blinn 1977, normalised so that ∫ D cos = 1. Its slopes follow Student's law with b = 1 and γ = e/2 + 2,
    which gives its projected area and its samples (see `StudentT`). `exponent` e ≥ 0; raises ValueError
    otherwise.
    """

    exponent: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(0.1, 1e6, log=True))

    @property
    def is_isotropic(self) -> bool:
        return True

    def _density(self, m: Direction) -> Float[Array, "..."]:
        t_x, t_y, above = slopes(m)
        log_cos = -jnp.log1p(t_x**2 + t_y**2) / 2
        return jnp.where(above, (self.exponent + 2) / (2 * jnp.pi) * jnp.exp(self.exponent * log_cos), 0)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        return student_area(w, jnp.ones_like(self.exponent), self.exponent / 2 + 2)

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        return student_sample(u, jnp.ones_like(self.exponent), self.exponent / 2 + 2)


class AnisotropicPhong(AbstractNDF):
    r"""Anisotropic Phong distribution: the cosine's exponent depends on the azimuth.

        D(m) = √((e_x + 2)(e_y + 2)) / (2π) cos^{e(φ)} θ,   e(φ) = e_x cos²φ + e_y sin²φ

    Ashikhmin & Shirley 2000, eq. 4, normalised so that ∫ D cos = 1. Drawn as there: with
    φ = arctan(√((e_x+2)/(e_y+2)) tan ψ), ψ is even over the circle and cos^{e(φ)+2} θ even over [0, 1].
    σ is an integral over these two, to 1e-7 (see `_area_at`). `exponent_x`, `exponent_y` ≥ 0; raises
    ValueError otherwise.
    """

    exponent_x: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(0.1, 1e6, log=True))
    exponent_y: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(0.1, 1e6, log=True))

    @property
    def is_isotropic(self) -> bool:
        return False

    def _density(self, m: Direction) -> Float[Array, "..."]:
        t_x, t_y, above = slopes(m)
        log_cos_e = -(self.exponent_x * t_x**2 + self.exponent_y * t_y**2) * log1p_over(t_x**2 + t_y**2) / 2
        scale = jnp.sqrt((self.exponent_x + 2) * (self.exponent_y + 2)) / (2 * jnp.pi)
        return jnp.where(above, scale * jnp.exp(log_cos_e), 0)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        return in_chunks(self._area_at, w[..., 0], w[..., 1], w[..., 2], size=512)

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        x, y, k = self._azimuth(2 * jnp.pi * u[..., 1])
        tan = safe_sqrt(jnp.expm1(-2 / k * jnp.log1p(-u[..., 0])))
        return from_slopes(tan * x, tan * y)

    def _azimuth(self, psi):
        """(cos φ, sin φ, e(φ) + 2) at the even angle ψ."""
        x, y = jnp.sqrt(self.exponent_y + 2) * jnp.cos(psi), jnp.sqrt(self.exponent_x + 2) * jnp.sin(psi)
        length = jnp.hypot(x, y)
        x, y = x / length, y / length
        return x, y, self.exponent_x * x**2 + self.exponent_y * y**2 + 2

    def _area_at(self, w_x: Float[Array, ""], w_y: Float[Array, ""], w_z: Float[Array, ""]):
        r"""w_z + ∫ (w·m)− / m_z over ψ and v = cos^k θ, k = e(φ) + 2: what looks away from w, for w_z ≥ 0.

        At each φ facets look away beyond tan θ_0 = w_z / s, s = −(w_x cos φ + w_y sin φ) > 0, so v < v_0.
        With v = v_0 e^{−2t} the exponential nodes follow tan θ from there to the horizon; Gauss–Legendre
        nodes in ψ gather at the ends of the half circle, where s → 0. Below the horizon σ(−w) = σ(w) − w·n.
        """
        height, below = fold(w_z)
        t, t_weights = (a[None, :] for a in exponential_nodes(w_z.dtype))
        r, r_weights = (a[:, None] for a in gauss_legendre(64, w_z.dtype))
        middle = safe_arctan2(jnp.sqrt(self.exponent_x + 2) * w_y, jnp.sqrt(self.exponent_y + 2) * w_x)
        x, y, k = self._azimuth(middle + jnp.pi * (0.5 + r**2 * (3 - 2 * r)))
        s = -(w_x * x + w_y * y)
        away = s > jnp.finfo(s.dtype).tiny ** 0.25
        s = jnp.where(away, s, 1)
        log_secant2 = jnp.log1p((height / s) ** 2)
        log_m = -log_secant2 - 4 * t / k  # log cos²θ of the facets; tan θ e^{−t} from it cannot overflow
        tan = jnp.exp(-log_m / 2 - t) * jnp.sqrt(-jnp.expm1(log_m))
        inner = jnp.sum(t_weights * 2 * (s * tan - height * jnp.exp(-t)), axis=1, keepdims=True)
        outer = 3 * r * (1 - r) * r_weights * jnp.exp(-k / 2 * log_secant2) * inner
        return height + below + jnp.sum(jnp.where(away, outer, 0))
