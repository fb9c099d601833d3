r"""Bagher's closed approximation of Smith's masking, fitted to a distribution's exact one.

        G1(θ) ≈ 1 + λ (1 − exp(c (θ − θ_0)^k))   for θ > θ_0, else 1;   G1(π/2) = 0

Bagher et al. 2012, eq. 9. λ, c and k themselves are unfit to be searched: c alone spans 10^±300, and along
curved valleys all three change while G1 hardly does. The search moves these instead:

    δ = exp(t_0) δ_½          the elevation π/2 − θ at which half is masked; δ_½ is that of the exact G1
    L = log(1 + 1/λ) = exp(t_1)
    w = π/2 − θ_0 = δ exp(t_2)

of which the first is known from the start and the other two are mere shape, free of units.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fitting.least_squares import map_lanes, solve_lanes
from jaxbrdf.arrays import parameter_ranks
from jaxbrdf.directions import Direction, spherical
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.shadowing import ShiftedGammaShadowing, smith_G1
from jaxbrdf.special import gauss_legendre

_NODES = 200
_BLOCK = 16  # lanes; one compilation for any number of materials
_UNIT = 1e-3  # residuals are counted in thousandths of what is masked: an optimum has a cost of about one
_STARTS = ((0.01, 40.0), (3.0, 40.0), (0.3, 3.0), (3.0, 600.0), (0.03, None))  # (λ, w/δ_½); None: w = 1
_L_RANGE = (1e-9, 80.0)  # λ in [2e-35, 1e9]; the fits to shifted gamma distributions have 1e-4 to 10
_SMALLEST_REACH = 1.01  # of w / δ


def fit_masking(ndf: AbstractNDF) -> ShiftedGammaShadowing:
    r"""The λ, c, k with which the closed form is nearest to the exact masking of an isotropic distribution.

        minimise ∫_0^{π/2} (G1(θ; λ, c, k) − cos θ / σ(θ))² dθ          (θ in radians)

    by Levenberg–Marquardt from several starts, all at once, on 200 Gauss–Legendre nodes that crowd at
    grazing angles. The parameters of `ndf` are scalars, (C,) or (B, C), or broadcast to one such shape;
    each of the three results has that shape. NaN where the parameters of `ndf` are NaN.

    The three are bounded only by what a floating-point number holds: c stays within 1e±299 (1e±37 where
    JAX runs in single precision, which is less than mirrors need). θ_0 may be negative, as in the published
    tables; G1(0) then differs from 1, by less than the fit's error. Measured over all published materials
    in benchmarks/masking_approximation.py: never worse than the published values. Bagher et al. 2012,
    section 4.3 and eq. 9. Raises ValueError for a distribution that is not isotropic.
    """
    if not ndf.is_isotropic or any(parameter_ranks(ndf)):
        raise ValueError(
            f"fit_masking takes an isotropic distribution given by plain numbers, not this "
            f"{type(ndf).__name__}: give the one that a table was made from, or keep Smith's exact masking, "
            "jaxbrdf.Uncorrelated()"
        )
    leaves = np.broadcast_arrays(*jax.tree.leaves(ndf))
    lanes = jax.tree.unflatten(jax.tree.structure(ndf), [leaf.reshape(-1) for leaf in leaves])
    found = _fit_lanes(map_lanes(_exact_G1, lanes, spherical(_nodes()[0], 0.0), _BLOCK))
    return ShiftedGammaShadowing(*[jnp.asarray(value.reshape(leaves[0].shape)) for value in found])


def _fit_lanes(G1: Float[np.ndarray, "L K"]) -> tuple[np.ndarray, ...]:
    """(λ, c, k), each (L,), of L exact maskings: the best of all starts."""
    theta, weight = _nodes()
    delta_half = np.array([np.interp(0.5, g, np.pi / 2 - theta) for g in G1])
    masked = np.sqrt(np.sum(weight * (1 - G1) ** 2, axis=1))
    lanes = (G1, delta_half, _UNIT * masked)
    many = [np.repeat(a, len(_STARTS), axis=0) for a in lanes]
    fits = solve_lanes(_residual, _starts(delta_half), tuple(many), (np.cos(theta), np.sqrt(weight)))
    cost = np.where(np.isfinite(fits.cost), fits.cost, np.inf).reshape(len(G1), -1)
    best = np.argmin(cost, axis=1)
    t = fits.t.reshape(len(G1), len(_STARTS), -1)[np.arange(len(G1)), best]
    t = np.where(np.isfinite(np.min(cost, axis=1))[:, None], t, np.nan)
    form, _ = map_lanes(_closed_form, (t, delta_half), block=_BLOCK)
    return form.lam, form.c, form.k


def _nodes() -> tuple[np.ndarray, np.ndarray]:
    """Angles θ (K,) with π/2 − θ = (π/2) r³, r Gauss–Legendre nodes in (0, 1), and weights of ∫ dθ."""
    r, weight = gauss_legendre(_NODES)
    return np.pi / 2 * (1 - r**3), np.pi / 2 * 3 * r**2 * weight


def _exact_G1(ndf: AbstractNDF, w: Direction) -> Float[Array, " K"]:
    return smith_G1(ndf, w)


def _starts(delta_half: Float[np.ndarray, " L"]) -> Float[np.ndarray, "M 3"]:
    """All starts of the first lane, all of the second, …"""
    t = np.zeros((len(delta_half), len(_STARTS), 3))
    for s, (lam, reach) in enumerate(_STARTS):
        t[:, s, 1] = np.log(np.log1p(1 / lam))
        t[:, s, 2] = np.log(np.maximum(reach or 1 / delta_half, 3))
    return t.reshape(-1, 3)


def _residual(t, data):
    """√weight (G1 − exact) in units of the lane's scale; and how far log c is beyond its range."""
    (exact, delta_half, scale), (cos_w, root_weight) = data
    form, excess = _closed_form((t, delta_half))
    return jnp.append(root_weight * (form.G1(cos_w) - exact) / scale, excess)


def _closed_form(lane, _=None):
    r"""The masking of the numbers t, and by how much log c had to be cut to be held by a float.

    G1 = 1/2 at w − δ beyond θ_0 gives k, G1(π/2) = 0 gives c:
    (1 − δ/w)^k = log(1 + 1/(2λ)) / L,   c w^k = L.
    """
    t, delta_half = lane
    L = jnp.clip(jnp.exp(t[1]), *_L_RANGE)
    reach = jnp.maximum(jnp.exp(t[2]), _SMALLEST_REACH)
    lam = 1 / jnp.expm1(L)
    k = jnp.log(jnp.log1p(0.5 / lam) / L) / jnp.log1p(-1 / reach)
    log_c = jnp.log(L) - k * (jnp.log(delta_half * reach) + t[0])
    limit = 0.97 * np.log(jnp.finfo(log_c.dtype).max)
    c = jnp.exp(jnp.clip(log_c, -limit, limit))
    return ShiftedGammaShadowing(lam, c, k), jnp.maximum(jnp.abs(log_c) - limit, 0)
