"""Ashikhmin's velvets: fibres that stand, and fibres that lean."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Domain, Parameter, in_chunks, parameter
from jaxbrdf.directions import NORMAL, Direction, rotate_y
from jaxbrdf.ndf.base import AbstractNDF, from_slopes, slopes
from jaxbrdf.ndf.gaussian_microfacets import GaussianCylinder
from jaxbrdf.special import (
    exponential_nodes,
    fold,
    gauss_legendre,
    safe_arctan2,
    safe_divide,
    safe_hypot,
    safe_sqrt,
)


class Velvet(AbstractNDF):
    r"""An inverse Gaussian: no facet looks up, most look sideways, as on standing fibres.

        D(m) = p(m) / ⟨h·n⟩,   p(m) ∝ exp(−cot²θ/σ²) above the horizon

    Ashikhmin et al. 2000, eq. 35 (σ = 0.5 there). With y = cot²θ the share of facets steeper than y is
    S(y) / S(0), S(y) = ∫_y^∞ e^{−y'/σ²} / (1 + y')² dy', and D = e^{−y/σ²} / (π S(0)). `sigma` > 0; raises
    ValueError otherwise.
    """

    sigma: Parameter = parameter(domain=POSITIVE)

    @property
    def is_isotropic(self) -> bool:
        return True

    def _density(self, m: Direction) -> Float[Array, "..."]:
        t_x, t_y, above = slopes(m)
        tan2 = t_x**2 + t_y**2
        sideways = above & (tan2 > 0)
        exponent = -1 / (jnp.where(sideways, tan2, 1) * self.sigma**2) - self._log_tail(0 * self.sigma)
        return jnp.where(sideways, jnp.exp(exponent), 0) / jnp.pi

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        return in_chunks(self._area_at, safe_hypot(w[..., 0], w[..., 1]), w[..., 2])

    def _area_at(self, sin: Float[Array, ""], cos: Float[Array, ""]) -> Float[Array, ""]:
        r"""cos θ + ∫ (w·m)− D dm, ring by ring: 2/S(0) ∫ e^{−y/σ²} (R − c arctan(R / c)) / (π cosh³q) dq,
        c = cos θ sinh q, R = √(sin²θ − c²), y = sinh²q = cot²θ_m, to the ring θ_m = π/2 − θ that w just sees
        whole. Nodes gather there, where R² starts, and stop where e^{−y/σ²} does. Below the horizon
        σ(−w) = σ(w) − w·n."""
        cos, below = fold(cos)
        r, weights = gauss_legendre(64, cos.dtype)
        seen = jnp.arcsinh(safe_divide(sin, cos))
        q_max = jnp.where(cos > 0, jnp.minimum(seen, self._reach()), self._reach())
        q, dq = q_max * r**2 * (3 - 2 * r), q_max * 6 * r * (1 - r) * weights
        c = cos * jnp.sinh(q)
        R = safe_sqrt(sin**2 - c**2)
        bracket = R - c * safe_arctan2(R, c)
        exponent = -((jnp.sinh(q) / self.sigma) ** 2) - self._log_tail(0 * self.sigma)
        away = jnp.sum(dq * jnp.exp(exponent) * bracket / jnp.cosh(q) ** 3)
        return cos + below + 2 / jnp.pi * away

    def _reach(self) -> Float[Array, ""]:
        """The q beyond which e^{−y/σ²} < e^−40."""
        return jnp.arcsinh(jnp.sqrt(40.0) * self.sigma)

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        """S(y) = u_1 S(0): log S is convex, so Newton's steps from y = 0 approach the root monotonically;
        φ = 2π u_2. u_1 = 0 gives the normal itself."""
        steep = u[..., 0] > 0
        start = jnp.zeros_like(u[..., 0])
        target = jnp.log(jnp.where(steep, u[..., 0], 1)) + self._log_tail(start)

        def newton(y, _):
            log_tail = self._log_tail(y)
            slope = -jnp.exp(-y / self.sigma**2 - log_tail) / (1 + y) ** 2
            return y - (log_tail - target) / slope, None

        y, _ = jax.lax.scan(newton, start, None, length=16)
        tan = jnp.where(steep, safe_divide(1.0, safe_sqrt(y)), 0)
        phi = 2 * jnp.pi * u[..., 1]
        return from_slopes(tan * jnp.cos(phi), tan * jnp.sin(phi))

    def _log_tail(self, y: Float[Array, "..."]) -> Float[Array, "..."]:
        """log S(y), with y' = y + σ² t on the nodes of e^{−t}."""
        t, weights = exponential_nodes(jnp.result_type(float, y))
        total = jnp.add.outer(1 + y, self.sigma**2 * t) ** -2 @ weights
        return 2 * jnp.log(self.sigma) - y / self.sigma**2 + jnp.log(total)


class SlantedVelvet(AbstractNDF):
    r"""Leaning fibres: the facets of a cylinder along x, turned about y by the slant.

        D(m) = D_C(R_y(−slant) m) / (2 cos slant),   σ(w) = σ_C(R_y(−slant) w) / (2 cos slant)

    D_C being `GaussianCylinder(sigma)`; Ashikhmin et al. 2000, section 6.4 (slant 40°, σ = 0.5). It reaches
    below the horizon, its mean normal leans with the fibres, and ∫ D (m·n) dm = ½: the tops of the bundles,
    of which no light is reflected, make up the other half. No surface has such facets: a reflectance made
    with it may reflect more light than it gets. Drawn as the fibres' normals that n sees. `slant` in (−π/2,
    π/2) radians, `sigma` > 0; raises ValueError otherwise.
    """

    slant: Parameter = parameter(domain=Domain(-1.57, 1.57))
    sigma: Parameter = parameter(domain=POSITIVE)

    @property
    def is_isotropic(self) -> bool:
        return False

    def _density(self, m: Direction) -> Float[Array, "..."]:
        return GaussianCylinder(self.sigma)._density(rotate_y(m, -self.slant)) / (2 * jnp.cos(self.slant))

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        area = GaussianCylinder(self.sigma)._projected_area(rotate_y(w, -self.slant))
        return area / (2 * jnp.cos(self.slant))

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        n = jnp.array(NORMAL, u.dtype)
        m = GaussianCylinder(self.sigma)._sample_visible(u, rotate_y(n, -self.slant))
        return rotate_y(m, self.slant)
