"""Whether a reflectance is reciprocal, conserves energy, and fits its own samples."""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.directions import Direction, cos_theta, from_half_difference, rotate_z, spherical
from jaxbrdf.energy import albedo, albedo_by_quadrature, known, lattice
from jaxbrdf.special import safe_divide

INCIDENCES = (0, 15, 30, 45, 60, 70, 80, 85, 89)  # degrees, where energy is looked at,
AZIMUTHS = (0, 45, 90, 135, 180, 225, 270, 315)  # and from where

_PAIRS = 2048  # of directions, of each kind
_DRAWN = 4181  # samples for each direction; a Fibonacci number
_NOTHING = 1e-12  # 1/sr: what is no more than this is not worth a comparison


def reciprocity_error(brdf: AbstractBRDF) -> Float[Array, "..."]:
    r"""How far f(wi, wo) is from f(wo, wi), () or (C,): 0 where f is reciprocal, 2 where one of them is 0.

        max 2 |f(wi, wo) − f(wo, wi)| / (|f(wi, wo)| + |f(wo, wi)|)

    over the pairs of `sample_pairs`; of what is below 1e-12/sr the less counts, the smaller it is. Rounding
    alone makes about 1e-12, in single precision 1e-3. Pairs that a measurement lacks (NaN) are left out.
    """
    wi, wo = sample_pairs()
    there, back = evaluate(brdf, wi, wo), evaluate(brdf, wo, wi)
    error = 2 * jnp.abs(there - back) / (jnp.abs(there) + jnp.abs(back) + _NOTHING)
    return jnp.nanmax(error, axis=0)


def energy_excess(brdf: AbstractBRDF) -> Float[Array, "..."]:
    """By how much the largest directional albedo exceeds 1, () or (C,): 0 where energy is conserved.

    Over incidence at 0 to 89 degrees from eight sides, and as exact as `albedo`.
    """
    return jnp.maximum(jnp.max(albedos(brdf), axis=(0, 1)) - 1, 0)


def albedos(brdf: AbstractBRDF) -> Float[Array, "..."]:
    """The `albedo` at all INCIDENCES from all AZIMUTHS: (9, 8), or (9, 8, C)."""
    theta, phi = (jnp.deg2rad(jnp.array(degrees, float)) for degrees in (INCIDENCES, AZIMUTHS))
    if known(is_isotropic(brdf)):
        return jnp.repeat(albedo(brdf, spherical(theta[:, None], phi[None, :1])), len(AZIMUTHS), axis=1)
    return albedo(brdf, spherical(theta[:, None], phi[None, :]))


def is_isotropic(brdf: AbstractBRDF) -> Bool[Array, ""]:
    """Whether f stays the same, up to rounding, where both directions turn about the normal.

    In single precision, where turning alone moves the peaks of sharp lobes, one pair in a hundred may differ.
    """
    wi, wo = sample_pairs()
    f = evaluate(brdf, wi, wo)
    tolerance, share = (1e-6, 1.0) if f.dtype == np.float64 else (1e-2, 0.99)

    def stays(angle):
        turned = evaluate(brdf, rotate_z(wi, angle), rotate_z(wo, angle))
        error = jnp.nan_to_num(jnp.abs(turned - f))
        return jnp.mean(error <= tolerance * jnp.nan_to_num(jnp.abs(f)) + _NOTHING) >= share

    return stays(jnp.array(0.7)) & stays(jnp.array(2.0))


@eqx.filter_jit
def evaluate(brdf: AbstractBRDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """f(wi, wo), compiled once for all pairs of one shape."""
    return brdf(wi, wo)


class Sampling(NamedTuple):
    r"""How the samples of a reflectance fit it, for light from all INCIDENCES: each (9,) or (9, C).

    `mean`      of f cos θ / pdf over 4181 directions drawn by the model, with its standard error, `noise`
    `albedo`    what it should be: the quadrature's, which owes nothing to the samples
    `resolved`  whether the quadrature is fine enough for it; if not, it says nothing
    `density`   ∫ pdf dω, which must not exceed 1; NaN where the quadrature is too coarse
    """

    mean: Float[Array, "..."]
    noise: Float[Array, "..."]
    albedo: Float[Array, "..."]
    resolved: Bool[Array, "..."]
    density: Float[Array, "..."]

    @property
    def consistent(self) -> Bool[np.ndarray, "..."]:
        """Whether the samples fit, as far as noise and quadrature can tell."""
        mean, noise, expected, resolved, density = (np.asarray(a) for a in self)
        off = np.abs(mean - expected) > 4 * noise + 2e-3 * np.abs(expected)
        return ~(resolved & off) & ~(density > 1 + 2e-3)


def sampling(brdf: AbstractBRDF) -> Sampling:
    """Compares a reflectance with its own `sample` and `pdf`."""
    w = spherical(jnp.deg2rad(jnp.array(INCIDENCES, float)), jnp.deg2rad(20.0))[:, None]
    expected, resolved = albedo_by_quadrature(brdf, w)
    density, fine = albedo_by_quadrature(_Density(brdf), w)
    mean, noise = _mean_over_samples(brdf, w[:, 0])
    return Sampling(mean, noise, expected[:, 0], resolved[:, 0], jnp.where(fine, density, jnp.nan)[:, 0])


@eqx.filter_jit
def _mean_over_samples(brdf: AbstractBRDF, wi: Direction) -> tuple[Array, Array]:
    """The mean of f cos θ_o / pdf over samples for each of wi (N, 3), and its standard error."""
    return jax.lax.map(lambda one: _mean_and_error(brdf, one), wi)


def _mean_and_error(brdf: AbstractBRDF, wi: Direction) -> tuple[Array, Array]:
    u = jnp.asarray(lattice(_DRAWN), wi.dtype)
    wo = brdf.sample(u, wi)
    pdf, f = brdf.pdf(wo, wi), jnp.nan_to_num(brdf(jnp.broadcast_to(wi, wo.shape), wo))
    weight = f * _like(safe_divide(cos_theta(wo), pdf), f)
    return jnp.mean(weight, axis=0), jnp.std(weight, axis=0) / math.sqrt(len(u))


def _like(a: Array, f: Array) -> Array:
    """(N,) to the rank of f, (N,) or (N, C)."""
    return a if f.ndim == 1 else a[:, None]


class _Density(AbstractBRDF):
    """The reflectance whose albedo is ∫ pdf dω."""

    brdf: AbstractBRDF

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        return safe_divide(self.brdf.pdf(wo, wi), cos_theta(wo))


def sample_pairs() -> tuple[Direction, Direction]:
    """Pairs (wi, wo), each (4096, 3), the same ones every time.

    Half of them are spread evenly in θ, to 89.9 degrees, and φ. The others lie about the mirror direction,
    θ_h from 1e-4 to 1 radian evenly in its logarithm and θ_d to 89.9 degrees; some of these are below the
    horizon, where f is 0.
    """
    u = jnp.asarray(_spread_evenly(_PAIRS))
    quarter, turn = u[:, :2] * (jnp.pi / 2), u[:, 2:] * (2 * jnp.pi)
    wi, wo = spherical(quarter[:, 0], turn[:, 0]), spherical(quarter[:, 1], turn[:, 1])
    theta_h = 10 ** (4 * u[:, 0] - 4)
    near_i, near_o = from_half_difference(theta_h, turn[:, 0], quarter[:, 1], turn[:, 1])
    return jnp.concatenate([wi, near_i]), jnp.concatenate([wo, near_o])


def _spread_evenly(count: int) -> Float[np.ndarray, "count 4"]:
    """Points of [0, 1)⁴: multiples, modulo 1, of the powers of 1/g, g⁵ = g + 1 (Roberts 2018)."""
    g = 1.1673039782614187
    return (0.5 + np.arange(1, count + 1)[:, None] * g ** -np.arange(1.0, 5.0)) % 1
