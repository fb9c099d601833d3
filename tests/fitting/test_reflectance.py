"""Any model to any measurement: recovery, losses, lobes, status, and errors that say the truth."""

import dataclasses
from functools import reduce
from operator import add

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from fitting import LOSSES, compressed, fit_losses, fit_reflectance, robust
from fitting.observations import choose_cells
from jaxbrdf import (
    ABC,
    AshikhminShirley,
    Beckmann,
    Conductor,
    CookTorrance,
    FitStatus,
    Lafortune,
    Lambertian,
    MeasuredBRDF,
    MeasuredSamples,
    Microfacet,
    Schlick,
    StudentT,
    TrowbridgeReitz,
    Ward,
    as_samples,
    merl_grid,
    normalized_l2,
    spherical,
)
from tests.fitting.made import GRID, table


def glossy(albedo=0.2, factor=0.7, alpha=0.2, f0=0.3):
    return Lambertian(albedo) + factor * Microfacet(TrowbridgeReitz(alpha), Schlick(f0))


GUESS = glossy(0.5, 0.5, 0.5, 0.5)


@pytest.fixture(scope="module")
def two_materials():
    """Two materials of two channels each."""
    first = glossy(jnp.array([0.1, 0.3]), 0.7, jnp.array([0.05, 0.4]), jnp.array([0.05, 0.6]))
    second = glossy(jnp.array([0.02, 0.5]), jnp.array([0.2, 1.0]), jnp.array([0.15, 0.2]), 0.2)
    return first, second, [table(first, "first"), table(second, "second")]


@pytest.fixture(scope="module")
def fits(two_materials):
    """Under all named losses and one that is robust, all in one call."""
    losses = [*LOSSES, robust("l2"), compressed(10.0)]
    return dict(zip([*LOSSES, "robust", "gain 10"], fit_losses(GUESS, two_materials[2], losses), strict=True))


@pytest.mark.parametrize("loss", [*LOSSES, "robust", "gain 10"])
def test_recovers_the_model_that_made_the_data(two_materials, fits, loss):
    first, second, _ = two_materials
    result = fits[loss]
    assert result.status.tolist() == [[0, 0], [0, 0]]
    for i, truth in enumerate((first, second)):
        for found, true in zip(jax.tree.leaves(result[i].model), jax.tree.leaves(truth), strict=True):
            np.testing.assert_allclose(found, np.broadcast_to(true, 2), rtol=2e-3)
    assert result.names == ("first", "second")
    assert result.cost.shape == result.steps.shape == (2, 2)


def test_one_material_alone_has_leaves_of_channels(two_materials, fits):
    alone = fit_reflectance(GUESS, two_materials[2][1])
    for one, batch in zip(jax.tree.leaves(alone.model), jax.tree.leaves(fits["l2"][1].model), strict=True):
        np.testing.assert_allclose(one, batch, rtol=1e-5)
    assert alone.parameters == (
        "terms[0].albedo",
        "terms[1].factor",
        "terms[1].brdf.ndf.alpha_x",
        "terms[1].brdf.fresnel.f0",
    )
    assert float(normalized_l2(alone.model, two_materials[2][1]).max()) < 1e-3
    assert alone.residuals.shape[0] == 2
    assert np.nanmax(np.abs(alone.residuals)) < 1e-2


@pytest.mark.parametrize("loss", ["l2", "log", "cube_root", "log_ratio"])
def test_no_other_parameters_have_a_lower_loss(loss):
    """The minimum is that of scipy, started there, on the loss written out in numpy."""
    measured = table(Lambertian(0.2) + 0.5 * Microfacet(Beckmann(0.25), Schlick(0.4)), noise=0.1)
    result = fit_reflectance(GUESS, measured, loss)
    cos_i, cos_o = (np.asarray(c) for c in GRID.cosines())
    used = (cos_i > np.cos(np.radians(80))) & (cos_o > np.cos(np.radians(80)))
    cells = choose_cells(GRID)
    wi, wo, index, weight = jnp.asarray(cells.wi), jnp.asarray(cells.wo), cells.cell, cells.measure
    use, ci, co = used[index], cos_i[index], cos_o[index]
    m = measured.values[..., 0][index]

    def phi(f):
        return {
            "l2": lambda: f,
            "log": lambda: np.log(1 + f * ci),
            "cube_root": lambda: np.cbrt(f + 1e-6),
            "log_ratio": lambda: np.log(f + 1e-4),
        }[loss]()

    w = np.where(use, weight * (1 if loss == "log" else ci * co), 0)
    evaluate = jax.jit(lambda p: glossy(*p)(wi, wo))

    def residual(p):
        return np.sqrt(w) * (phi(np.asarray(evaluate(p))) - phi(m))

    ours = np.array([float(leaf[0]) for leaf in jax.tree.leaves(result.model)])
    box = (np.zeros(4), [np.inf, np.inf, 3.0, 1.0 + 1e-9])
    theirs = least_squares(residual, ours, bounds=box, x_scale=ours, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert np.sum(residual(ours) ** 2) <= np.sum(theirs.fun**2) * (1 + 1e-5)
    np.testing.assert_allclose(ours, theirs.x, rtol=5e-3)


MODELS = {
    "Ward": (Lambertian(0.1) + 0.3 * Ward(0.15), Lambertian(0.5) + 1.0 * Ward(0.5)),
    "ABC": (Lambertian(0.1) + ABC(20.0, 300.0, 1.3, 1.5), Lambertian(0.5) + ABC(1.0, 10.0, 1.0, 2.0)),
    "StudentT": (
        Lambertian(0.1) + 0.5 * Microfacet(StudentT(0.2, 3.0), Schlick(0.2)),
        Lambertian(0.5) + 1.0 * Microfacet(StudentT(0.5, 5.0), Schlick(0.5)),
    ),
    "Ashikhmin–Shirley": (AshikhminShirley(0.4, 0.1, 80.0), AshikhminShirley(0.1, 0.5, 10.0)),
    "Lafortune": (
        Lambertian(0.1) + 2.0 * Lafortune(20.0, -1.0, c_z=0.9),
        Lambertian(0.5) + 1.0 * Lafortune(5.0, -1.0, c_z=1.0),
    ),
    "Cook–Torrance": (
        CookTorrance(0.1, 0.6, Beckmann(0.15), Schlick(0.3)),
        CookTorrance(0.5, 0.5, Beckmann(0.5), Schlick(0.5)),
    ),
    "metal": (
        1.0 * Microfacet(TrowbridgeReitz(0.1), Conductor(0.3, 3.0)),
        0.5 * Microfacet(TrowbridgeReitz(0.5), Conductor(0.3, 3.0)),
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_every_kind_of_model_is_found_again(name):
    truth, guess = MODELS[name]
    fixed = ("eta", "kappa") if name == "metal" else ()
    measured = table(truth)
    result = fit_reflectance(guess, measured, fixed=fixed)
    assert result.success.all(), FitStatus(int(result.status[0])).message
    assert float(normalized_l2(result.model, measured)[0]) < 2e-4


def test_fixed_parameters_stay_each_channel_with_its_own():
    kappa = jnp.array([2.0, 4.0])
    truth = jnp.array([0.6, 0.8]) * Microfacet(TrowbridgeReitz(jnp.array([0.1, 0.3])), Conductor(0.5, kappa))
    guess = 1.0 * Microfacet(TrowbridgeReitz(0.5), Conductor(0.5, kappa))
    result = fit_reflectance(guess, table(truth), fixed=["fresnel.eta", "kappa"])
    np.testing.assert_allclose(result.model.factor, [0.6, 0.8], rtol=1e-4)
    np.testing.assert_allclose(result.model.brdf.ndf.alpha_x, [0.1, 0.3], rtol=1e-4)
    np.testing.assert_array_equal(result.model.brdf.fresnel.kappa, kappa)
    assert len(result.parameters) == 2
    assert result.covariance.shape == (2, 2, 2)


def test_a_second_lobe_lowers_the_error_and_is_found():
    truth = glossy(0.1, 0.4, 0.5, 0.2) + 0.6 * Microfacet(TrowbridgeReitz(0.06), Schlick(0.7))
    measured = table(truth)
    one = fit_reflectance(GUESS, measured)
    two = fit_reflectance(GUESS + 0.5 * Microfacet(TrowbridgeReitz(0.5), Schlick(0.5)), measured)
    assert two.cost[0] < 0.1 * one.cost[0]
    lobes = two.model.terms[0].terms[1], two.model.terms[1]
    alphas = sorted(float(lobe.brdf.ndf.alpha_x[0]) for lobe in lobes)
    np.testing.assert_allclose(alphas, [0.06, 0.5], rtol=1e-3)


def test_three_lobes_are_found_in_one_another():
    widths, factors = [0.05, 0.2, 0.7], [0.05, 0.3, 0.9]
    truth = Lambertian(0.1) + sum_of(widths, factors)
    result = fit_reflectance(Lambertian(0.3) + sum_of([0.3] * 3, [0.1] * 3), table(truth))
    found = np.array([float(leaf[0]) for leaf in jax.tree.leaves(result.model)])
    assert found[0] == pytest.approx(0.1, rel=1e-3)
    order = np.argsort(found[2::2])
    np.testing.assert_allclose(found[2::2][order], widths, rtol=1e-3)
    np.testing.assert_allclose(found[1::2][order], factors, rtol=1e-3)


def sum_of(widths, factors):
    """Ward lobes."""
    first, *others = (factor * Ward(width) for width, factor in zip(widths, factors, strict=True))
    return reduce(add, others, first)


def test_scattered_samples_of_an_anisotropic_surface():
    rng = np.random.default_rng(5)
    theta = np.arccos(np.sqrt(rng.uniform(0.05, 1, (2, 3000))))
    phi = rng.uniform(-np.pi, np.pi, (2, 3000))
    truth = Lambertian(0.1) + 0.5 * Ward(0.1, 0.3)
    f = truth(spherical(theta[0], phi[0]), spherical(theta[1], phi[1]))
    samples = MeasuredSamples(theta[0], phi[0], theta[1], phi[1], np.asarray(f)[:, None], np.ones(3000))
    result = fit_reflectance(Lambertian(0.5) + 1.0 * Ward(0.5, 0.4), samples)
    np.testing.assert_allclose(
        [float(leaf[0]) for leaf in jax.tree.leaves(result.model)], [0.1, 0.5, 0.1, 0.3], rtol=1e-4
    )


def test_samples_weigh_as_much_as_they_say():
    samples = as_samples(table(glossy()))
    values = samples.values.copy()
    values[::7] *= 50
    weights = np.ones(len(values))
    weights[::7] = 0
    spoiled = dataclasses.replace(samples, values=values, weights=weights)
    result = fit_reflectance(GUESS, spoiled)
    np.testing.assert_allclose(
        [float(leaf[0]) for leaf in jax.tree.leaves(result.model)], [0.2, 0.7, 0.2, 0.3], rtol=1e-3
    )


def test_a_robust_loss_shrugs_at_outliers():
    measured = table(glossy(), noise=0.02)
    raw = np.array(measured.raw)
    spoiled_cells = np.random.default_rng(7).random(raw.shape) < 0.05
    spoiled = dataclasses.replace(measured, raw=np.where(spoiled_cells, raw + 5, raw))
    plain, firm = fit_losses(GUESS, spoiled, ["l2", robust("l2")])
    truth = np.array([0.2, 0.7, 0.2, 0.3])
    off = [
        np.abs(np.array([float(leaf[0]) for leaf in jax.tree.leaves(r.model)]) / truth - 1)
        for r in (plain, firm)
    ]
    assert off[0].max() > 0.3
    assert off[1].max() < 0.06


def test_standard_errors_are_those_of_repeated_measurements():
    """400 measurements with noise: estimates lie about the truth as far as the covariance says."""
    truth = glossy(0.3, 0.6, 0.25, 0.3)
    clean = table(truth)
    rng = np.random.default_rng(11)
    noisy = np.array(clean.raw) * (1 + 0.05 * rng.standard_normal((*GRID.shape, 400)))
    measured = MeasuredBRDF(noisy, np.ones(400), GRID)
    for result in fit_losses(GUESS, measured, ["l2", "log"], starts=1):
        found = np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(result.model)], axis=-1)
        errors = np.sqrt(np.diagonal(result.covariance, axis1=1, axis2=2))
        pull = (found - np.array([0.3, 0.6, 0.25, 0.3])) / errors
        assert np.all(np.abs(pull.mean(axis=0)) < 0.2)
        np.testing.assert_allclose(pull.std(axis=0), 1, atol=0.12)


def test_what_cannot_be_fitted_is_a_status_beside_good_fits():
    good = np.array(table(glossy()).raw)[..., 0]
    channels = {
        FitStatus.CONVERGED: good,
        FitStatus.TOO_FEW_SAMPLES: np.full_like(good, -1),
        FitStatus.NO_LOBE: np.full_like(good, 0.2),
    }
    nan = np.full_like(good, np.nan)
    zero = np.zeros_like(good)
    infinite = np.where(np.random.default_rng(1).random(good.shape) < 0.01, np.inf, good)
    raw = np.stack([*channels.values(), nan, zero, infinite], axis=-1)
    result = fit_reflectance(GUESS, MeasuredBRDF(raw, np.ones(6), GRID))
    few = FitStatus.TOO_FEW_SAMPLES
    assert result.status.tolist() == [*channels, few, few, FitStatus.CONVERGED]
    assert np.isnan(np.asarray(result.model.terms[0].albedo)[[1, 3, 4]]).all()
    np.testing.assert_allclose(np.asarray(result.model.terms[0].albedo)[[0, 5]], 0.2, rtol=1e-3)
    np.testing.assert_allclose(result.model.terms[0].albedo[2], 0.2 * np.pi, rtol=1e-6)


def test_misuse_is_explained():
    measured = table(glossy())
    with pytest.raises(ValueError, match="unknown loss 'huber': expected one of l2, log"):
        fit_reflectance(GUESS, measured, "huber")
    with pytest.raises(
        ValueError, match=r"fixed names no parameter: 'beta'; the model has terms\[0\].albedo"
    ):
        fit_reflectance(GUESS, measured, fixed=["beta"])
    with pytest.raises(ValueError, match="nothing to fit"):
        fit_reflectance(Lambertian(0.1), measured, fixed=["albedo"])
    with pytest.raises(ValueError, match="starts must be at least 1"):
        fit_reflectance(GUESS, measured, starts=0)
    with pytest.raises(ValueError, match="cutoff must be greater than 0"):
        robust("l2", 0.0)
    with pytest.raises(ValueError, match="expected at least one"):
        fit_reflectance(GUESS, [])
    with pytest.raises(ValueError, match="share their directions and channels"):
        fit_reflectance(GUESS, [measured, table(glossy(), grid=merl_grid())])
    with pytest.raises(ValueError, match="the model has 2 channels and the measurement 1"):
        fit_reflectance(glossy(jnp.array([0.1, 0.2])), measured)
