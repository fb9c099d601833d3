"""Truths of Ashikhmin's generator over Beckmann's facets, and of facets that scatter, in plain numpy.

Sums over a fine grid of facets, whose σ has a name: no table, and no node of the library's.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.special import erf

from tests import references

Truth = Callable[[np.ndarray, np.ndarray], float]


def beckmann_area(alpha_x: float, alpha_y: float, w: np.ndarray) -> np.ndarray:
    """w_z (1 + erf a)/2 + r e^{−a²}/(2√π), a = w_z / r, r² = α_x² w_x² + α_y² w_y² (Smith 1967)."""
    r = np.maximum(np.hypot(alpha_x * w[..., 0], alpha_y * w[..., 1]), 1e-300)
    a = np.clip(w[..., 2] / r, -30, 30)
    return w[..., 2] * (1 + erf(a)) / 2 + r * np.exp(-(a**2)) / (2 * np.sqrt(np.pi))


def masking(alpha_x: float, alpha_y: float, w: np.ndarray) -> np.ndarray:
    return np.maximum(w[..., 2], 0) / beckmann_area(alpha_x, alpha_y, w)


@cache
def beckmann_facets(alpha_x: float, alpha_y: float, n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Normals (n², 3) and D dm: midpoints of the plane of slopes, dm = cos³θ dt_x dt_y, 6 widths far."""
    t = (np.arange(n) + 0.5) / n * 12 - 6
    t_x, t_y = (a.ravel() for a in np.meshgrid(alpha_x * t, alpha_y * t))
    m = np.stack([t_x, t_y, np.ones_like(t_x)], axis=-1)
    m /= np.linalg.norm(m, axis=-1, keepdims=True)
    return m, references.beckmann(alpha_x, alpha_y)(m) * m[:, 2] ** 3 * alpha_x * alpha_y * (12 / n) ** 2


def facets(density: references.Density, azimuths: int = 256) -> tuple[np.ndarray, np.ndarray]:
    """Normals and D dm of any density of the references, piece by piece."""
    normals, areas = [], []
    for piece in references.pieces(density):
        ends = [0, np.pi / 2, np.pi] if piece.whole else [0, np.pi / 2]
        theta, d_theta = references.graded_nodes(ends, 20, piece.levels)
        phi = (np.arange(azimuths) + 0.5) * 2 * np.pi / azimuths
        m, solid_angle = piece.normals(theta[:, None], phi[None, :])
        normals.append(m.reshape(-1, 3))
        areas.append((piece(m) * solid_angle * d_theta[:, None] * 2 * np.pi / azimuths).ravel())
    return np.concatenate(normals), np.concatenate(areas)


@cache
def reflectances(alpha_x: float, alpha_y: float, w: tuple[float, float, float], n=400) -> tuple[float, float]:
    """R_0 and R_1 of light along w: F(w·m) times the masking of the mirror direction, mean over (w·m)+ D."""
    m, area = beckmann_facets(alpha_x, alpha_y, n)
    w = np.array(w)
    cosine = np.maximum(m @ w, 0)
    seen = area * cosine * masking(alpha_x, alpha_y, 2 * cosine[:, None] * m - w)
    total = beckmann_area(alpha_x, alpha_y, w)
    return float(np.sum(seen * (1 - cosine) ** 5) / total), float(np.sum(seen) / total)


def reflectance(alpha_x: float, alpha_y: float, f0: float, w: np.ndarray, n=400) -> float:
    R_0, R_1 = reflectances(alpha_x, alpha_y, tuple(float(c) for c in w), n)
    return R_0 + f0 * (R_1 - R_0)


@cache
def left_over(alpha_x: float, alpha_y: float, f0: float, available: float) -> float:
    """∫ (a − R(w))+ (w·n) dw, over a quarter of the hemisphere: Gauss–Legendre in √cos θ, midpoints in φ."""
    azimuths = 1 if alpha_x == alpha_y else 12
    x, weight = np.polynomial.legendre.leggauss(16)
    s, ds = (x + 1) / 2, weight / 2
    phi = (np.arange(azimuths) + 0.5) / azimuths * np.pi / 2
    w = references.direction(np.arccos(s**2)[:, None], phi[None, :])
    left = [[max(available - reflectance(alpha_x, alpha_y, f0, v, 200), 0) for v in row] for row in w]
    return float(2 * np.pi * np.sum(np.mean(left, axis=1) * s**2 * 2 * s * ds))


def _generated(alpha_x, alpha_y, f0, rho_d, available) -> Truth:
    D = references.beckmann(alpha_x, alpha_y)

    def f(wi, wo):
        h = (wi + wo) / np.linalg.norm(wi + wo)
        F = f0 + (1 - f0) * (1 - wi @ h) ** 5
        areas = [beckmann_area(alpha_x, alpha_y, w) for w in (wi, wo)]
        left = [max(available - reflectance(alpha_x, alpha_y, f0, w), 0) for w in (wi, wo)]
        diffuse = rho_d * left[0] * left[1] / (left_over(alpha_x, alpha_y, f0, available) or 1)
        return float(diffuse + F * D(h) / (4 * areas[0] * areas[1]))

    return f


def generated(alpha_x: float, alpha_y: float, f0: float, rho_d: float) -> Truth:
    """Ashikhmin 2000, eq. 26 and 30."""
    return _generated(alpha_x, alpha_y, f0, rho_d, 1.0)


def generated_metal(alpha_x: float, alpha_y: float, f0: float) -> Truth:
    """The same with f_0 for 1 and for ρ_d."""
    return _generated(alpha_x, alpha_y, f0, f0, f0)


def facet_scattering(alpha_x: float, alpha_y: float, beta: Callable) -> Truth:
    """Ashikhmin 2000, eq. 33; beta(m, wi, wo) of facets m (n, 3), in the frame of the surface."""

    def f(wi, wo):
        m, area = beckmann_facets(alpha_x, alpha_y)
        total = np.sum(area * np.maximum(m @ wi, 0) * np.maximum(m @ wo, 0) * beta(m, wi, wo))
        return float(total / (beckmann_area(alpha_x, alpha_y, wi) * beckmann_area(alpha_x, alpha_y, wo)))

    return f


def lambertian_facets(alpha_x: float, alpha_y: float, albedo: float) -> Truth:
    return facet_scattering(alpha_x, alpha_y, lambda m, wi, wo: albedo / np.pi)
