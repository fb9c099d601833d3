"""The Trowbridge–Reitz distribution, known as GGX: the facets of an ellipsoid."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Parameter, Range, parameter
from jaxbrdf.directions import NORMAL, Direction, cos_theta, safe_normalize
from jaxbrdf.ndf.base import AbstractVisibleNDF, from_slopes, one_each
from jaxbrdf.ndf.visible_hemisphere import sample_visible_hemisphere
from jaxbrdf.special import safe_sqrt


class TrowbridgeReitz(AbstractVisibleNDF):
    r"""Trowbridge–Reitz (GGX) distribution, iso- or anisotropic.

        D(m) = 1 / (π α_x α_y (m_x²/α_x² + m_y²/α_y² + m_z²)²),   m_z > 0
        σ(w) = (w_z + √(α_x² w_x² + α_y² w_y² + w_z²)) / 2

    Trowbridge & Reitz 1975; Walter et al. 2007, eq. 33 and 34; anisotropic form Burley 2012, eq. 13;
    visible normals by Heitz 2018. `alpha_x`, `alpha_y` > 0; without `alpha_y` the distribution is isotropic.
    Raises ValueError for other values.
    """

    closed_form_area = True

    alpha_x: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-3, 3.0, log=True))
    alpha_y: Parameter | None = parameter(domain=POSITIVE, optional=True, fitted=Range(1e-3, 3.0, log=True))

    @property
    def is_isotropic(self) -> bool:
        return self.alpha_y is None

    @property
    def alphas(self) -> tuple[Parameter, Parameter]:
        """(α_x, α_y), which are one where the distribution is isotropic."""
        return self.alpha_x, self.alpha_x if self.alpha_y is None else self.alpha_y

    def _density(self, m: Direction) -> Float[Array, "..."]:
        alpha_x, alpha_y = self.alphas
        e = (m[..., 0] / alpha_x) ** 2 + (m[..., 1] / alpha_y) ** 2 + m[..., 2] ** 2
        above = cos_theta(m) > 0
        return jnp.where(above, 1 / (jnp.pi * alpha_x * alpha_y * jnp.where(above, e, 1) ** 2), 0)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        alpha_x, alpha_y = self.alphas
        length2 = (alpha_x * w[..., 0]) ** 2 + (alpha_y * w[..., 1]) ** 2 + w[..., 2] ** 2
        return (w[..., 2] + safe_sqrt(length2)) / 2

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        r, phi = safe_sqrt(u[..., 0] / (1 - u[..., 0])), 2 * jnp.pi * u[..., 1]
        alpha_x, alpha_y = self.alphas
        return from_slopes(alpha_x * r * jnp.cos(phi), alpha_y * r * jnp.sin(phi))

    def _sample_visible(self, u: Float[Array, "... 2"], w: Direction) -> Direction:
        pole = jnp.array(NORMAL, w.dtype)
        s = sample_visible_hemisphere(u, safe_normalize(self._stretch(one_each(u, w))), pole)
        return safe_normalize(self._stretch(s))

    def _stretch(self, w: Direction) -> Direction:
        """(α_x w_x, α_y w_y, w_z): to the ellipsoid of a unit sphere, and its normals back."""
        alpha_x, alpha_y = self.alphas
        return jnp.stack([alpha_x * w[..., 0], alpha_y * w[..., 1], w[..., 2]], axis=-1)
