r"""The two-slice fit of Bagher et al. 2012, section 5.2, for any isotropic distribution.

Step 1 fits ρ_d, F_r and the distribution's shape to the backscattering slice; only the shape is
non-linear, so Levenberg–Marquardt moves the shape alone and the two coefficients are solved inside
(variable projection). It starts from the local minima on a grid of shapes, whose lobes at the slice's
fixed angles are tabulated once. Step 2 solves the Fresnel term from the mirror slice, kept non-negative.
"""

from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from fitting.cook_torrance import CONSTANT_FRESNEL, LobeSamples, lobe_samples, solve_linear
from fitting.least_squares import map_lanes, solve_lanes
from fitting.losses import normalised
from fitting.parameters import ShapeSpace
from fitting.starts import grid_minima, lowest
from jaxbrdf.brdf.measured import Slices
from jaxbrdf.directions import from_half_difference, spherical

_LIMIT_H = np.deg2rad(80)  # backscattering beyond this is not trusted
_LIMIT_D = np.deg2rad(70)  # the paper discards the mirror slice beyond this
_FLOOR = 1e-3  # 1/sr; reflectances below this are not weighted up any further
_FEWEST = 8  # valid samples in the backscattering slice
_GRID = 1024  # shapes to start from


class SliceLanes(eqx.Module):
    """The slices of L channels, each a lane: values (0 where the weight is 0) and normalised weights."""

    values_h: Float[np.ndarray, "L H"]
    weight_h: Float[np.ndarray, "L H"]
    values_d: Float[np.ndarray, "L D"]
    weight_d: Float[np.ndarray, "L D"]
    enough: Bool[np.ndarray, " L"]


class TwoSliceFit(eqx.Module):
    """Of each lane: the shape t, the linear unknowns x, and how step 1 went."""

    t: Float[np.ndarray, "L n"]
    x: Float[np.ndarray, "L 4"]
    cost: Float[np.ndarray, " L"]
    steps: Int[np.ndarray, " L"]
    converged: Bool[np.ndarray, " L"]


def slice_lanes(slices: list[Slices]) -> SliceLanes:
    r"""Lanes, one for each channel of each material, from slices taken at the same angles.

    The weights were chosen by measuring: cos²θ / (m + floor) in step 1, halfway between absolute and
    relative errors, and cos²θ in step 2; each is scaled so that Σ w m² = 100, hence residuals of order one.
    """
    first = slices[0]
    m_h = np.concatenate([s.m_h.T for s in slices])
    m_d = np.concatenate([s.m_d.T for s in slices])
    used_h = np.isfinite(m_h) & (first.theta_h < _LIMIT_H)
    used_d = np.isfinite(m_d) & (first.theta_d < _LIMIT_D)
    values_h, values_d = np.where(used_h, m_h, 0), np.where(used_d, m_d, 0)
    return SliceLanes(
        values_h,
        normalised(used_h * np.cos(first.theta_h) ** 2 / (values_h + _FLOOR), values_h),
        values_d,
        normalised(used_d * np.cos(first.theta_d) ** 2, values_d),
        (used_h.sum(1) >= _FEWEST) & np.any(values_h > 0, axis=1),
    )


def slice_samples(space: ShapeSpace, slices: Slices) -> tuple[LobeSamples, LobeSamples]:
    """The pairs of directions of the two slices: wi = wo = h in the first; θ_i = θ_o in the second, whose
    half vector is tilted from the normal across the plane of incidence by the slice's own θ_h ≈ 0."""
    theta_h, theta_d = (np.asarray(theta, float).tobytes() for theta in (slices.theta_h, slices.theta_d))
    return _slice_samples(space, theta_h, theta_d, slices.theta_h_mirror)


@lru_cache(maxsize=8)
def _slice_samples(space: ShapeSpace, theta_h: bytes, theta_d: bytes, theta_h_mirror: float):
    back = spherical(np.frombuffer(theta_h), 0.0)
    mirror = from_half_difference(theta_h_mirror, 0.0, np.frombuffer(theta_d), np.pi / 2)
    return lobe_samples(space, back, back), lobe_samples(space, *mirror)


def fit_slices(lanes: SliceLanes, samples: tuple[LobeSamples, LobeSamples]) -> TwoSliceFit:
    """Both steps for every lane. A lane without a mirror slice gets F = 1, all of F_r being ρ_s."""
    back, _ = samples
    lane, start = starts(lanes, back)
    found = solve_lanes(_residual, start, (lanes.values_h[lane], lanes.weight_h[lane]), back, (0, 1))
    best = lowest(found.cost, lane, len(lanes.enough))
    t = found.t[best]
    x = map_lanes(_linear_steps, (t, lanes), samples)
    return TwoSliceFit(t, x, found.cost[best], found.steps[best], found.converged[best])


def exact_residual(t, args):
    """Step 1's √w (ρ_d/π + F_r L − m) at the best ρ_d, F_r ≥ 0, with σ integrated; args ((m, w), samples)."""
    (values, weight), back = args
    return _projected_residual(back.exact_lobe(t), values, weight)


def _residual(t, args):
    """The same with σ looked up."""
    (values, weight), back = args
    return _projected_residual(back.lobe(t), values, weight)


def _projected_residual(lobe, values, weight):
    pair = _diffuse_and_lobe(lobe)
    return jnp.sqrt(weight) * (solve_linear(pair, weight, values) @ pair - values)


def _linear_steps(lane, samples):
    """ρ_d by step 1 and the Fresnel term by step 2: x (4,)."""
    (t, lanes), (back, mirror) = lane, samples
    pair = _diffuse_and_lobe(back.lobe(t))
    rho_d, F_r = solve_linear(pair, lanes.weight_h, lanes.values_h)
    lobes = mirror.features(mirror.lobe(t))[1:]
    fresnel = solve_linear(lobes, lanes.weight_d, lanes.values_d - rho_d / jnp.pi)
    fresnel = jnp.where(jnp.sum(lanes.weight_d) > 0, fresnel, F_r * CONSTANT_FRESNEL)
    return jnp.concatenate([rho_d[None], fresnel])


def _diffuse_and_lobe(lobe):
    return jnp.stack([jnp.full_like(lobe, 1 / jnp.pi), lobe])


def starts(lanes: SliceLanes, back: LobeSamples) -> tuple[np.ndarray, np.ndarray]:
    """Where to start: local minima of the step-1 error on a grid of shapes, lanes (S,) and shapes (S, n)."""
    grid, lobes = _grid_lobes(back.space, np.asarray(back.h, float).tobytes())
    lane, point = grid_minima(_grid_errors(lanes, lobes), grid.shape[1])
    return lane, grid[point]


@lru_cache(maxsize=8)
def _grid_lobes(space: ShapeSpace, directions: bytes) -> tuple[np.ndarray, np.ndarray]:
    """A grid of shapes (G, n) and their lobes over the backscattering slice's directions, (G, H)."""
    back = jnp.asarray(np.frombuffer(directions).reshape(-1, 3))
    grid = space.grid(_GRID)
    return grid, np.asarray(jax.jit(jax.vmap(lobe_samples(space, back, back).lobe))(grid))


def _grid_errors(lanes: SliceLanes, lobes: np.ndarray) -> np.ndarray:
    """The step-1 error Σ w r² of each lane with each lobe, (L, G), by three matrix products."""
    w, wm = lanes.weight_h, lanes.weight_h * lanes.values_h
    S_1, S_m = w.sum(1, keepdims=True), wm.sum(1, keepdims=True)
    S_L, S_LL, S_Lm = w @ lobes.T, w @ (lobes**2).T, wm @ lobes.T
    # What each choice takes off Σ w m²: one term alone, or a lobe on a diffuse term where both are positive.
    with np.errstate(divide="ignore", invalid="ignore"):  # of lanes without samples
        alone = np.maximum(S_Lm**2 / S_LL, S_m**2 / S_1)
        together = S_m**2 / S_1 + (S_Lm - S_L * S_m / S_1) ** 2 / (S_LL - S_L**2 / S_1)
    positive = (S_Lm * S_1 > S_L * S_m) & (S_m * S_LL > S_L * S_Lm)
    gain = np.where(positive, together, alone)
    total = np.sum(wm * lanes.values_h, axis=1, keepdims=True)
    return np.nan_to_num(np.maximum(total - gain, 1e-12 * total))
