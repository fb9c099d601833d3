r"""Errors between a model and a measurement, and how much a reflectance reflects in all."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.arrays import in_chunks, per_channel
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.brdf.measured import MeasuredBRDF
from jaxbrdf.directions import (
    Direction,
    cos_theta,
    dot,
    from_half_difference,
    reflect,
    spherical,
    to_spherical,
)
from jaxbrdf.quadrature import HalfDifferenceGrid
from jaxbrdf.special import gauss_legendre


@eqx.filter_jit
@per_channel
def albedo(brdf: AbstractBRDF, wi: Direction) -> Float[Array, "..."]:
    r"""Directional albedo ∫ f(wi, wo) cos θ_o dω_o over the upper hemisphere: (...), or (..., C).

    The integral runs over half vectors, dω_o = 4 (wi·h) dω_h, where a lobe stays near the pole however
    sharp it is: nodes gather there like r³. For each φ_h, θ_h ends where wo meets the horizon,
    2 θ_h = arctan2(cos θ_i, −sin θ_i cos(φ_h − φ_i)). Cells that a measurement lacks (NaN) count as dark.
    """

    def one(x, y, z):
        return _albedo(brdf, jnp.stack([x, y, z]))

    return in_chunks(one, wi[..., 0], wi[..., 1], wi[..., 2], size=4)


def _albedo(brdf: AbstractBRDF, wi: Direction) -> Float[Array, ""]:
    """`albedo` of one direction (3,) and one channel; nodes in θ_h run down, nodes in φ_h − φ_i across."""
    n_phi = 64
    r, weights = (a[:, None] for a in gauss_legendre(128, wi.dtype))
    phi = (jnp.arange(n_phi, dtype=wi.dtype) + 0.5)[None, :] * (2 * jnp.pi / n_phi)
    theta_i, phi_i = to_spherical(wi)
    theta_max = jnp.arctan2(jnp.cos(theta_i), -jnp.sin(theta_i) * jnp.cos(phi)) / 2
    theta_h = theta_max * r**3
    h = spherical(theta_h, phi_i + phi)
    wi = jnp.broadcast_to(wi, h.shape)
    wo = reflect(wi, h)
    d_theta_h = theta_max * 3 * r**2 * weights
    d_omega_o = 4 * dot(wi, h) * jnp.sin(theta_h) * d_theta_h * (2 * jnp.pi / n_phi)
    return jnp.sum(jnp.nan_to_num(brdf(wi, wo)) * cos_theta(wo) * d_omega_o)


@eqx.filter_jit
def largest_albedo(brdf: AbstractBRDF, max_angle: float = np.deg2rad(80)) -> Float[Array, "..."]:
    """The largest directional albedo at incidence 0 to `max_angle` (radians), in 17 steps; () or (C,)."""
    angles = jnp.linspace(0, max_angle, 17)
    return jnp.max(jax.lax.map(lambda theta: albedo(brdf, spherical(theta, 0.0)), angles), axis=0)


@eqx.filter_jit
def tabulate(brdf: AbstractBRDF, grid: HalfDifferenceGrid) -> Float[Array, "..."]:
    """f at the centres of a half/difference grid, (H, D, P) or (H, D, P, C), one θ_h at a time."""

    def row(theta_h):
        wi, wo = from_half_difference(theta_h, 0.0, grid.theta_d[:, None], grid.phi_d[None, :])
        return brdf(wi, wo)

    return jax.lax.map(row, jnp.asarray(grid.theta_h))


def normalized_l2(
    model: AbstractBRDF, measured: MeasuredBRDF, max_angle: float = np.pi / 2
) -> Float[Array, "..."]:
    r"""E / a for each channel, (C,): the error of Bagher et al. 2012, section 6.3, after Ngan et al. 2005.

        E² = ∫∫ (m − ρ)² cos θ_i cos θ_o dω_i dω_o,   dω_i dω_o = 4 cos θ_d dω_h dω_d

    over the valid pairs with θ_i, θ_o < max_angle (radians); a is the largest directional albedo of m.
    """
    return compare(model, measured, max_angle)["normalized_l2"]


def compare(
    model: AbstractBRDF, measured: MeasuredBRDF, max_angle: float | Sequence[float] = np.deg2rad(80)
) -> dict[str, Float[Array, "..."]]:
    r"""All errors at once, each (C,): m measured, ρ modelled, over valid pairs with θ_i, θ_o < max_angle.

        normalized_l2    √(∫∫ (m − ρ)² cos θ_i cos θ_o dω_i dω_o) / a, a the largest directional albedo of m
        log_error        rms of log(1 + m cos θ_i) − log(1 + ρ cos θ_i)
        cube_root_error  rms of m^⅓ − ρ^⅓, weighted by cos θ_i cos θ_o

    L2 is ruled by the mirror peak, which is why the others stand next to it; in those a negative ρ counts
    as 0. A channel without any valid pair has NaN. Of several angles, each error is (angles, C).
    """
    table = tabulate(model, measured.grid)
    table = table[..., None] if table.ndim == 3 else table
    values, largest = jnp.asarray(measured.values), largest_albedo(measured)
    limits = max_angle if isinstance(max_angle, Sequence) else (max_angle,)
    errors = [_errors(table, values, measured.grid, largest, limit) for limit in limits]
    if not isinstance(max_angle, Sequence):
        return errors[0]
    return {name: jnp.stack([e[name] for e in errors]) for name in errors[0]}


@jax.jit
def _errors(rho, m, grid, largest, max_angle):
    cos_i, cos_o = (c[..., None] for c in grid.cosines())
    limit = jnp.cos(max_angle)
    used = (cos_i > limit) & (cos_o > limit) & jnp.isfinite(m)
    m, rho, measure = (
        jnp.where(used, m, 0),
        jnp.where(used, rho, 0),
        jnp.where(used, grid.measure()[..., None], 0),
    )
    cosines = measure * cos_i * cos_o
    log = jnp.log1p(m * cos_i) - jnp.log1p(jnp.maximum(rho, 0) * cos_i)
    cube = jnp.cbrt(m) - jnp.cbrt(jnp.maximum(rho, 0))

    def total(x):
        return jnp.sum(x, axis=(0, 1, 2))

    return {
        "normalized_l2": jnp.sqrt(total(cosines * (m - rho) ** 2)) / largest,
        "log_error": jnp.sqrt(total(measure * log**2) / total(measure)),
        "cube_root_error": jnp.sqrt(total(cosines * cube**2) / total(cosines)),
    }
