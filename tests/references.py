r"""Independent truths: what the tests compare the library with. Nothing here imports jaxbrdf or JAX.

mpmath where a function has a name, plain numpy quadrature where it has none. Directions are (..., 3),
angles in radians. A *density* is a numpy function from directions (..., 3) to D (...), 1/sr.
"""

from collections.abc import Callable
from functools import cache
from itertools import pairwise

import mpmath
import numpy as np

Density = Callable[[np.ndarray], np.ndarray]
PUBLISHED_LOBES = [(1e-5, 0.5), (0.0148, 0.459), (0.05, 1.0), (0.2, 1.8), (0.9, 0.1), (1.0, 0.0), (1.0, 2.0)]


def direction(theta, phi) -> np.ndarray:
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def rotation(axis: str, angle: float) -> np.ndarray:
    """The active right-handed rotation R_y(t) or R_z(t)."""
    c, s = np.cos(angle), np.sin(angle)
    if axis == "y":
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def half_difference(wi: np.ndarray, wo: np.ndarray) -> tuple[float, float, float, float]:
    """Rusinkiewicz's (θ_h, φ_h, θ_d, φ_d) of one pair, by rotation matrices: d = R_y(−θ_h) R_z(−φ_h) wi."""
    h = (wi + wo) / np.linalg.norm(wi + wo)
    theta_h, phi_h = np.arccos(h[2]), np.arctan2(h[1], h[0])
    d = rotation("y", -theta_h) @ rotation("z", -phi_h) @ wi
    return theta_h, phi_h, np.arccos(d[2]), np.arctan2(d[1], d[0])


@cache
def log_upper_gamma(s: float, x: float) -> tuple[float, float, float]:
    """log Γ(s, x) and its derivatives by s and by x, from 60 digits (gammainc cancels for negative s)."""
    with mpmath.workdps(60):
        s, x = mpmath.mpf(s), mpmath.mpf(x)
        gamma = mpmath.gammainc(s, x)
        by_s = mpmath.diff(lambda a: mpmath.gammainc(a, x), s) / gamma
        by_x = -(x ** (s - 1)) * mpmath.exp(-x) / gamma
        return float(mpmath.log(gamma)), float(by_s), float(by_x)


def sgd_factor(alpha: float, p: float) -> float:
    """The published tables' K = 1 / (α Γ(1−p, α)), with D = K exp(−a) / (π a^p cos⁴θ), a = α + tan²θ/α."""
    with mpmath.workdps(60):
        return float(1 / (mpmath.mpf(alpha) * mpmath.gammainc(1 - mpmath.mpf(p), alpha)))


def sgd(alpha: float, p: float) -> Density:
    """The shifted gamma density, in the form that the published tables use."""
    factor = sgd_factor(alpha, p)

    def density(m):
        above = m[..., 2] > 0
        cos = np.where(above, m[..., 2], 1)
        a = alpha + (m[..., 0] ** 2 + m[..., 1] ** 2) / (cos**2 * alpha)
        return np.where(above, factor * np.exp(-a) / (np.pi * a**p * cos**4), 0)

    return density


@cache
def sgd_projected_area(alpha: float, p: float, theta: float) -> float:
    r"""σ(θ) = cos θ (1 + Λ) of the shifted gamma distribution, by the paper's own section 4.3 in mpmath:

    P_2(r) = U(p, p + 1/2, α + r²/α) exp(−α − r²/α) / (√(πα) Γ(1−p, α)),
    Λ(θ) = ∫_{cot θ}^∞ (r tan θ − 1) P_2(r) dr
    """
    with mpmath.workdps(20):
        alpha, p, theta = mpmath.mpf(alpha), mpmath.mpf(p), mpmath.mpf(theta)
        cot, width = mpmath.cos(theta) / mpmath.sin(theta), mpmath.sqrt(alpha)

        def integrand(r):
            z = alpha + r**2 / alpha
            return (r / cot - 1) * mpmath.hyperu(p, p + 0.5, z) * mpmath.exp(-z)

        ends = [cot + width * f for f in (0, 1e-3, 1e-2, 0.1, 0.5, 1, 2, 4, 8)]
        scale = mpmath.sqrt(mpmath.pi * alpha) * mpmath.gammainc(1 - p, alpha)
        return float(mpmath.cos(theta) * (1 + mpmath.quad(integrand, ends) / scale))


def projected_area(density: Density, w: np.ndarray) -> float:
    r"""σ(w) = ∫ (w·m)+ D(m) dm over the upper hemisphere by brute force, for one direction w (3,).

    At each θ_m the facets that face w fill |φ_m − φ_w| < φ_0 = arccos(−cot θ_w cot θ_m). Gauss–Legendre in
    both angles; θ_m in panels that shrink towards the peak, the horizon and the angle where φ_0 leaves π.
    """
    theta_w, phi_w = np.arctan2(np.hypot(w[0], w[1]), w[2]), np.arctan2(w[1], w[0])
    theta_m, d_theta = graded_nodes([0, abs(np.pi / 2 - theta_w), np.pi / 2])
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = -np.cos(theta_w) / np.sin(theta_w) / np.tan(theta_m)
    phi_0 = np.arccos(np.clip(np.where(np.isnan(cosine), -1, cosine), -1, 1))[:, None]
    u, du = np.polynomial.legendre.leggauss(48)
    m = direction(theta_m[:, None], phi_w + phi_0 * u)
    return float(np.sum((m @ w) * density(m) * np.sin(theta_m)[:, None] * d_theta[:, None] * phi_0 * du))


def hemisphere_integral(function: Density) -> float:
    """∫ f(m) dm over the upper hemisphere, in panels that shrink towards the pole and the horizon."""
    theta, d_theta = graded_nodes([0, np.pi / 2])
    phi = (np.arange(64) + 0.5) * (2 * np.pi / 64)
    values = function(direction(theta[:, None], phi[None, :]))
    return float(np.sum(values * (np.sin(theta) * d_theta)[:, None]) * (2 * np.pi / 64))


def graded_nodes(ends: list[float], nodes: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Gauss–Legendre nodes and weights between the first and the last of `ends`, gathered at each of them."""
    steps = np.concatenate([[0], 0.25 ** np.arange(20, 0, -1) * 2])  # 0 … 1/2 of an interval
    borders = {end for a, b in pairwise(ends) for s in steps for end in (a + (b - a) * s, b - (b - a) * s)}
    borders = np.array(sorted(borders))
    x, weight = np.polynomial.legendre.leggauss(nodes)
    width = np.diff(borders)[:, None] / 2
    return (borders[:-1, None] + width * (1 + x)).reshape(-1), (width * weight).reshape(-1)


def cook_torrance(wi, wo, *, rho_d, rho_s, alpha, p, f0, f1) -> float:
    """Bagher 2012, eq. 1 with the shifted gamma distribution, exact Smith masking and eq. 11; one pair."""
    h = (wi + wo) / np.linalg.norm(wi + wo)
    density = sgd(alpha, p)
    cos_d = wi @ h
    F = f0 + (1 - f0) * (1 - cos_d) ** 5 - f1 * cos_d
    G = wi[2] / projected_area(density, wi) * wo[2] / projected_area(density, wo)
    return float(rho_d / np.pi + rho_s / np.pi * F * density(h) * G / (wi[2] * wo[2]))


def albedo(brdf: Callable[[np.ndarray, np.ndarray], np.ndarray], theta_i: float, n: int = 600) -> float:
    """∫ f cos θ_o dω_o by the trapezoid rule in (θ_o, φ_o); brdf takes wi, wo (..., 3) of one shape."""
    theta, phi = np.linspace(0, np.pi / 2, n), np.linspace(0, 2 * np.pi, n, endpoint=False)
    wo = direction(theta[:, None], phi[None, :])
    f = np.asarray(brdf(np.broadcast_to(direction(theta_i, 0.0), wo.shape), wo))
    inner = f.sum(axis=1) * (2 * np.pi / n) * np.cos(theta) * np.sin(theta)
    return float(np.trapezoid(inner, theta))


def mask_approximation(theta: float, lam: float, c: float, k: float) -> tuple[float, float]:
    """G1(θ) and θ_0 of Bagher 2012, eq. 9, in 50 digits: c reaches 1e109."""
    with mpmath.workdps(50):
        theta, lam, c, k = (mpmath.mpf(v) for v in (theta, lam, c, k))
        theta_0 = mpmath.pi / 2 - (mpmath.log(1 + 1 / lam) / c) ** (1 / k)
        beyond = theta - theta_0
        G1 = 1 + lam * (1 - mpmath.exp(c * beyond**k)) if beyond > 0 else mpmath.mpf(1)
        return float(G1), float(theta_0)
