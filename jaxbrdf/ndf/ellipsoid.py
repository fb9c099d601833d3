"""The ellipsoid distribution: the facets of an ellipsoid in any position, skewed where it is tilted."""

import dataclasses

import equinox as eqx
import jax
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

    In slopes s = (m_x, m_y) / m_z it is a bivariate Student t of two degrees of freedom,

        D(m) cos⁴θ = 1 / (π √|G|) (1 + (s − μ)ᵀ G⁻¹ (s − μ))^{−2},   AᵀA / ‖A n‖² = [[G + μμᵀ, μ], [μᵀ, 1]]

    so μ and G name the distribution in one way only, while (θ_x, θ_y, θ_z) and (−θ_x, −θ_y, θ_z + π) are the
    same, and so is what follows from exchanging the axes: see `slope_form` and `of_slopes`.
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
    def of_slopes(
        cls, mean: Float[np.ndarray, "... 2"], scatter: Float[np.ndarray, "... 2 2"], theta_z: float = 0.0
    ) -> "Ellipsoid":
        """The ellipsoids of mean slopes μ and squared roughnesses G, parameters (...): of the names of each
        that with θ_z within about π/4 of the given one; z is the axis nearest to the normal. NaN where μ or G
        is, or where G is singular."""
        mean, scatter = np.asarray(mean), np.asarray(scatter)
        known = np.isfinite(mean).all(-1) & np.isfinite(scatter).all((-2, -1))
        mu = np.where(known[..., None], mean, 0)[..., None]
        G = np.where(known[..., None, None], scatter, np.eye(2))
        mu_T = np.swapaxes(mu, -1, -2)
        M = np.block([[G + mu * mu_T, mu], [mu_T, np.ones_like(mu[..., :1, :])]])
        alphas, R = _principal(M, theta_z)
        angles = (
            np.arctan2(-R[..., 1, 2], R[..., 2, 2]),
            np.arcsin(np.clip(R[..., 0, 2], -1, 1)),
            np.arctan2(-R[..., 0, 1], R[..., 0, 0]),
        )
        known = known & np.all(alphas > 0, axis=0)
        return cls(*(jnp.asarray(np.where(known, value, np.nan)) for value in (*alphas, *angles)))

    @classmethod
    def guesses(
        cls, m: Float[np.ndarray, "K 3"], D: Float[np.ndarray, " K"], weight: Float[np.ndarray, " K"]
    ) -> list[AbstractNDF]:
        mean, G = nearest_slopes(Monomials.of(m), jnp.asarray(D), jnp.asarray(weight))
        return [cls.of_slopes(np.asarray(mean), np.asarray(G))]

    def slope_form(self) -> tuple[Float[Array, "2"], Float[Array, "2 2"]]:
        """(μ, G), mean slope and squared roughness, of scalar parameters; μ = 0 and G = diag(α_x², α_y²) for
        angles of 0."""
        A_T = self._stretch(self._rotate(jnp.eye(3, dtype=self.alpha_x.dtype)))
        M = A_T @ A_T.T
        mean = M[:2, 2] / M[2, 2]
        return mean, M[:2, :2] / M[2, 2] - jnp.outer(mean, mean)

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


def _principal(M: np.ndarray, theta_z: float) -> tuple[np.ndarray, np.ndarray]:
    """(α_x, α_y), (2, ...), and R, whose rows are the axes, of AᵀA = Rᵀ S² R: the axis nearest to the normal
    is z, and x the one nearest to what x would be at the given θ_z."""
    squares, axes = np.linalg.eigh(M)
    rows = np.swapaxes(axes, -1, -2)
    x = np.array([np.cos(theta_z), -np.sin(theta_z), 0.0])
    upright = np.abs(rows[..., 2])
    lying = np.abs(rows @ x) - 2 * (upright == upright.max(-1, keepdims=True))  # never the axis that is z
    third, first = np.argmax(upright, axis=-1), np.argmax(lying, axis=-1)
    e_x, e_z = (np.take_along_axis(rows, k[..., None, None], -2)[..., 0, :] for k in (first, third))
    e_x, e_z = e_x * np.where(e_x @ x < 0, -1, 1)[..., None], e_z * np.where(e_z[..., 2:] < 0, -1, 1)
    chosen = np.stack([first, 3 - first - third])
    lengths = np.stack([np.take_along_axis(squares, k[..., None], -1)[..., 0] for k in (*chosen, third)])
    alphas = np.sqrt(np.maximum(lengths[:2], 0) / lengths[2])
    return alphas, np.stack([e_x, np.cross(e_z, e_x), e_z], axis=-2)


def mean_theta_z(scatter: Float[np.ndarray, "B 2 2"]) -> float:
    """The orientation of many ellipsoids: that θ_z in [−π/4, π/4] at which one axis lies along their mean
    anisotropy, Σ G / tr G; 0 where there is none. Ellipsoids that are NaN do not count."""
    xx, xy, yy = scatter[:, 0, 0], scatter[:, 0, 1], scatter[:, 1, 1]
    azimuth = np.arctan2(np.nansum(2 * xy / (xx + yy)), np.nansum((xx - yy) / (xx + yy))) / 2
    return float(-(azimuth - np.pi / 2 * np.round(azimuth / (np.pi / 2))))


def aligned(ellipsoids: Ellipsoid) -> Ellipsoid:
    """The same distributions, parameters (...), by those of their names whose θ_z is nearest to the
    orientation of all: parameters of neighbouring patches are then neighbours, and θ_z does not jump."""
    names = [f.name for f in dataclasses.fields(Ellipsoid)]
    leaves = jnp.stack([getattr(ellipsoids, name) for name in names], axis=-1)
    slopes = jax.vmap(lambda row: Ellipsoid(*row).slope_form())(leaves.reshape(-1, len(names)))
    mean, G = (np.asarray(part) for part in slopes)
    flat = Ellipsoid.of_slopes(mean, G, mean_theta_z(G))
    return jax.tree.map(lambda leaf: leaf.reshape(leaves.shape[:-1]), flat)


class Monomials(eqx.Module):
    """φ = (m_x², m_y², m_z², 2 m_y m_z, 2 m_x m_z, 2 m_x m_y) of many normals, and what products of two are
    multiples of: the 15 monomials of degree 4.

    D^{−1/2} is q·φ for some q, whatever the ellipsoid is.
    """

    each: Float[Array, "6 K"]
    quartic: Float[Array, "15 K"]

    @classmethod
    def of(cls, m: Float[np.ndarray, "K 3"]) -> "Monomials":
        powers = [
            np.prod(m.T ** np.array(exponents)[:, None], axis=0) for exponents in (*_SQUARES, *_QUARTICS)
        ]
        return cls(jnp.asarray(_TIMES[:, None] * powers[:6]), jnp.asarray(np.stack(powers[6:])))

    def sums(self, weight: Float[Array, " K"]) -> Float[Array, "6"]:
        """Σ weight φ."""
        return self.each @ weight

    def sums_of_products(self, weight: Float[Array, " K"]) -> Float[Array, "6 6"]:
        """Σ weight φφᵀ: one matrix product for all of a batch of weights."""
        return jnp.outer(_TIMES, _TIMES) * (self.quartic @ weight)[_WHICH]

    def forms(self, P: Float[Array, "6 6"]) -> Float[Array, " K"]:
        """φᵀPφ."""
        scaled = np.outer(_TIMES, _TIMES) * P
        return jnp.zeros(15, P.dtype).at[_WHICH].add(scaled) @ self.quartic


# Of φ the exponents of m_x, m_y and m_z and the factors; of φφᵀ which quartic each entry is a multiple of.
_SQUARES = ((2, 0, 0), (0, 2, 0), (0, 0, 2), (0, 1, 1), (1, 0, 1), (1, 1, 0))
_TIMES = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
_QUARTICS = sorted({tuple(np.add(a, b).tolist()) for a in _SQUARES for b in _SQUARES})
_WHICH = np.array([[_QUARTICS.index(tuple(np.add(a, b).tolist())) for a in _SQUARES] for b in _SQUARES])


def nearest_slopes(
    monomials: Monomials, D: Float[Array, " K"], weight: Float[Array, " K"]
) -> tuple[Float[Array, "2"], Float[Array, "2 2"]]:
    """(μ, G) of the ellipsoid whose D^{−1/2} = c mᵀQm is nearest to a table, linear in the six numbers of Q.

    Weighed by D³, as d D^{−1/2} = −½ D^{−3/2} dD; cells that hold nothing are left out. Where the nearest
    quadric is no ellipsoid, μ is the mean slope of what the table holds, and G a third of the covariance,
    which is what a Student t of two degrees has of it in its core.
    """
    held = jnp.where(D > 0, D, 0)
    A = monomials.sums_of_products(weight * held * held * held)
    size = jnp.sqrt(jnp.maximum(jnp.diagonal(A), jnp.finfo(A.dtype).tiny))
    b = monomials.sums(weight * held * held * jnp.sqrt(held)) / size
    scaled = A / jnp.outer(size, size) + 1e-13 * jnp.eye(6)
    quadric = jnp.linalg.solve(scaled, b) / size
    return _slopes_of(quadric, monomials.sums(weight * held / monomials.each[2]))


def _slopes_of(
    quadric: Float[Array, "6"], moments: Float[Array, "6"]
) -> tuple[Float[Array, "2"], Float[Array, "2 2"]]:
    """(μ, G) of c Q, whatever c is; where Q is not positive definite, those of the moments of slopes."""
    a, b, c, d, e, f = quadric
    det = a * b - f**2
    mean = jnp.stack([f * d - b * e, f * e - a * d]) / det
    peak = c + e * mean[0] + d * mean[1]  # mᵀQm there
    G = jnp.array([[b, -f], [-f, a]]) * peak / det
    is_ellipsoid = (a > 0) & (det > 0) & (peak > 0)
    xx, yy, total, y, x, xy = moments / jnp.array([1, 1, 1, 2, 2, 2])
    centre = jnp.stack([x, y]) / total
    spread = jnp.array([[xx, xy], [xy, yy]]) / total - jnp.outer(centre, centre)
    return jnp.where(is_ellipsoid, mean, centre), jnp.where(is_ellipsoid, G, spread / 3)
