r"""The distribution of facets read off the backscattering slice by power iteration; nothing is fitted.

Where light returns whence it came, wi = wo = w, the half vector is w itself: only facets that face w reflect,
and what the light reaches is seen, so that masking counts once, G = G1(w) = cos θ / σ(θ). Hence

    f(w, w) = ρ_d/π + F(0) D(w) G1(w) / (4 cos²θ) = ρ_d/π + F(0) D(θ) / (4 cos θ σ(θ))
    F(0)/4 · D(θ) = (f(θ) − ρ_d/π) cos θ σ(θ),    σ(θ) = ∫ (w·m)+ D(m) dm = ∫ K(θ, θ') D(θ') sin θ' dθ'

σ is linear in D: D is an eigenvector of an integral operator. Its kernel is positive, so that only one
eigenvector is positive too, that of the largest eigenvalue (Perron; Jentzsch), to which the power iteration
D ← (f − ρ_d/π) cos θ σ leads from any start. The eigenvalue is F(0)/4: no scale is left open. Dupuy et al.
2015, "Extracting microfacet-based BRDF parameters from arbitrary materials with power iterations".
"""

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from jaxbrdf.brdf.measured import Slices

_LIMIT = np.deg2rad(80)  # backscattering beyond this is not trusted
_ITERATIONS = 200
_TOLERANCE = 1e-12


class BackscatteringNDF(eqx.Module):
    """A distribution of C channels at the nodes `theta_h` (H,), radians; NaN in a channel that shows none.

    `D` (H, C) in 1/sr with ∫ D cos θ dω = 1, `sigma` (H, C) the projected area, `f0` (C,) the Fresnel term at
    normal incidence and `rho_d` (C,) the diffuse albedo that was taken off.
    """

    theta_h: Float[np.ndarray, " H"]
    D: Float[np.ndarray, "H C"]
    sigma: Float[np.ndarray, "H C"]
    f0: Float[np.ndarray, " C"]
    rho_d: Float[np.ndarray, " C"]

    @property
    def G1(self) -> Float[np.ndarray, "H C"]:
        """Smith's masking, min(1, cos θ / σ)."""
        return np.minimum(1, np.cos(self.theta_h)[:, None] / self.sigma)


def backscattering_ndf(slices: Slices, rho_d: ArrayLike | None = None) -> BackscatteringNDF:
    r"""D(θ_h), σ and F(0) of a material from its backscattering slice, for each channel.

    `rho_d` () or (C,) is the diffuse albedo to take off, best that of a fit. Unless given it is π min m_h,
    the most that may be: then D is 0 somewhere, and a lobe with a tail comes out narrower (of GGX over ρ_d =
    0.05 with F(0) = 0.7, α = 0.1 is read as 0.098, 0.3 as 0.26). A diffuse part left in is taken for facets.

    Samples beyond 80° are not used. D at unknown nodes is interpolated, and constant beyond the last known.
    """
    used = np.isfinite(slices.m_h) & (slices.theta_h < _LIMIT)[:, None]
    m_h = np.where(used, slices.m_h, np.nan)
    if rho_d is None:
        rho_d = np.pi * np.min(m_h, axis=0, initial=np.inf, where=used)
    rho_d = np.broadcast_to(np.asarray(rho_d, float), m_h.shape[1:])
    kernel = _kernel(slices.theta_h)
    lobes = np.maximum(m_h - rho_d / np.pi, 0).T
    read = [_read(slices.theta_h, kernel, lobe) for lobe in lobes]
    D, sigma, f0 = (np.stack(part, axis=-1) for part in zip(*read, strict=True))
    return BackscatteringNDF(slices.theta_h, D, sigma, f0, rho_d)


def _read(theta, kernel, lobe) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(D, σ, F(0)) of one channel from f − ρ_d/π, NaN where unknown."""
    known = np.isfinite(lobe)
    if not np.any(lobe[known] > 0):
        return np.full_like(theta, np.nan), np.full_like(theta, np.nan), np.array(np.nan)
    filled = np.stack([np.interp(theta, theta[known], e) for e in np.eye(known.sum())], axis=-1)
    area = kernel @ filled
    D, F0 = _power_iteration((lobe * np.cos(theta))[known][:, None] * area[1:][known])
    total = area[0] @ D
    return filled @ D / total, area[1:] @ D / total, np.asarray(4 * F0)


def _power_iteration(operator: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The positive eigenvector of a positive matrix, of sum 1, and its eigenvalue."""
    x = np.full(len(operator), 1 / len(operator))
    for _ in range(_ITERATIONS):
        before, x = x, operator @ x
        eigenvalue = x.sum()
        x = x / eigenvalue
        if np.allclose(x, before, rtol=_TOLERANCE, atol=0):
            break
    return x, np.asarray(eigenvalue)


def _kernel(theta: np.ndarray) -> np.ndarray:
    r"""K(θ, θ') sin θ' dθ' at 0 and the nodes θ (H + 1) and the nodes θ' (H,).

        K = ∫_0^{2π} (a + b cos φ)+ dφ = 2 (a φ_0 + b sin φ_0),   a = cos θ cos θ', b = sin θ sin θ'

    with φ_0 = arccos(−a/b), or π where a ≥ b. Nodes stand for the spans between the middles of their √θ, in
    which MERL's are evenly spaced: there this is the midpoint rule.
    """
    at = np.append(0.0, theta)
    a, b = np.outer(np.cos(at), np.cos(theta)), np.outer(np.sin(at), np.sin(theta))
    phi = np.arccos(-np.minimum(a / np.where(b > 0, b, 1e-300), 1))
    root = np.sqrt(theta)
    edges = np.concatenate([[0], (root[1:] + root[:-1]) / 2, [np.sqrt(np.pi / 2)]])
    return 2 * (a * phi + b * np.sin(phi)) * (np.sin(theta) * 2 * root * np.diff(edges))
