"""The classic reflectances by their papers' angles, in plain numpy; each gives f(wi, wo) of one pair.

Angles come from arctan2, which keeps the digits of small ones and does not mind the lengths of its vectors.
"""

from collections.abc import Callable

import numpy as np

Truth = Callable[[np.ndarray, np.ndarray], float]


def polar(w: np.ndarray) -> tuple[float, float]:
    """(θ, φ)."""
    return np.arctan2(np.hypot(w[0], w[1]), w[2]), np.arctan2(w[1], w[0])


def between(a: np.ndarray, b: np.ndarray) -> float:
    """The angle between two vectors, in [0, π]."""
    return np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)


def cosine_power(theta: float, exponent: float) -> float:
    """cos^e θ = (1 − sin²θ)^{e/2}, 0 from a right angle on."""
    return np.exp(exponent / 2 * np.log1p(-(np.sin(theta) ** 2))) if theta < np.pi / 2 else 0.0


def oren_nayar(albedo, sigma, constant=0.57) -> Truth:
    A = 1 - 0.5 * sigma**2 / (sigma**2 + constant)
    B = 0.45 * sigma**2 / (sigma**2 + 0.09)

    def f(wi, wo):
        (theta_i, phi_i), (theta_o, phi_o) = polar(wi), polar(wo)
        alpha, beta = max(theta_i, theta_o), min(theta_i, theta_o)
        return albedo / np.pi * (A + B * max(0, np.cos(phi_i - phi_o)) * np.sin(alpha) * np.tan(beta))

    return f


def phong(exponent) -> Truth:
    """By the angle between wo and wi turned by 180° about n."""
    turn = np.diag([-1.0, -1.0, 1.0])
    return lambda wi, wo: (exponent + 2) / (2 * np.pi) * cosine_power(between(turn @ wi, wo), exponent)


def blinn_phong(exponent) -> Truth:
    return lambda wi, wo: (exponent + 2) / (2 * np.pi) * cosine_power(polar(wi + wo)[0], exponent)


def lafortune(exponent, c_x, c_y, c_z) -> Truth:
    """The quadratic form wiᵀ C wo, in a logarithm."""

    def f(wi, wo):
        s = wi @ np.diag([c_x, c_y, c_z]) @ wo
        return np.exp(exponent * np.log(s)) if s > 0 else 0.0

    return f


def _ward(alpha_x, alpha_y, q) -> Truth:
    alpha_y = alpha_x if alpha_y is None else alpha_y

    def f(wi, wo):
        theta_h, phi_h = polar(wi + wo)
        stretch = (np.cos(phi_h) / alpha_x) ** 2 + (np.sin(phi_h) / alpha_y) ** 2
        gaussian = np.exp(-(np.tan(theta_h) ** 2) * stretch)
        return gaussian / (4 * np.pi * alpha_x * alpha_y * q(np.cos(polar(wi)[0]) * np.cos(polar(wo)[0])))

    return f


def ward(alpha_x, alpha_y=None) -> Truth:
    return _ward(alpha_x, alpha_y, np.sqrt)


def ward_duer(alpha_x, alpha_y=None) -> Truth:
    return _ward(alpha_x, alpha_y, lambda product: product)


def ashikhmin_shirley_lobe(f0, exponent_x, exponent_y=None) -> Truth:
    """θ_d is half the angle between wi and wo."""
    exponent_y = exponent_x if exponent_y is None else exponent_y
    scale = np.sqrt((exponent_x + 1) * (exponent_y + 1)) / (8 * np.pi)

    def f(wi, wo):
        theta_h, phi_h = polar(wi + wo)
        exponent = exponent_x * np.cos(phi_h) ** 2 + exponent_y * np.sin(phi_h) ** 2
        cos_d = np.cos(between(wi, wo) / 2)
        F = f0 + (1 - f0) * (1 - cos_d) ** 5
        return scale * cosine_power(theta_h, exponent) * F / (cos_d * max(wi[2], wo[2]))

    return f


def ashikhmin_shirley_diffuse(rho_d, rho_s) -> Truth:
    """The paper's product as the polynomial 1 − (1 − x)^5 = 5x − 10x² + 10x³ − 5x⁴ + x⁵ at x = cos θ/2."""
    passed = np.polynomial.Polynomial([0, 5, -10, 10, -5, 1])

    def f(wi, wo):
        both = passed(np.cos(polar(wi)[0]) / 2) * passed(np.cos(polar(wo)[0]) / 2)
        return 28 * rho_d / (23 * np.pi) * (1 - rho_s) * both

    return f


def ashikhmin_shirley(rho_d, rho_s, exponent_x, exponent_y=None) -> Truth:
    diffuse = ashikhmin_shirley_diffuse(rho_d, rho_s)
    lobe = ashikhmin_shirley_lobe(rho_s, exponent_x, exponent_y)
    return lambda wi, wo: diffuse(wi, wo) + lobe(wi, wo)
