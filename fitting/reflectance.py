r"""Fits of any sum of reflectances to any measurement, under any loss.

Lobes are found one after another. For each, a grid of its shapes is tried, all linear coefficients being
solved for (`starts`), and the best are refined by Levenberg–Marquardt, together with the lobes before it, the
linear coefficients still being solved for at every step. Under L2 that is all. A loss that compresses, or is
robust, is linearised at the measurement for this, and at last minimised itself in all unknowns at once.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from fitting.appearance import closest_picture
from fitting.covariance import sandwich
from fitting.lanes import LaneFit, Lanes, Shared, make_lanes
from fitting.least_squares import map_lanes
from fitting.lobes import LossLane, best_fits, weighted_residual
from fitting.losses import Loss, as_loss
from fitting.model_space import ModelSpace, model_space
from fitting.observations import observe
from fitting.outcome import Outcome, means_nothing, statuses, warn_of_float32
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.fit_result import FitResult
from jaxbrdf.resampling import Measurement, count_channels
from jaxbrdf.special import safe_divide

_LIMIT = float(np.deg2rad(80))  # beyond, what is measured may be anything
_EDGE = 1e-4  # shares of a range nearer than this to its end are on the bound
_NOTHING = 1e-10  # lobes with less than this share of Σ w f² are none


def fit_reflectance(
    model: AbstractBRDF,
    measured: Measurement | Sequence[Measurement],
    loss: str | Loss | Sequence[str | Loss] = "l2",
    *,
    select: str | None = None,
    starts: int = 3,
    fixed: Sequence[str] = (),
    max_angle: float = _LIMIT,
) -> FitResult:
    r"""Fit a model to one measurement or to many in one call, each channel by itself.

    `model` is any reflectance, with values in place of its unknowns: these are one start. Sought are the
    parameters that its classes declare linear, from 0 on, and those with a range, within it; `fixed` names
    those that keep their values, of which each channel may have its own. A sum may hold several lobes, which
    are found in their order, so that one more lobe does not raise the error.

    `measured` has C channels; of one the result has leaves (C,), of a list of B it has (B, C). Materials of a
    list share their directions. `loss` is 'l2', 'log', 'cube_root', 'log_ratio' or a `fitting.Loss`. Only
    valid samples with θ_i and θ_o below `max_angle` (radians) count; see `observe` for what is looked at.
    `starts` is how many local minima of the grid are tried for each lobe.

    With `select='image'` `loss` is a sequence of several, and of the fits that they give each material gets
    the one whose lit sphere is closest to its own in Lab (Bieron & Peers 2020; `jaxbrdf.lab_difference`).

    `residuals` are f − m at the directions looked at, `covariance` the sandwich estimate for the loss.
    Raises ValueError for an unknown loss, a name in `fixed` that fits none, a model without unknowns,
    measurements that do not belong together, and for pictures of other channels than one or R, G and B. What
    cannot be fitted is a status.
    """
    several = not isinstance(loss, str | Loss)
    losses: list[str | Loss] = [loss] if isinstance(loss, str | Loss) else list(loss)
    if select != ("image" if several else None):
        raise ValueError(
            f"expected one loss, or several with select='image'; found {loss!r} and select={select!r}"
        )
    results = fit_losses(model, measured, losses, starts=starts, fixed=fixed, max_angle=max_angle)
    return closest_picture(results, measured) if several else results[0]


def fit_losses(
    model: AbstractBRDF,
    measured: Measurement | Sequence[Measurement],
    losses: Sequence[str | Loss],
    *,
    starts: int = 3,
    fixed: Sequence[str] = (),
    max_angle: float = _LIMIT,
) -> list[FitResult]:
    """`fit_reflectance` under several losses, all in one batch: one result for each."""
    materials = [measured] if isinstance(measured, Measurement) else list(measured)
    if starts < 1:
        raise ValueError(f"starts must be at least 1; found {starts}")
    warn_of_float32()
    space, given, own = model_space(model, fixed)
    seen = observe(materials)
    _check_channels(model, materials[0])
    lanes = make_lanes(seen, [as_loss(loss) for loss in losses], max_angle, own)
    shared = Shared(space, jnp.asarray(seen.wi), jnp.asarray(seen.wo))
    fit = best_fits(lanes, shared, starts, _for_each_lane(given, lanes))
    outcome = _outcome(fit, lanes, shared)
    shape = len(losses), *seen.values.shape[:2]
    by_loss = [
        Outcome(*[part.reshape(*shape, *part.shape[1:])[i] for part in outcome]) for i in range(shape[0])
    ]
    results = [_record(model, space, found, isinstance(measured, Measurement)) for found in by_loss]
    names, recipes = tuple(m.name for m in materials), [_name(loss) for loss in losses]
    return [
        dataclasses.replace(r, recipe=text, names=names) for r, text in zip(results, recipes, strict=True)
    ]


def _name(loss: str | Loss) -> str:
    return loss if isinstance(loss, str) else "own loss"


def _check_channels(model: AbstractBRDF, measured: Measurement) -> None:
    found, expected = count_channels(model), count_channels(measured)
    if found not in (1, expected):
        raise ValueError(
            f"the model has {found} channels and the measurement {expected}: give it as many, or 1"
        )


def _for_each_lane(given: np.ndarray, lanes: Lanes) -> np.ndarray:
    """(C, n) to (L, n), channels running first."""
    return np.tile(given, (len(lanes.enough) // len(given), 1))


def _outcome(fit: LaneFit, lanes: Lanes, shared: Shared) -> Outcome:
    """What is to be known of each lane; numbers that mean nothing are NaN."""
    data = LossLane(lanes.values, lanes.weight, lanes.loss, fit.spread, np.ones_like(fit.x), lanes.own)
    numbers, cost, covariance, residuals, lobe_share = map_lanes(_describe, (fit.u, fit.x, data), shared)
    status = statuses(
        enough=lanes.enough,
        finite=np.isfinite(cost) & np.isfinite(numbers).all(axis=1),
        no_lobe=(lobe_share < _NOTHING) & bool(shared.space.lobes),
        converged=fit.converged,
        on_bound=np.any(_on_bound(fit.u), axis=1),
    )
    nothing = means_nothing(status)
    numbers = np.where(nothing[:, None], np.nan, numbers)
    return Outcome(numbers, status, cost, fit.steps, covariance, residuals)


def _describe(lane, shared: Shared):
    """All unknowns (n,), ½ Σ r², their covariance, f − m, and the share of Σ w f² that is the lobes'."""
    u, x, data = lane
    space = shared.space
    numbers = jnp.concatenate([x, space.shape_values(u)])
    by_u, by_x = jax.jacfwd(weighted_residual, (0, 1))(u, x, data, shared)
    by_shape = space.by_parameters(by_u, u, _on_bound(u))
    root = jnp.sqrt(data.weight)
    unweighted = safe_divide(jnp.concatenate([by_x, by_shape], axis=1), root[:, None])
    r = weighted_residual(u, x, data, shared)
    covariance = sandwich(unweighted, safe_divide(r, root), data.weight)
    f_0, features = shared.features(u, data.own)
    of_lobes = np.array([unknown.term in space.lobes for unknown in space.linear])
    f, lobes = f_0 + x @ features, f_0 + (x * of_lobes) @ features
    share = safe_divide(data.weight @ lobes**2, data.weight @ data.values**2)
    residuals = jnp.where(data.weight > 0, f - data.values, jnp.nan)
    return numbers, jnp.sum(r**2) / 2, covariance, residuals, share


def _on_bound(u):
    return (u < _EDGE) | (u > 1 - _EDGE)


def _record(model: AbstractBRDF, space: ModelSpace, found: Outcome, alone: bool) -> FitResult:
    """The result of B materials in C channels, or of one of them."""
    if alone:
        found = Outcome(*[part[0] for part in found])
    fitted = (space.fitted if alone else space.fitted_each)(model, jnp.asarray(found.numbers))
    return FitResult(fitted, *found[1:], parameters=space.names)
