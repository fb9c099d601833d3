"""The ellipsoid distribution: the facets of an ellipsoid in any position, skewed where it is tilted."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.arrays import POSITIVE, Parameter, Range, parameter
from jaxbrdf.directions import NORMAL, Direction, cos_theta, dot, rotate_x, rotate_y, rotate_z, safe_normalize
from jaxbrdf.ndf.base import AbstractNDF, AbstractVisibleNDF, one_each
from jaxbrdf.ndf.visible_hemisphere import sample_visible_hemisphere
from jaxbrdf.special import safe_sqrt


class Ellipsoid(AbstractVisibleNDF):
    r"""Ellipsoid distribution: Trowbridge–Reitz with anisotropy in any direction, and skew.

        D(m) = χ(m·n) / (π |A| ‖A n‖ ‖A^{−T} m‖⁴),   A = S R_x(θ_x) R_y(θ_y) R_z(θ_z),   S = diag(α_x, α_y, 1)
        σ(w) = (‖A w‖ ‖A n‖ + A w · A n) / (2 ‖A n‖²)

    Dong et al. 2015, eq. 10 to 14; σ is the projected area of the half ellipsoid whose facets look up,
    exactly, so it is stated for every w. A skewed one has ⟨m⟩ = AᵀA n / ‖A n‖² off the normal, and w·n / σ(w)
    may exceed 1: Smith's masking clips it, σ is never clipped. Normals, visible ones too, are drawn as points
    of the ellipsoid: m ∝ Aᵀ s, s on the unit sphere (Heitz 2018). `alpha_x`, `alpha_y` > 0, angles in
    radians. Raises ValueError for other values.
    """

    closed_form_area = True

    alpha_x: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-3, 3.0, log=True))
    alpha_y: Parameter = parameter(domain=POSITIVE, fitted=Range(1e-3, 3.0, log=True))
    theta_x: Parameter = parameter(fitted=Range(-jnp.pi / 4, jnp.pi / 4))
    theta_y: Parameter = parameter(fitted=Range(-jnp.pi / 4, jnp.pi / 4))
    theta_z: Parameter = parameter(fitted=Range(-jnp.pi / 2, jnp.pi / 2))

    @property
    def is_isotropic(self) -> bool:
        return False

    @classmethod
    def guesses(
        cls, m: Float[np.ndarray, "K 3"], D: Float[np.ndarray, " K"], weight: Float[np.ndarray, " K"]
    ) -> list[AbstractNDF]:
        """The ellipsoid whose D^(−1/2) is nearest: c mᵀQm with Q = A⁻¹A^{−T} = Rᵀ S^{−2} R, linear in six
        numbers. Weighed by D³, as d D^(−1/2) = −½ D^(−3/2) dD; cells that hold nothing are left out."""
        held = D > 0
        root = np.sqrt(weight[held] * D[held] ** 3)
        x, y, z = m[held].T
        monomials = np.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y], axis=1)
        if len(x) < 6:
            return []
        a, b, c, d, e, f = np.linalg.lstsq(monomials * root[:, None], root / np.sqrt(D[held]), rcond=None)[0]
        return [_from_quadric(np.array([[a, f, e], [f, b, d], [e, d, c]]))]

    def _density(self, m: Direction) -> Float[Array, "..."]:
        x, y, z = jnp.moveaxis(self._rotate(m), -1, 0)
        length2 = (x / self.alpha_x) ** 2 + (y / self.alpha_y) ** 2 + z**2  # ‖A^{−T} m‖², A^{−T} = S^{−1} R
        above = cos_theta(m) > 0
        scale = jnp.pi * self.alpha_x * self.alpha_y * self._A_n()[1]
        return jnp.where(above, 1 / (scale * jnp.where(above, length2, 1) ** 2), 0)

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        A_n, length = self._A_n()
        A_w = self._stretch(self._rotate(w))
        along = dot(A_w, jnp.broadcast_to(A_n / length, A_w.shape))
        return (safe_sqrt(dot(A_w, A_w)) + along) / (2 * length)

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        return self._sample_visible(u, jnp.array(NORMAL, u.dtype))

    def _sample_visible(self, u: Float[Array, "... 2"], w: Direction) -> Direction:
        A_n, length = self._A_n()
        A_w = self._stretch(self._rotate(one_each(u, w)))
        s = sample_visible_hemisphere(u, safe_normalize(A_w), A_n / length)
        return safe_normalize(self._rotate_back(self._stretch(s)))

    def _A_n(self) -> tuple[Float[Array, "3"], Float[Array, ""]]:
        """A n and its length."""
        A_n = self._stretch(self._rotate(jnp.array(NORMAL, self.alpha_x.dtype)))
        return A_n, jnp.sqrt(jnp.sum(A_n * A_n))

    def _stretch(self, w: Direction) -> Direction:
        return jnp.stack([self.alpha_x * w[..., 0], self.alpha_y * w[..., 1], w[..., 2]], axis=-1)

    def _rotate(self, w: Direction) -> Direction:
        return rotate_x(rotate_y(rotate_z(w, self.theta_z), self.theta_y), self.theta_x)

    def _rotate_back(self, w: Direction) -> Direction:
        return rotate_z(rotate_y(rotate_x(w, -self.theta_x), -self.theta_y), -self.theta_z)


def _from_quadric(Q: np.ndarray) -> Ellipsoid:
    """The ellipsoid of c Q = c Rᵀ S^{−2} R, whatever c is; of its names that with |θ_z| ≤ π/4."""
    squares, axes = np.linalg.eigh(Q)
    squares = np.maximum(squares, 1e-9 * squares[-1])
    order = np.argsort(np.abs(axes[2]))  # the axis nearest to the normal is z
    first, second = sorted(order[:2], key=lambda k: -abs(axes[0, k]))  # the one nearest to x is x
    R = axes[:, [first, second, order[2]]].T
    R = R * np.sign(np.array([R[0, 0], R[1, 1], R[2, 2]]))[:, None]
    alpha = np.sqrt(squares[order[2]] / squares[[first, second]])
    angles = np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(R[0, 2]), np.arctan2(-R[0, 1], R[0, 0])
    return Ellipsoid(alpha[0], alpha[1], *angles)
