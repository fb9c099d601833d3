r"""Free-form factors: the distribution, Fresnel term and masking of a table, of no given form.

    f = ρ_d / π + D(θ_h) F(θ_d) G1(θ_i) G1(θ_o) / (4 cos θ_i cos θ_o)

Bagher, Snyder & Nowrouzezahrai 2016. What it cannot reach no microfacet model can: it is the bound that
parametric fits are held against. They solve for one factor after another; here all move at once (see
`factor_descent`), as the former creeps where the lobe is broad: from the same start, the relative log error
of pink-felt was .046 after one sweep of theirs and .028 after 160, and is .020 after 40 steps of these.

Many different factors have nearly the same product: with G1 times cos^k θ, D and F divided by cos^2k θ, it
hardly changes near the mirror peak. Of these the smoothest is taken: minimised is

    log E² + μ Σ (0.1 (Δ log D)² + (Δ log F)² + (Δ log G1)²),   Δ from node to node

That also gives the nodes that no sample determines: they lie between their neighbours, evenly in the
logarithm, and are constant beyond the last that is determined. Of two starts the lower end is taken. Six
materials were tried from six starts: the errors of one, gold-metallic-paint, differed by more than 1.5 %, by
up to 9 %, and the two found the lowest.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from fitting.factor_cells import Sums, make_cells, polar_nodes
from fitting.factor_descent import Problem, descend, make_penalty, nowhere
from fitting.factor_starts import starts
from fitting.losses import Loss, as_loss
from fitting.outcome import means_nothing, statuses, warn_of_float32
from jaxbrdf.brdf.free_form import FreeFormBRDF
from jaxbrdf.brdf.measured import MeasuredBRDF, Slices
from jaxbrdf.directions import Direction, from_half_difference
from jaxbrdf.fit_result import FitResult
from jaxbrdf.quadrature import HalfDifferenceGrid

_LIMIT = float(np.deg2rad(80))  # beyond, what is measured may be anything
_NOTHING = 1e-10  # a lobe with less than this share of Σ w f² is none


def fit_factors(
    measured: MeasuredBRDF | Sequence[MeasuredBRDF],
    loss: str | Loss = "l2",
    *,
    smoothness: float = 0.01,
    max_angle: float = _LIMIT,
) -> FitResult:
    r"""Free-form factors of one material or of many, each channel by itself: a FreeFormBRDF.

    Of a MeasuredBRDF with C channels the result has leaves (C,), its tables (nodes, C); of a list of B, whose
    members share a grid, (B, C) and (B, nodes, C). D and F have the grid's own θ_h and θ_d for nodes, G1 one
    every 2°. D is scaled to ∫ D cos θ dω = 1, G1 to 1 at the normal. `loss` is 'l2' for the normalized L2
    error, 'log' for the log error of `jaxbrdf.compare`, another of `fitting.LOSSES`, or a Loss without
    cutoff. Samples count that are valid and have θ_i, θ_o < `max_angle` (radians), as means over 15° of φ_d.
    `smoothness` is μ of the module: with a tenth of it errors are some % lower, and the factors of glossy
    materials absurd.

    Raises ValueError for an empty list, grids that differ, a robust loss. What cannot be fitted is a status:
    of a channel with fewer valid cells than nodes all is NaN, one without a lobe has F = 0.
    """
    alone = isinstance(measured, MeasuredBRDF)
    materials = [measured] if isinstance(measured, MeasuredBRDF) else list(measured)
    loss_name, loss = loss, as_loss(loss)
    _check(materials, loss)
    warn_of_float32()
    sums = Sums(make_cells(materials[0].grid, max_angle), materials[0].grid)
    fits = [_fit_material(material, sums, loss, smoothness) for material in materials]
    result = fits[0] if alone else jax.tree.map(lambda *leaves: np.stack(leaves), *fits)
    recipe = loss_name if isinstance(loss_name, str) else "own loss"
    return dataclasses.replace(result, recipe=recipe, names=tuple(m.name for m in materials))


def _check(materials: Sequence[MeasuredBRDF], loss: Loss) -> None:
    if not materials:
        raise ValueError("no material to fit: expected at least one")
    if np.any(loss.cutoff != 0):
        raise ValueError("free factors are not fitted under a robust loss: give one without cutoff")
    if any(
        len(m.scale) != len(materials[0].scale) or not _same_grid(m.grid, materials[0].grid)
        for m in materials
    ):
        raise ValueError("the materials of one call must share their grid and channels; fit the others apart")


def _same_grid(a: HalfDifferenceGrid, b: HalfDifferenceGrid) -> bool:
    return a.shape == b.shape and all(map(np.array_equal, jax.tree.leaves(a), jax.tree.leaves(b)))


class _Channel(NamedTuple):
    """What came of one channel, or of several, along the last axis: its factors, and how it went."""

    rho_d: np.ndarray
    D: np.ndarray
    F: np.ndarray
    G1: np.ndarray
    cost: np.ndarray
    steps: np.ndarray
    enough: np.ndarray
    no_lobe: np.ndarray
    converged: np.ndarray


def _fit_material(measured: MeasuredBRDF, sums: Sums, loss: Loss, smoothness: float) -> FitResult:
    cells, grid, slices = sums.cells, measured.grid, measured.slices()
    values, measure = cells.mean(measured)
    share = np.asarray(loss.weight(jnp.asarray(cells.cos_i), jnp.asarray(cells.cos_o)))
    penalty = make_penalty(sums.sizes, smoothness)
    channels = []
    with np.errstate(all="ignore"):  # of steps too long, which are not taken, and of infinite data
        for c in range(values.shape[1]):
            problem = Problem(sums, loss, values[:, c], share * measure[:, c], penalty)
            channels.append(_fit_channel(problem, starts(slices, c), grid.theta_h))
    found = _Channel(*(np.stack(part, axis=-1) for part in zip(*channels, strict=True)))
    model, status = _model(found, grid), _status(found)
    covariance = np.full((len(status), 0, 0), np.nan)
    return FitResult(model, status, found.cost, found.steps, covariance, _residuals(model, slices), ())


def _fit_channel(problem: Problem, begin: Sequence[np.ndarray], theta_h: np.ndarray) -> _Channel:
    """Weights are scaled, so that no reflectance at all has E² = 1: it then costs 50."""
    r, _ = problem.residual(np.zeros_like(problem.values))
    total = np.sum(problem.weight * r**2)
    enough = np.count_nonzero(problem.weight) >= len(begin[0]) and total > 0
    problem = problem._replace(weight=problem.weight / (total if enough else 1))
    ends = [descend(problem, x) if enough else nowhere(x) for x in begin]
    found = min(ends, key=lambda descent: descent.objective[-1])
    factors = problem.factors(found.x)
    lobe = np.sum(problem.weight * problem.sums.lobe(*factors[1:])[0] ** 2)
    no_lobe = lobe <= _NOTHING * np.sum(problem.weight * problem.values**2)
    cost, steps = 50 * found.error, len(found.objective) - 1
    numbers = (*_scaled(theta_h, *factors), cost, steps, enough, no_lobe, found.converged)
    return _Channel(*map(np.asarray, numbers))


def _status(found: _Channel) -> np.ndarray:
    return statuses(
        enough=found.enough,
        finite=np.isfinite(found.cost),
        no_lobe=found.no_lobe,
        converged=found.converged,
        on_bound=np.zeros_like(found.enough),
    )


def _model(found: _Channel, grid: HalfDifferenceGrid) -> FreeFormBRDF:
    """NaN where nothing could be fitted, F = 0 where there is no lobe."""
    nothing = np.where(means_nothing(_status(found)), np.nan, 1.0)
    tables = found.rho_d, found.D, np.where(found.no_lobe, 0, found.F), found.G1
    rho_d, D, F, G1 = (jnp.asarray(nothing * table) for table in tables)
    theta_h, theta_d, theta = (jnp.asarray(a) for a in (grid.theta_h, grid.theta_d, polar_nodes()))
    return FreeFormBRDF(rho_d, theta_h, D, theta_d, F, theta, G1)


def _scaled(theta_h, rho_d, D, F, G1):
    """The same product of factors, with ∫ D cos θ dω = 1 and G1 = 1 at the normal; G1 = 0 put at the end."""
    facets = _projected_total(theta_h, D)
    return rho_d, D / facets, F * facets * G1[0] ** 2, np.append(G1 / G1[0], 0.0)


def _projected_total(theta_h: np.ndarray, D: np.ndarray) -> float:
    r"""∫ D cos θ dω = π ∫ D sin 2θ dθ of a D that is linear between nodes and constant beyond them."""
    theta = np.concatenate([[0], theta_h, [np.pi / 2]])
    D = np.concatenate([D[:1], D, D[-1:]])
    slope = np.diff(D) / np.diff(theta)
    return np.pi * ((D[0] + D[-1]) / 2 + np.sum(slope * np.diff(np.sin(2 * theta))) / 4)


def _residuals(model: FreeFormBRDF, slices: Slices) -> np.ndarray:
    """f − m over both slices, (C, H + E)."""
    back = from_half_difference(slices.theta_h, 0.0, 0.0, np.pi / 2)
    mirror = from_half_difference(slices.theta_h_mirror, 0.0, slices.theta_d, np.pi / 2)
    f = np.concatenate([np.asarray(_evaluate(model, wi, wo)) for wi, wo in (back, mirror)])
    return (f - np.concatenate([slices.m_h, slices.m_d])).T


@eqx.filter_jit
def _evaluate(model: FreeFormBRDF, wi: Direction, wo: Direction) -> Array:
    return model(wi, wo)
