r"""The public fits of measured tables: any number of materials, each channel apart, in one call.

    'slices'         the two steps of Bagher et al. 2012 on two slices of the table
    'slices+linear'  the lobe from the slices, then ρ_d, ρ_s, F_0, F_1 anew on a subsample of the table
    'full'           all parameters refined on that subsample

The information is in the table, not in the slices: hence the second is the default. Over the
subsample, the normalized L2 error never grows from one recipe to the next.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from fitting.cook_torrance import LobeSamples, linear_parameters
from fitting.covariance import sandwich
from fitting.least_squares import map_lanes
from fitting.outcome import means_nothing, statuses, warn_of_float32
from fitting.parameters import ShapeSpace
from fitting.two_slice import SliceLanes, TwoSliceFit, fit_slices, slice_lanes, slice_samples
from fitting.whole_table import refine, refit_linear, subsample, table_lanes
from jaxbrdf.brdf.cook_torrance import CookTorrance
from jaxbrdf.brdf.measured import MeasuredBRDF, Slices
from jaxbrdf.brdf.shifted_gamma import ShiftedGammaBRDF
from jaxbrdf.fit_result import FitResult
from jaxbrdf.fresnel import LinearSchlick
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.shifted_gamma import ShiftedGamma
from jaxbrdf.special import safe_divide

RECIPES = ("slices", "slices+linear", "full")

Measured = MeasuredBRDF | Slices


def fit_shifted_gamma(
    measured: Measured | Sequence[Measured],
    recipe: str = "slices+linear",
) -> FitResult:
    r"""Fit the shifted gamma reflectance of Bagher et al. 2012 to one material or to many in one call.

    Each channel is fitted by itself. `measured` is a MeasuredBRDF with C channels, or Slices for the recipe
    'slices'; of one material the result has leaves (C,), of a list of B it has leaves (B, C). All materials
    of a list share one grid. `recipe` is 'slices' (the paper's), 'slices+linear' or 'full': see the module.

    The model is a ShiftedGammaBRDF; F(θ_d) ≥ 0 and ρ_s, ρ_d ≥ 0 always hold. Raises ValueError for an unknown
    recipe, an empty list or grids that differ. What cannot be fitted (too few samples, no lobe) is a status.
    """
    result = fit_two_slice(ShiftedGamma, measured, recipe)
    m = cast(CookTorrance, result.model)
    ndf = cast(ShiftedGamma, m.ndf)
    fresnel = cast(LinearSchlick, m.fresnel)
    model = ShiftedGammaBRDF(m.rho_d, m.rho_s, ndf.alpha, ndf.p, fresnel.f0, fresnel.f1)
    plain = tuple(name.rpartition(".")[2] for name in result.parameters)
    return dataclasses.replace(result, model=model, parameters=plain)


def fit_two_slice(
    ndf: AbstractNDF | type[AbstractNDF],
    measured: Measured | Sequence[Measured],
    recipe: str = "slices+linear",
) -> FitResult:
    """The same procedure for any isotropic distribution: a CookTorrance with that NDF and LinearSchlick.

    `ndf` is the distribution's class, or one of its instances (whose parameter values are not used). Its
    parameters are sought in the ranges that the class declares. For the rest see `fit_shifted_gamma`.
    """
    if recipe not in RECIPES:
        raise ValueError(f"unknown recipe {recipe!r}: expected one of {', '.join(RECIPES)}")
    alone = not isinstance(measured, Sequence)
    materials = [measured] if isinstance(measured, Measured) else list(measured)
    warn_of_float32()
    space = _shape_space(ndf)
    slices = [m if isinstance(m, Slices) else m.slices() for m in materials]
    _check(materials, slices, recipe)
    lanes, samples = slice_lanes(slices), slice_samples(space, slices[0])
    first = fit_slices(lanes, samples)
    if recipe == "slices":
        fit = _from_slices(lanes, samples, first)
    else:
        fit = _from_table(space, cast(list[MeasuredBRDF], materials), first, recipe)
    result = _result(space, fit, _status(fit, lanes.enough), samples, lanes)
    names = tuple(getattr(m, "name", "") for m in materials)
    result = dataclasses.replace(result, recipe=recipe, names=names)
    return _shaped(result, len(materials), alone)


class _Lanes(NamedTuple):
    """A finished fit of L lanes: shape, linear unknowns, cost, steps, convergence, covariance."""

    t: np.ndarray
    x: np.ndarray
    cost: np.ndarray
    steps: np.ndarray
    converged: np.ndarray
    covariance: np.ndarray


def _shape_space(ndf: AbstractNDF | type[AbstractNDF]) -> ShapeSpace:
    if isinstance(ndf, type):
        return ShapeSpace(ndf)
    if not ndf.is_isotropic:
        raise ValueError(
            f"this {type(ndf).__name__} is anisotropic, and two slices hold no azimuth: give an isotropic "
            "distribution, such as its class"
        )
    return ShapeSpace(type(ndf))


def _check(materials: Sequence[Measured], slices: list[Slices], recipe: str) -> None:
    if not materials:
        raise ValueError("no material to fit: expected at least one")
    if recipe != "slices" and any(isinstance(m, Slices) for m in materials):
        raise ValueError(f"recipe {recipe!r} needs the whole table, Slices were given; use recipe='slices'")
    for s in slices:
        same = np.array_equal(s.theta_h, slices[0].theta_h) and np.array_equal(s.theta_d, slices[0].theta_d)
        if not same or s.m_h.shape != slices[0].m_h.shape:
            raise ValueError(
                "the materials of one call must share their grid and channels; fit the others apart"
            )


def _from_slices(lanes: SliceLanes, samples: tuple[LobeSamples, LobeSamples], first: TwoSliceFit) -> _Lanes:
    covariance = map_lanes(_slices_covariance, (first.t, first.x, lanes), samples)
    return _Lanes(first.t, first.x, first.cost, first.steps, first.converged, covariance)


def _from_table(space: ShapeSpace, materials: list[MeasuredBRDF], first: TwoSliceFit, recipe: str) -> _Lanes:
    chosen = subsample(space, materials[0].grid)
    lanes = table_lanes(chosen, materials)
    fit = refit_linear(chosen, lanes, first.t, first.x)
    if recipe == "full":
        fit = refine(chosen, lanes, fit)
    data = (lanes.values, fit.weight)
    cost, covariance = map_lanes(_table_covariance, (fit.t, fit.x, *data), chosen.samples)
    return _Lanes(fit.t, fit.x, cost, first.steps + fit.steps, first.converged & fit.converged, covariance)


def _slices_covariance(lane, samples):
    t, x, lanes = lane
    parts = [_jacobian_and_model(s, t, x) for s in samples]
    jacobian, model = (jnp.concatenate(p) for p in zip(*parts, strict=True))
    residual = model - jnp.concatenate([lanes.values_h, lanes.values_d])
    return sandwich(jacobian, residual, jnp.concatenate([lanes.weight_h, lanes.weight_d]))


def _table_covariance(lane, samples):
    t, x, values, weight = lane
    jacobian, model = _jacobian_and_model(samples, t, x)
    residual = model - values
    return jnp.sum(weight * residual**2) / 2, sandwich(jacobian, residual, weight)


def _jacobian_and_model(samples: LobeSamples, t, x):
    """The model's derivatives by ρ_d, ρ_s, the shape's parameters, F_0 and F_1, and the model, (N,)."""
    linear = linear_parameters(x)

    def model(linear, t):
        return samples.reflectance(linear, samples.lobe(t))

    by_linear, by_t = jax.jacfwd(model, (0, 1))(linear, t)
    by_shape = by_t * safe_divide(1.0, samples.space.slopes(t))[None, :]
    return jnp.concatenate([by_linear[:, :2], by_shape, by_linear[:, 2:]], axis=1), model(linear, t)


def _status(fit: _Lanes, enough: np.ndarray) -> np.ndarray:
    return statuses(
        enough=enough,
        finite=np.isfinite(fit.cost) & np.isfinite(fit.x).all(axis=1) & np.isfinite(fit.t).all(axis=1),
        no_lobe=np.all(fit.x[:, 1:] == 0, axis=1),
        converged=fit.converged,
        on_bound=np.any((fit.t <= 0) | (fit.t >= 1), axis=1),
    )


def _result(space, fit: _Lanes, status: np.ndarray, samples, lanes: SliceLanes) -> FitResult:
    """The record of L lanes; parameters that mean nothing are NaN."""
    linear, shape, residuals = map_lanes(_describe, (fit.t, fit.x, lanes), samples)
    nothing = means_nothing(status)[:, None]
    rho_d, rho_s, f0, f1 = np.where(nothing, np.nan, linear).T
    ndf = space.ndf_class(**dict(zip(space.names, np.where(nothing, np.nan, shape).T, strict=True)))
    return FitResult(
        model=CookTorrance(rho_d, rho_s, ndf, LinearSchlick(f0, f1)),
        status=status,
        cost=fit.cost,
        steps=fit.steps,
        covariance=fit.covariance,
        residuals=residuals,
        parameters=("rho_d", "rho_s", *(f"ndf.{name}" for name in space.names), "fresnel.f0", "fresnel.f1"),
    )


def _describe(lane, samples):
    """The parameters of a lane, and its residuals on both slices."""
    t, x, lanes = lane
    linear = linear_parameters(x)
    model = jnp.concatenate([s.reflectance(linear, s.lobe(t)) for s in samples])
    weight = jnp.concatenate([lanes.weight_h, lanes.weight_d])
    residuals = jnp.where(weight > 0, model - jnp.concatenate([lanes.values_h, lanes.values_d]), jnp.nan)
    return linear, samples[0].space.values(t), residuals


def _shaped(result: FitResult, count: int, alone: bool) -> FitResult:
    """Leaves (L, ...) to (materials, channels, ...), or to (channels, ...) of one material given alone."""

    def shape(leaf):
        batch = (-1,) if alone else (count, len(result.status) // count)
        return leaf.reshape(*batch, *leaf.shape[1:])

    return jax.tree.map(shape, result)
