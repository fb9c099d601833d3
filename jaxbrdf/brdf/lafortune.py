"""Lafortune's generalised cosine lobes."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import NON_NEGATIVE, Parameter, Range, parameter
from jaxbrdf.brdf.base import AbstractBRDF, both_above
from jaxbrdf.brdf.phong import lobe_cosine, lobe_density, sample_lobe
from jaxbrdf.directions import NORMAL, Direction, dot
from jaxbrdf.special import safe_divide, safe_power, safe_sqrt


class Lafortune(AbstractBRDF):
    r"""One generalised cosine lobe, without normalisation; several of them are a sum.

        f(wi, wo) = max(0, c_x wi_x wo_x + c_y wi_y wo_y + c_z wi_z wo_z)^e

    Lafortune et al. 1997, "Non-linear approximation of reflectance functions", section 4. c_x = c_y = −1 with
    c_z = 1 is `Phong` without its (e + 2)/(2π); positive c_x reflect back to the light; c_z < −c_x leans a
    lobe towards the horizon (off-specular peaks), c_x = c_y = 0 is diffuse, ∝ (cos θ_i cos θ_o)^e. Without
    `c_y` the lobe is isotropic, c_y = c_x; without `c_z` it is 1, as s C only multiplies f by s^e.
    `exponent` e ≥ 0, else ValueError. Fits keep c_x and c_y, best ±1, as a common factor of all three means
    nothing, and seek c_z up to 1, above which high powers leave the floating-point numbers.

    Energy is not looked after: a lobe's albedo is at most max|c|^e 2π/(e + 2). The published factors ρ_s of
    Ngan et al. 2005 belong to ρ_s (e + 2)/(2π) f / max(|C_xy|, C_z)^e. Divide C by that maximum, as the e-th
    powers of both sides underflow: `rho_s * (e + 2) / (2 * pi) * Lafortune(e, c_x=-1, c_z=C_z / abs(C_xy))`.
    """

    exponent: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(0.1, 1e5, log=True))
    c_x: Parameter = parameter()
    c_y: Parameter | None = parameter(optional=True)
    c_z: Parameter = parameter(default=1.0, fitted=Range(0.0, 1.0))

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        lobe = safe_power(dot(self._stretched(wi), wo), self.exponent)
        return jnp.where(both_above(wi, wo), lobe, 0)

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        return sample_lobe(u, self._axis(wo)[0], self.exponent)

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return lobe_density(wi, self._axis(wo)[0], self.exponent)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        """‖C wo‖^e over the solid angle of the lobe, 2π/(e + 2), at its mean cosine."""
        axis, length = self._axis(wo)
        height = safe_power(length, self.exponent) * 2 * jnp.pi / (self.exponent + 2)
        return height * lobe_cosine(axis, self.exponent)

    def _stretched(self, w: Direction) -> Float[Array, "... 3"]:
        """C w."""
        c_y = self.c_x if self.c_y is None else self.c_y
        return jnp.stack([self.c_x * w[..., 0], c_y * w[..., 1], self.c_z * w[..., 2]], axis=-1)

    def _axis(self, wo: Direction) -> tuple[Direction, Float[Array, "..."]]:
        """The direction and the length of C wo; the normal, and 0, where that is nothing."""
        C_wo = self._stretched(wo)
        length = safe_sqrt(dot(C_wo, C_wo))
        normal = jnp.array(NORMAL, wo.dtype)
        axis = jnp.where((length > 0)[..., None], safe_divide(C_wo, length[..., None]), normal)
        return axis, length
