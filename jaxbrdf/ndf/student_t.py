"""The Student-t distribution, which spans Trowbridge–Reitz to Beckmann."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Domain, Parameter, Range, in_chunks, parameter
from jaxbrdf.directions import Direction
from jaxbrdf.ndf.base import AbstractNDF, from_slopes, slopes
from jaxbrdf.special import safe_hypot, safe_sqrt, student_ramp


class StudentT(AbstractNDF):
    r"""Student-t distribution: slopes of Student's law, γ tells how heavy its tail is.

        D(m) = (γ−1) / (π b cos⁴θ (1 + tan²θ/b)^γ),   b = (γ−1) α²
        σ(w) = ⟨(w_z + r X)+⟩,   r = √b sin θ,   X of density ∝ (1 + x²)^{1/2−γ}

    Ribardière et al. 2017, "STD: Student's t-distribution of slopes for microfacet based BSDFs". γ = 2 is
    Trowbridge–Reitz, γ → ∞ Beckmann of the same α. `alpha` > 0, `gamma` > 1; for γ ≤ 3/2 the mean slope, and
    with it σ off the normal, is infinite. Raises ValueError for other values.
    """

    alpha: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-3, 3.0, log=True))
    gamma: Parameter = parameter(
        domain=Domain(1.0, open=True),
        fitted=Range(1.51, 40.0, log=True, pole=1.5),  # where σ is infinite
    )

    @property
    def is_isotropic(self) -> bool:
        return True

    def _density(self, m: Direction) -> Float[Array, "..."]:
        t_x, t_y, above = slopes(m)
        tan2, b = t_x**2 + t_y**2, self._b()
        log_P22 = jnp.log((self.gamma - 1) / (jnp.pi * b)) - self.gamma * jnp.log1p(tan2 / b)
        return jnp.where(above, jnp.exp(log_P22 + 2 * jnp.log1p(tan2)), 0)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        return student_area(w, jnp.sqrt(self._b()), self.gamma)

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        return student_sample(u, jnp.sqrt(self._b()), self.gamma)

    def _b(self) -> Float[Array, ""]:
        return (self.gamma - 1) * self.alpha**2


def student_area(w: Direction, scale: Float[Array, ""], gamma: Float[Array, ""]) -> Float[Array, "..."]:
    """σ(w) of slopes t with P22 ∝ (1 + (t_x² + t_y²) / scale²)^{−γ}."""
    r = scale * safe_hypot(w[..., 0], w[..., 1])
    return in_chunks(lambda z, r: student_ramp(z, r, gamma), w[..., 2], r)


def student_sample(u: Float[Array, "... 2"], scale: Float[Array, ""], gamma: Float[Array, ""]) -> Direction:
    """A normal for each u: tan²θ = scale² ((1 − u_1)^{−1/(γ−1)} − 1), φ = 2π u_2."""
    tan = scale * safe_sqrt(jnp.expm1(-jnp.log1p(-u[..., 0]) / (gamma - 1)))
    phi = 2 * jnp.pi * u[..., 1]
    return from_slopes(tan * jnp.cos(phi), tan * jnp.sin(phi))
