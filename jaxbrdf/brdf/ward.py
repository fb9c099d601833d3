"""Ward's reflectance and Dür's renormalisation of it: a Gaussian in the half vector's slopes."""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Parameter, Range, parameter
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.brdf.microfacet import mirrored_density, sample_mirrored
from jaxbrdf.directions import Direction, above_horizon, cos_theta
from jaxbrdf.ndf.base import slopes
from jaxbrdf.ndf.beckmann import Beckmann


class AbstractWard(AbstractBRDF):
    r"""A Gaussian in the slopes of h over some function of the two cosines.

        f(wi, wo) = exp(−(t_x²/α_x² + t_y²/α_y²)) / (4π α_x α_y q(cos θ_i, cos θ_o)),   t = h_xy / h_z

    This is Beckmann's D(h) cos⁴θ_h / (4q): it is sampled by the normals that wo sees of `Beckmann`, of less
    variance than Ward's own tan²θ_h = −α² log u. A direction counts as above the horizon from a cosine of
    1e-51 on, 5e-7 in single precision, where 1/q is still a number.
    """

    alpha_x: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-3, 3.0, log=True))
    alpha_y: Parameter | None = parameter(domain=POSITIVE, optional=True, fitted=Range(1e-3, 3.0, log=True))

    @abstractmethod
    def _spread(self, cos_i: Float[Array, "..."], cos_o: Float[Array, "..."]) -> Float[Array, "..."]:
        """q, both cosines being positive."""

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        above = above_horizon(cos_theta(wi)) & above_horizon(cos_theta(wo))
        q = self._spread(*(jnp.where(above, cos_theta(w), 1) for w in (wi, wo)))
        alpha_x, alpha_y = self._ndf.alphas
        t_x, t_y, _ = slopes(wi + wo)
        gaussian = jnp.exp(-((t_x / alpha_x) ** 2) - (t_y / alpha_y) ** 2)
        return jnp.where(above, gaussian / (4 * jnp.pi * alpha_x * alpha_y * q), 0)

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        return sample_mirrored(self._ndf, u, wo)

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return mirrored_density(self._ndf, wi, wo)

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        """f cos θ_i over the density, in the mirror direction, times about the mean of cos⁴θ_h."""
        above = above_horizon(cos_theta(wo))
        cos_o = jnp.where(above, cos_theta(wo), 1)
        alpha_x, alpha_y = self._ndf.alphas
        mean_cos4 = 1 / (1 + alpha_x * alpha_y) ** 2
        return mean_cos4 * self._ndf.projected_area(wo) * cos_o / self._spread(cos_o, cos_o)

    @property
    def _ndf(self) -> Beckmann:
        return Beckmann(self.alpha_x, self.alpha_y)


class Ward(AbstractWard):
    r"""Ward's reflectance, iso- or anisotropic.

        f(wi, wo) = exp(−tan²θ_h (cos²φ_h/α_x² + sin²φ_h/α_y²)) / (4π α_x α_y √(cos θ_i cos θ_o))

    Ward 1992, "Measuring and modeling anisotropic reflection", eq. 5a, of which this is the specular part for
    ρ_s = 1; `Lambertian(rho_d) + rho_s * Ward(...)` is the whole. The parameters of Ngan et al. 2005 are of
    this form. `alpha_x`, `alpha_y` > 0 are √2 times the standard deviations of the slopes; without `alpha_y`
    it is isotropic. Raises ValueError for other values.

    Of a sharp lobe the albedo is cos θ: light is lost at oblique incidence. At the very horizon it grows
    without bound, like 1/√cos θ: for α = 0.5 it is 0.59, 0.27, 0.50 and 1.5 at 0°, 80°, 89° and 89.9°.
    """

    def _spread(self, cos_i: Float[Array, "..."], cos_o: Float[Array, "..."]) -> Float[Array, "..."]:
        return jnp.sqrt(cos_i) * jnp.sqrt(cos_o)


class WardDuer(AbstractWard):
    r"""Ward's reflectance as Dür normalises it, for rough surfaces at grazing angles.

        f(wi, wo) = exp(−tan²θ_h (cos²φ_h/α_x² + sin²φ_h/α_y²)) / (4π α_x α_y cos θ_i cos θ_o)

    Dür 2006, "An improved normalization for the Ward reflectance model". Parameters, and the form that Ngan
    et al. 2005 fitted, as of `Ward`.

    The albedo is within 6 % of 1 up to 80° for α ≤ 0.1, and grows without bound at the horizon, like
    1/cos θ: beyond 1 from 88° on for α = 0.05, from some 83° on for α = 0.2 and more.
    """

    def _spread(self, cos_i: Float[Array, "..."], cos_o: Float[Array, "..."]) -> Float[Array, "..."]:
        return cos_i * cos_o
