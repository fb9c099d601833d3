r"""Independent truths for fits of the shifted gamma reflectance: numpy and scipy, nothing of `fitting`.

The formulas are Bagher et al. 2012, sections 4.2, 5.2 and eq. 1 and 11, with exact Smith masking.
"""

import numpy as np
from scipy.optimize import least_squares, nnls

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_R, _DR = (1 + _NODES) / 2, _WEIGHTS / 2


def slope_density(x, alpha, p):
    r"""P22(x) with ∫ P22 dx = 1/π; its Γ(1−p, α) = ∫_α^∞ t^{−p} e^{−t} dt by quadrature in log t."""
    span = np.log(1 + 45 / alpha)
    t = alpha * np.exp(span * _R)
    gamma = np.sum(span * _DR * t ** (1 - p) * np.exp(-t))
    return alpha ** (p - 1) / gamma * np.exp(-(alpha**2 + x) / alpha) / (alpha**2 + x) ** p / np.pi


def log_area(cos_w, alpha, p):
    r"""log σ = log(cos θ (1 + Λ)), with s = √(ρ² tan²θ − 1) and

        Λ(θ) = 2 ∫_{cot θ}^∞ ρ P22(ρ²) [s − arccos(1/(ρ tan θ))] dρ

    x = ρ² = cot²θ + (α² + cot²θ)(e^v − 1) with v ∝ r², where the integrand starts like r⁴.
    """
    c = np.minimum(np.asarray(cos_w, float), 1 - 1e-12)[..., None]
    tan2 = (1 - c**2) / c**2
    base = alpha**2 + 1 / tan2
    span = np.log1p(45 * alpha / base)
    more = base * np.expm1(span * _R**2)
    s = np.sqrt(more * tan2)
    dx = base * np.exp(span * _R**2) * span * 2 * _R * _DR
    Lambda = np.sum(slope_density(1 / tan2 + more, alpha, p) * (s - np.arctan(s)) * dx, axis=-1)
    return np.log(c[..., 0] * (1 + Lambda))


def density(theta, alpha, p):
    return slope_density(np.tan(theta) ** 2, alpha, p) / np.cos(theta) ** 4


def fresnel(theta_d, f0, f1):
    c = np.cos(theta_d)
    return f0 + (1 - f0) * (1 - c) ** 5 - f1 * c


def table(grid, parameters):
    """The reflectance (H, D, P, C) of C rows (ρ_d, ρ_s, α, p, F_0, F_1) on a half/difference grid."""
    cos_h, cos_d = np.cos(grid.theta_h)[:, None, None], np.cos(grid.theta_d)[None, :, None]
    across = np.sin(grid.theta_h)[:, None, None] * np.sin(grid.theta_d)[None, :, None] * np.cos(grid.phi_d)
    cosines = np.stack([cos_h * cos_d - across, cos_h * cos_d + across])
    above = np.all(cosines > 0, axis=0)
    nodes = np.concatenate([np.geomspace(1e-7, 1e-2, 600), np.linspace(1e-2, 1, 4000)[1:]])
    out = np.full((*grid.shape, len(parameters)), -1.0)
    for channel, (rho_d, rho_s, alpha, p, f0, f1) in enumerate(parameters):
        area = np.interp(cosines[:, above], nodes, np.exp(log_area(nodes, alpha, p)))
        D, F = density(grid.theta_h, alpha, p), fresnel(grid.theta_d, f0, f1)
        lobe = np.broadcast_to((D[:, None] * F)[..., None], grid.shape)[above]
        out[above, channel] = (rho_d + rho_s * lobe / (area[0] * area[1])) / np.pi
    return out


def l2_error(grid, model, measured):
    """E of every channel: √ Σ (m − ρ)² cos θ_i cos θ_o dω_i dω_o over the pairs that both tables hold."""
    h, d, phi = grid.theta_h[:, None, None], grid.theta_d[None, :, None], grid.phi_d[None, None, :]
    along, across = np.cos(h) * np.cos(d), np.sin(h) * np.sin(d) * np.cos(phi)
    edges = [-np.diff(np.cos(grid.theta_h_edges)), np.diff(np.sin(grid.theta_d_edges) ** 2)]
    measure = edges[0][:, None, None] * edges[1][None, :, None] * np.diff(grid.phi_d_edges)
    weight = (measure * (along**2 - across**2))[..., None]
    used = (model >= 0) & (measured >= 0)
    return np.sqrt(np.sum(np.where(used, weight * (model - measured) ** 2, 0), axis=(0, 1, 2)))


class FirstStep:
    """Step 1 for one channel: ½ Σ w (ρ_d/π + F_r L − m)², ρ_d and F_r ≥ 0, over θ_h < 80°.

    w ∝ cos²θ / (m + 0.001), Σ w m² = 100: what `fitting` says it minimises.
    """

    def __init__(self, theta, m):
        used = np.isfinite(m) & (theta < np.deg2rad(80))
        self.theta, self.m = theta[used], m[used]
        w = np.cos(self.theta) ** 2 / (self.m + 1e-3)
        self.root = np.sqrt(w * 100 / np.sum(w * self.m**2))

    def lobe(self, alpha, p):
        return density(self.theta, alpha, p) * np.exp(-2 * log_area(np.cos(self.theta), alpha, p)) / np.pi

    def residual(self, shape):
        columns = np.stack([np.full_like(self.m, 1 / np.pi), self.lobe(np.exp(shape[0]), shape[1])], axis=1)
        scale = np.linalg.norm(self.root[:, None] * columns, axis=0)
        A = self.root[:, None] * columns / scale
        return A @ nnls(A, self.root * self.m)[0] - self.root * self.m

    def cost(self, alpha, p):
        return np.sum(self.residual((np.log(alpha), p)) ** 2) / 2

    def least(self, starts):
        """The least cost found by trust-region least squares from each of the starts (log α, p)."""
        bounds = ([np.log(1e-5), 0], [np.log(2), 3])
        return min(least_squares(self.residual, start, bounds=bounds, max_nfev=60).cost for start in starts)
