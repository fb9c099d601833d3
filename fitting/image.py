"""A fit brought as close to the measurement as it can be in the picture of a lit sphere."""

import dataclasses
from collections.abc import Sequence
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np

from fitting.appearance import appearance
from fitting.losses import Loss
from fitting.minimize import minimize
from fitting.model_space import model_space
from fitting.reflectance import fit_reflectance
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.fit_result import FitResult, FitStatus
from jaxbrdf.resampling import Measurement

_LOSSES = ("l2", "log", "cube_root")


def fit_image(
    model: AbstractBRDF,
    measured: Measurement,
    losses: Sequence[str | Loss] = _LOSSES,
    *,
    fixed: Sequence[str] = (),
    max_steps: int = 300,
) -> FitResult:
    r"""Minimise the mean ΔE*_ab of a lit sphere over all unknowns of all channels at once.

    By L-BFGS-B within the parameters' ranges, from the best of the fits under several losses; see
    `fit_reflectance` for the arguments. `cost` is ΔE, the same for each channel. There is no covariance: a
    picture has no noise of which anything is known. Raises ValueError as `fit_reflectance`.
    """
    best = fit_reflectance(model, measured, losses, select="image", fixed=fixed)
    if not best.success.all():
        return best
    fit = cast(AbstractBRDF, best.model)
    space, shapes, _ = model_space(fit, fixed)
    leaves = jax.tree.leaves(fit)
    linear = [jnp.asarray(leaves[unknown.leaf]) for unknown in space.linear]
    x = jnp.stack(linear, axis=-1) if linear else jnp.zeros((len(shapes), 0))
    unit = jnp.where(x > 0, x, jnp.maximum(jnp.max(x, initial=0.0), 1e-6))
    k, seen = x.shape[1], appearance(measured)

    def fitted(z):
        z = z.reshape(len(unit), -1)
        values = jax.vmap(space.shape_values)(z[:, k:])
        return space.fitted(model, jnp.concatenate([z[:, :k] * unit, values], axis=1))

    start = jnp.concatenate([x / unit, jnp.clip(shapes, 0, 1)], axis=1)
    high = jnp.where(jnp.arange(start.shape[1]) < k, jnp.inf, 1.0)[None, :]
    found = minimize(
        lambda z: seen.difference(fitted(z).tabulated()),
        start.ravel(),
        jnp.zeros(start.size),
        jnp.broadcast_to(high, start.shape).ravel(),
        max_steps=max_steps,
    )
    return dataclasses.replace(
        best,
        model=fitted(found.z),
        cost=np.full(len(unit), float(found.value)),
        steps=best.steps + found.steps,
        status=np.full(len(unit), FitStatus.CONVERGED if found.converged else FitStatus.STEP_LIMIT),
        covariance=np.full_like(best.covariance, np.nan),
        residuals=np.full_like(best.residuals, np.nan),
        recipe="image",
    )
