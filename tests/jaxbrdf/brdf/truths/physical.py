"""Truths of the ABC models, of Sun's rough metal and of Kirchhoff's reflectance, in plain numpy."""

from functools import cache

import numpy as np


def conductor(cos_d: float, eta: float, kappa: float) -> float:
    """Fresnel's two reflectances of a complex index, by Snell's law in complex angles, averaged."""
    index = eta + 1j * kappa
    u = np.sqrt(index**2 - (1 - cos_d**2))
    across = (cos_d - u) / (cos_d + u)
    along = (index**2 * cos_d - u) / (index**2 * cos_d + u)
    return float((abs(across) ** 2 + abs(along) ** 2) / 2)


def abc(a: float, b: float, c: float, eta: float):
    """F G S / (π cos θ_i cos θ_o), Löw et al. 2012, with the three terms of Torrance and Sparrow's G."""

    def f(wi, wo):
        h = (wi + wo) / np.linalg.norm(wi + wo)
        cos_d = wi @ h
        G = min(1, 2 * h[2] * wi[2] / cos_d, 2 * h[2] * wo[2] / cos_d)
        S = a / (1 + b * (1 - h[2])) ** c
        return conductor(cos_d, eta, 0) * G * S / (np.pi * wi[2] * wo[2])

    return f


def smooth_abc(a: float, b: float, c: float, eta: float):
    """F S(‖D_p‖), Löw et al. 2012, eq. 10 to 12: D_p from the mirror direction to wi, on the plane."""

    def f(wi, wo):
        mirror = 2 * wo[2] * np.array([0, 0, 1]) - wo
        D_p = (wi - mirror)[:2]
        half_angle = np.arccos(wi @ wo) / 2
        return conductor(np.cos(half_angle), eta, 0) * a / (1 + b * D_p @ D_p) ** c

    return f


def free_travel(s: float, theta: float) -> float:
    """Γ_0(θ), Sun 2002, eq. 3.4.23."""
    tan = np.tan(theta)
    return 1.0 if tan == 0 else np.exp(-tan / (np.sqrt(2 * np.pi) * s) * np.exp(-(s**2) / (4 * tan**2)))


def sun_as_printed(s: float, eta: float, kappa: float):
    """ρ of Sun 2002, eq. 3.5.3, from the four angles by eq. 3.2.7 and 3.2.8."""

    def rho(wi, wo):
        theta_i, theta_v = np.arccos(wi[2]), np.arccos(wo[2])
        phi_i, phi_v = np.arctan2(wi[1], wi[0]), np.arctan2(wo[1], wo[0])
        cos_delta = np.sin(theta_i) * np.sin(theta_v) * np.cos(phi_i - phi_v) + np.cos(theta_i) * np.cos(
            theta_v
        )
        cos_half_delta = np.sqrt((1 + cos_delta) / 2)
        cos = (np.cos(theta_i) + np.cos(theta_v)) / np.sqrt(2 + 2 * cos_delta)
        tan2 = (1 - cos**2) / cos**2
        lobe = s**2 * np.exp(-(s**2) * tan2 / 4) * free_travel(s, theta_i) * free_travel(s, theta_v)
        return conductor(cos_half_delta, eta, kappa) * lobe / (16 * np.pi * cos**3 * cos_half_delta)

    return rho


def rough_metal(s: float, eta: float, kappa: float):
    """F D G / (4 cos θ_i cos θ_o) with Gaussian slopes of standard deviation √2/s and G = Γ_0 Γ_0."""

    def f(wi, wo):
        h = (wi + wo) / np.linalg.norm(wi + wo)
        slope2 = (h[0] ** 2 + h[1] ** 2) / h[2] ** 2
        variance = 2 / s**2
        D = np.exp(-slope2 / (2 * variance)) / (2 * np.pi * variance) / h[2] ** 4
        G = free_travel(s, np.arccos(wi[2])) * free_travel(s, np.arccos(wo[2]))
        return conductor(wi @ h, eta, kappa) * D * G / (4 * wi[2] * wo[2])

    return f


# Kirchhoff's distribution at three effective wavelengths

CELLS = 33
WAVELENGTHS_Q = np.array([0.4, 0.6, 0.9])  # µm


def cell_centres() -> tuple[np.ndarray, np.ndarray]:
    """m_x and m_y of the cells [row, column]: rows run along y."""
    centre = (2 * np.arange(CELLS) + 1) / CELLS - 1
    return np.broadcast_to(centre[None, :], (CELLS, CELLS)), np.broadcast_to(centre[:, None], (CELLS, CELLS))


@cache
def tables() -> np.ndarray:
    """(3, N, N): lobes without symmetry, each rougher and more tilted than the last; Σ D dA = 1."""
    m_x, m_y = cell_centres()
    stack = []
    for width in (0.25, 0.35, 0.5):
        z2 = np.maximum(1 - m_x**2 - m_y**2, 0)
        z2 = np.where(z2 > 0, z2, np.inf)
        slope2 = ((m_x - 0.2 * width) ** 2 + 2 * (m_y + 0.3 * width) ** 2) / z2
        D = np.where(np.isfinite(z2), np.exp(-slope2 / width**2), 0)
        stack.append(D / np.sum(D * (2 / CELLS) ** 2))
    return np.stack(stack)


def cell_value(table: np.ndarray, h: np.ndarray) -> float:
    """The value of the cell that a normal lies in."""
    row, column = (min(int((x + 1) / 2 * len(table)), len(table) - 1) for x in (h[1], h[0]))
    return table[row, column]


def kirchhoff_distribution(h: np.ndarray, wavelength_q: float) -> float:
    """D_K, linear in 1/λ_q between the tables, the nearest one outside."""
    each = [cell_value(table, h) for table in tables()]
    return float(np.interp(1 / wavelength_q, 1 / WAVELENGTHS_Q[::-1], each[::-1]))


def kirchhoff(wavelength: float, f0: float):
    """Dong et al. 2015, eq. 8, of the tables above, a constant Fresnel term and Smith's G of their mean."""
    m_x, m_y = cell_centres()
    m_z = np.sqrt(np.maximum(1 - m_x**2 - m_y**2, 0))
    weight = tables().mean(axis=0) * (2 / CELLS) ** 2 / np.where(m_z > 0, m_z, np.inf)

    def masking(w):
        return min(1, w[2] / np.sum(np.maximum(w[0] * m_x + w[1] * m_y + w[2] * m_z, 0) * weight))

    def f(wi, wo):
        length = np.linalg.norm(wi + wo)
        D = kirchhoff_distribution((wi + wo) / length, wavelength / (length / 2))
        return f0 * D * masking(wi) * masking(wo) / (4 * wi[2] * wo[2])

    return f
