"""Errors between a model and a measurement."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.brdf.measured import MeasuredBRDF
from jaxbrdf.directions import from_half_difference
from jaxbrdf.energy import albedo, largest_albedo
from jaxbrdf.quadrature import HalfDifferenceGrid

__all__ = ["Comparison", "albedo", "compare", "largest_albedo", "normalized_l2", "tabulate"]

_LIMIT = float(np.deg2rad(80))  # beyond, what is measured may be anything


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
    model: AbstractBRDF, measured: MeasuredBRDF, max_angle: float | Sequence[float] = _LIMIT
) -> dict[str, Float[Array, "..."]]:
    r"""All errors at once, each (C,): m measured, ρ modelled, over valid pairs with θ_i, θ_o < max_angle.

        normalized_l2    √(∫∫ (m − ρ)² cos θ_i cos θ_o dω_i dω_o) / a, a the largest directional albedo of m
        log_error        rms of log(1 + m cos θ_i) − log(1 + ρ cos θ_i)
        cube_root_error  rms of m^⅓ − ρ^⅓, weighted by cos θ_i cos θ_o

    L2 is ruled by the mirror peak, which is why the others stand next to it; in those a negative ρ counts
    as 0. A channel without any valid pair has NaN. Of several angles, each error is (angles, C). To compare
    many models with one measurement, make one `Comparison`.
    """
    return Comparison.of(measured).errors(model, max_angle)


class Comparison(eqx.Module):
    """What the errors of `compare` need of a measurement: its values (NaN where invalid), and a, (C,)."""

    values: Float[Array, "H D P C"]
    largest_albedo: Float[Array, " C"]
    grid: HalfDifferenceGrid

    @classmethod
    def of(cls, measured: MeasuredBRDF) -> "Comparison":
        return cls(jnp.asarray(measured.values), largest_albedo(measured), measured.grid)

    def errors(
        self, model: AbstractBRDF, max_angle: float | Sequence[float] = _LIMIT
    ) -> dict[str, Float[Array, "..."]]:
        """See `compare`."""
        table = tabulate(model, self.grid)
        table = table[..., None] if table.ndim == 3 else table
        limits = max_angle if isinstance(max_angle, Sequence) else (max_angle,)
        errors = [_errors(table, self.values, self.grid, self.largest_albedo, limit) for limit in limits]
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
    cube = _cube_root(m) - _cube_root(jnp.maximum(rho, 0))

    def total(x):
        return jnp.sum(x, axis=(0, 1, 2))

    return {
        "normalized_l2": jnp.sqrt(total(cosines * (m - rho) ** 2)) / largest,
        "log_error": jnp.sqrt(total(measure * log**2) / total(measure)),
        "cube_root_error": jnp.sqrt(total(cosines * cube**2) / total(cosines)),
    }


def _cube_root(x):
    """x^⅓ for x ≥ 0: what XLA makes of `cbrt` takes four times as long on the CPU."""
    return jnp.exp(jnp.log(x) / 3)
