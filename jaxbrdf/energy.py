r"""How much of the light that falls on it a reflectance reflects in all."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxbrdf.arrays import per_channel
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.directions import (
    Direction,
    as_directions,
    cos_theta,
    dot,
    half_vector,
    reflect,
    spherical,
    to_spherical,
)
from jaxbrdf.special import gauss_legendre, safe_divide

_SAMPLES = 6765  # of the model, where quadrature is too coarse; Fibonacci numbers, for `lattice`
_PROBES = 233  # of the model, to find the peaks that quadrature must not miss


def albedo(brdf: AbstractBRDF, wi: ArrayLike) -> Float[Array, "..."]:
    r"""Directional albedo ∫ f(wi, wo) cos θ_o dω_o over the upper hemisphere: (...), or (..., C).

    To 1e-4 for isotropic facets of any roughness from 1e-5 on, at 0 to 89 degrees, and mostly far better, by
    `albedo_by_quadrature`. Where that is too coarse, as for brushed metals, fibres and sharp lobes far off
    the mirror direction, directions that the model draws are taken besides, at some ten times the cost: to
    1e-3, as far as the model's `pdf` is the density of its `sample`. NaN, which a measurement has where it
    has no sample, counts as dark. Raises ValueError for directions that are not unit vectors (outside jit).
    """
    wi = as_directions(wi, "wi")
    brdf = brdf.anonymous
    by_quadrature, resolved = albedo_by_quadrature(brdf, wi)
    return by_quadrature if known(resolved) else _refined(brdf, wi, by_quadrature, resolved)


@eqx.filter_jit
def albedo_by_quadrature(brdf: AbstractBRDF, wi: Direction) -> tuple[Float[Array, "..."], Bool[Array, "..."]]:
    r"""The albedo by quadrature alone, which owes nothing to the model's `pdf`, and whether it is resolved.

    The integral runs over half vectors, where a lobe stays near the pole however sharp it is: nodes gather
    there. It is resolved where the even and the odd meridians agree to 4e-3, both together then being good to
    1e-4, and where the nodes see a peak as high as the directions do that the model draws.
    """
    return _for_each(_quadrature, brdf, wi)


def largest_albedo(brdf: AbstractBRDF, max_angle: float = np.deg2rad(80)) -> Float[Array, "..."]:
    """The largest directional albedo at incidence 0 to `max_angle` (radians), in 17 steps; () or (C,)."""
    return jnp.max(albedo(brdf, spherical(jnp.linspace(0, max_angle, 17), 0.0)), axis=0)


def known(truth: Bool[Array, "..."]) -> bool:
    """Whether all of an array is true, as far as its values are at hand: not inside jit."""
    return not isinstance(truth, jax.core.Tracer) and bool(jnp.all(truth))


def lattice(count: int) -> Float[np.ndarray, "count 2"]:
    """`count` points of [0, 1)², a Fibonacci number of them: evenly spread, and the same every time."""
    before, following = 1, 1
    while following < count:
        before, following = following, before + following
    if following != count:
        raise ValueError(f"a lattice has a Fibonacci number of points, such as {before} or {following}")
    k = np.arange(count)
    return np.stack([k + 0.5, k * before % count + 0.5], axis=-1) / count


def _for_each(function: Callable, brdf: AbstractBRDF, wi: Direction) -> Any:
    """What `function` makes of one channel and one direction, for all: leaves (...), or (..., C)."""
    flat = wi.reshape(-1, 3)
    count, at_once = len(flat), max(1, min(4, len(flat)))
    missing = jnp.broadcast_to(flat[-1:], (-count % at_once, 3))  # a remainder would be compiled once more

    def one_channel(brdf, w):
        return jax.lax.map(lambda one: function(brdf, one), w, batch_size=at_once)

    found = per_channel(one_channel)(brdf, jnp.concatenate([flat, missing]))
    return jax.tree.map(lambda leaf: leaf[:count].reshape(*wi.shape[:-1], *leaf.shape[1:]), found)


@eqx.filter_jit
def _refined(brdf: AbstractBRDF, wi: Direction, by_quadrature: Array, resolved: Array) -> Array:
    """The albedo by quadrature where it is resolved; samples help where it is not, and if any is not."""

    def with_samples():
        return jnp.where(resolved, by_quadrature, _for_each(_with_samples, brdf, wi))

    return jax.lax.cond(jnp.all(resolved), lambda: by_quadrature, with_samples)


def _quadrature(brdf: AbstractBRDF, wi: Direction) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    wo, d_omega_o = _nodes(wi)
    light, probes = jnp.split(_light(brdf, wi, jnp.concatenate([wo, _drawn(brdf, wi, _PROBES)])), [len(wo)])
    even, odd = (2 * jnp.sum((light * d_omega_o)[meridian::2]) for meridian in (0, 1))
    total = (even + odd) / 2
    agree = jnp.abs(even - odd) <= 4e-3 * jnp.abs(total)
    return total, agree & (jnp.max(probes) <= 4 * jnp.max(light))


def _with_samples(brdf: AbstractBRDF, wi: Direction) -> Float[Array, ""]:
    r"""∫ a f cos θ_o dω_o by quadrature plus ∫ (1 − a) f cos θ_o dω_o by samples, a = q / (q + 3 p).

    q and p being the densities of the nodes and of the samples, each does what it does better: the balance
    heuristic of Veach & Guibas 1995, with a preference for the samples.
    """
    nodes, d_omega_o = _nodes(wi)
    wo = jnp.concatenate([nodes, _drawn(brdf, wi, _SAMPLES)])
    spread = half_vector_spread(wi, wo)
    light = _light(brdf, wi, wo) / (1 + 3 * _density(brdf, wi, wo) * spread)
    n = len(nodes)
    return jnp.sum(light[:n] * d_omega_o) + jnp.mean(light[n:] * 3 * spread[n:])


def _light(brdf: AbstractBRDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """f(wi, wo) cos θ_o."""
    return jnp.nan_to_num(brdf(jnp.broadcast_to(wi, wo.shape), wo)) * cos_theta(wo)


def _nodes(wi: Direction) -> tuple[Float[Array, "n 3"], Float[Array, " n"]]:
    """Directions wo and their dω_o: θ_h = θ_max r³ by Gauss–Legendre, φ_h in equal steps; φ_h runs first.

    They begin a quarter of a step after φ_i, so that no symmetry makes even and odd ones alike.
    """
    wi, n_phi = jax.lax.stop_gradient(wi), 64
    r, weights = (a[:, None] for a in gauss_legendre(128, wi.dtype))
    phi = (jnp.arange(n_phi, dtype=wi.dtype) + 0.25)[None, :] * (2 * jnp.pi / n_phi)
    _, phi_i = to_spherical(wi)
    h = spherical(last_theta_h(wi, phi) * r**3, phi_i + phi)
    wo = reflect(jnp.broadcast_to(wi, h.shape), h)
    d_omega_o = half_vector_spread(wi, wo) * weights / n_phi
    return wo.reshape(-1, 3), d_omega_o.ravel()


def half_vector_spread(wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """1/q = dω_o / (dr dφ/2π), with dω_o = 4 (wi·h) sin θ_h dθ_h dφ_h and θ_h = θ_max r³."""
    wi = jax.lax.stop_gradient(jnp.broadcast_to(wi, wo.shape))
    h = half_vector(wi, wo)
    theta_h, phi_h = to_spherical(h)
    theta_max = last_theta_h(wi, phi_h - to_spherical(wi)[1])
    r2 = jnp.cbrt(safe_divide(theta_h, theta_max)) ** 2
    return 4 * dot(wi, h) * jnp.sin(theta_h) * 3 * theta_max * r2 * 2 * jnp.pi


def last_theta_h(wi: Direction, phi: Float[Array, "..."]) -> Float[Array, "..."]:
    """The θ_h at which wo meets the horizon: tan 2θ_h = cos θ_i / (−sin θ_i cos φ), φ = φ_h − φ_i."""
    theta_i, _ = to_spherical(wi)
    return jnp.arctan2(jnp.cos(theta_i), -jnp.sin(theta_i) * jnp.cos(phi)) / 2


def _drawn(brdf: AbstractBRDF, wi: Direction, count: int) -> Direction:
    """Directions that the model draws for wi, (count, 3); constants to a derivative, as the nodes are."""
    brdf, wi = jax.tree.map(jax.lax.stop_gradient, (brdf, wi))
    return brdf.sample(jnp.asarray(lattice(count), wi.dtype), wi)


def _density(brdf: AbstractBRDF, wi: Direction, wo: Direction) -> Float[Array, "..."]:
    """p, the density of `_drawn`."""
    brdf, wi = jax.tree.map(jax.lax.stop_gradient, (brdf, wi))
    return brdf.pdf(wo, wi)
