r"""Errors between a model and a measurement, and how much a reflectance reflects in all."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.arrays import per_channel
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.brdf.measured import MeasuredBRDF
from jaxbrdf.directions import Direction, cos_theta, dot, from_half_difference, reflect, spherical, to_spherical
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
    n_phi = 64
    r, weights = gauss_legendre(128)
    phi = (jnp.arange(n_phi) + 0.5) * (2 * jnp.pi / n_phi)
    theta_i, phi_i = to_spherical(wi)
    cos_i, sin_i = jnp.cos(theta_i)[..., None, None], jnp.sin(theta_i)[..., None, None]
    theta_max = jnp.arctan2(cos_i, -sin_i * jnp.cos(phi)) / 2
    theta_h = theta_max * (r**3)[:, None]
    h = spherical(theta_h, phi_i[..., None, None] + phi)
    wi = jnp.broadcast_to(wi[..., None, None, :], h.shape)
    wo = reflect(wi, h)
    d_theta_h = theta_max * (3 * r**2 * weights)[:, None]
    d_omega_o = 4 * dot(wi, h) * jnp.sin(theta_h) * d_theta_h * (2 * jnp.pi / n_phi)
    return jnp.sum(jnp.nan_to_num(brdf(wi, wo)) * cos_theta(wo) * d_omega_o, axis=(-2, -1))


@eqx.filter_jit
def largest_albedo(brdf: AbstractBRDF, max_angle: float = np.deg2rad(80)) -> Float[Array, "..."]:
    """The largest directional albedo over incidence from 0 to `max_angle` (radians), in 17 steps; () or (C,)."""
    angles = jnp.linspace(0, max_angle, 17)
    return jnp.max(jax.lax.map(lambda theta: albedo(brdf, spherical(theta, 0.0)), angles), axis=0)


@eqx.filter_jit
def tabulate(brdf: AbstractBRDF, grid: HalfDifferenceGrid) -> Float[Array, "..."]:
    """f at the centres of a half/difference grid, (H, D, P) or (H, D, P, C), one θ_h at a time."""

    def row(theta_h):
        wi, wo = from_half_difference(theta_h, 0.0, grid.theta_d[:, None], grid.phi_d[None, :])
        return brdf(wi, wo)

    return jax.lax.map(row, jnp.asarray(grid.theta_h))


def normalized_l2(model: AbstractBRDF, measured: MeasuredBRDF, max_angle: float = np.pi / 2) -> Float[Array, "..."]:
    r"""E / a for each channel, (C,): the error of Bagher et al. 2012, section 6.3, after Ngan et al. 2005.

        E² = ∫∫ (m − ρ)² cos θ_i cos θ_o dω_i dω_o,   dω_i dω_o = 4 cos θ_d dω_h dω_d

    over the valid pairs with θ_i, θ_o < max_angle (radians); a is the largest directional albedo of m.
    """
    return compare(model, measured, max_angle)["normalized_l2"]


def compare(
    model: AbstractBRDF, measured: MeasuredBRDF, max_angle: float = np.deg2rad(80)
) -> dict[str, Float[Array, "..."]]:
    r"""All errors at once, each (C,): m measured, ρ modelled, over valid pairs with θ_i, θ_o < max_angle.

        normalized_l2    √(∫∫ (m − ρ)² cos θ_i cos θ_o dω_i dω_o) / a, a the largest directional albedo of m
        log_error        rms of log(1 + m cos θ_i) − log(1 + ρ cos θ_i)
        cube_root_error  rms of m^⅓ − ρ^⅓, weighted by cos θ_i cos θ_o

    L2 is ruled by the mirror peak, which is why the others stand next to it; in those a negative ρ counts as 0.
    """
    table = tabulate(model, measured.grid)
    if table.ndim == 3:
        table = table[..., None]
    E2, log2, cube2 = _mean_errors(table, jnp.asarray(measured.values), measured.grid, max_angle)
    return {
        "normalized_l2": jnp.sqrt(E2) / largest_albedo(measured),
        "log_error": jnp.sqrt(log2),
        "cube_root_error": jnp.sqrt(cube2),
    }


@jax.jit
def _mean_errors(rho, m, grid, max_angle):
    cos_i, cos_o = (c[..., None] for c in grid.cosines())
    limit = jnp.cos(max_angle)
    used = (cos_i > limit) & (cos_o > limit) & jnp.isfinite(m)
    m, rho, measure = jnp.where(used, m, 0), jnp.where(used, rho, 0), jnp.where(used, grid.measure()[..., None], 0)
    cosines = measure * cos_i * cos_o
    log = jnp.log1p(m * cos_i) - jnp.log1p(jnp.maximum(rho, 0) * cos_i)
    cube = jnp.cbrt(m) - jnp.cbrt(jnp.maximum(rho, 0))

    def total(x):
        return jnp.sum(x, axis=(0, 1, 2))

    return (
        total(cosines * (m - rho) ** 2),
        total(measure * log**2) / total(measure),
        total(cosines * cube**2) / total(cosines),
    )
