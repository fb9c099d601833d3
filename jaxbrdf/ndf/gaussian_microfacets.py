"""Ashikhmin's Gaussian distributions of facets: plain, and of a cylinder."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Parameter, Range, in_chunks, parameter
from jaxbrdf.directions import Direction
from jaxbrdf.ndf.base import AbstractVisibleNDF, one_each, pick, slopes
from jaxbrdf.ndf.beckmann import Beckmann
from jaxbrdf.special import exponential_nodes


class GaussianMicrofacets(AbstractVisibleNDF):
    r"""A Gaussian in the slopes, of facet *area* over solid angle: Ashikhmin's Gaussian surface.

        D(m) = p(m) / ⟨h·n⟩,   p(m) ∝ exp(−(t_x²/σ_x² + t_y²/σ_y²)),   t_x = m_x/m_z, t_y = m_y/m_z

    Ashikhmin et al. 2000, eq. 34. Beckmann's has 1/cos⁴θ more. As (1 + t²)^{−2} = ∫ τ e^{−τ(1+t²)} dτ, it is
    a continuous mixture of Beckmann distributions of roughness 1/α² = 1/σ² + τ, the share of each being ∝ τ
    e^{−τ} α_x α_y: its projected area and its samples follow from theirs, to 1e-10 by 56 of them. `sigma_x`,
    `sigma_y` > 0, either may be infinite; without `sigma_y` it is isotropic. Raises ValueError otherwise.
    """

    sigma_x: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-3, 3.0, log=True))
    sigma_y: Parameter | None = parameter(domain=POSITIVE, optional=True, fitted=Range(1e-3, 3.0, log=True))

    @property
    def is_isotropic(self) -> bool:
        return self.sigma_y is None

    def _density(self, m: Direction) -> Float[Array, "..."]:
        t_x, t_y, above = slopes(m)
        k_x, k_y = self._sharpness()
        scale = jnp.pi * jnp.sum(self._mixture()[0])
        return jnp.where(above, jnp.exp(-k_x * t_x**2 - k_y * t_y**2) / scale, 0)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        def area(x, y, z):
            return jnp.sum(self._shares() * self._areas(jnp.stack([x, y, z])))

        return in_chunks(area, w[..., 0], w[..., 1], w[..., 2])

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        shares = jnp.broadcast_to(self._shares(), (*u.shape[:-1], self._shares().size))
        ndf, u = self._pick(shares, u)
        return ndf._sample(u)

    def _sample_visible(self, u: Float[Array, "... 2"], w: Direction) -> Direction:
        areas = jnp.vectorize(self._areas, signature="(3)->(n)")(one_each(u, w))
        ndf, u = self._pick(areas * jnp.broadcast_to(self._shares(), areas.shape), u)
        return ndf._sample_visible(u, w)

    def _pick(self, weights: Float[Array, "... n"], u: Float[Array, "... 2"]):
        """One of the Beckmann distributions for each u, by u_1, and u with what is left of u_1."""
        index, rest = pick(weights, u[..., 0])
        alpha_x, alpha_y = (alpha[index] for alpha in self._mixture()[1].alphas)
        return Beckmann(alpha_x, alpha_y), jnp.stack([rest, u[..., 1]], axis=-1)

    def _sharpness(self) -> tuple[Array, Array]:
        """(1/σ_x², 1/σ_y²)."""
        return 1 / self.sigma_x**2, 1 / (self.sigma_x if self.sigma_y is None else self.sigma_y) ** 2

    def _mixture(self) -> tuple[Float[Array, " n"], Beckmann]:
        """Weights that sum to 1/(π c) in D = c exp(…), and the Beckmann distributions, with leaves (n,)."""
        tau, weights = exponential_nodes(jnp.result_type(float, self.sigma_x))
        k_x, k_y = self._sharpness()
        alpha_x, alpha_y = 1 / jnp.sqrt(k_x + tau), 1 / jnp.sqrt(k_y + tau)
        return weights * tau * alpha_x * alpha_y, Beckmann(alpha_x, alpha_y)

    def _shares(self) -> Float[Array, " n"]:
        weights, _ = self._mixture()
        return weights / jnp.sum(weights)

    def _areas(self, w: Float[Array, "3"]) -> Float[Array, " n"]:
        """σ of each Beckmann distribution from one direction."""
        return jax.vmap(lambda ndf: ndf._projected_area(w))(self._mixture()[1])


class GaussianCylinder(AbstractVisibleNDF):
    r"""The facets of fibres along x: a Gaussian across x, every tilt along y alike.

        D(m) = p(m) / ⟨h·n⟩,   p(m) ∝ exp(−(m_x/m_z)²/σ²)

    Ashikhmin et al. 2000, section 6.3: `GaussianMicrofacets` with σ_y infinite. `sigma` > 0; raises
    ValueError otherwise.
    """

    sigma: Parameter = parameter(domain=POSITIVE)

    @property
    def is_isotropic(self) -> bool:
        return False

    @property
    def _gaussian(self) -> GaussianMicrofacets:
        return GaussianMicrofacets(self.sigma, jnp.full_like(self.sigma, jnp.inf))

    def _density(self, m: Direction) -> Float[Array, "..."]:
        return self._gaussian._density(m)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        return self._gaussian._projected_area(w)

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        return self._gaussian._sample(u)

    def _sample_visible(self, u: Float[Array, "... 2"], w: Direction) -> Direction:
        return self._gaussian._sample_visible(u, w)
