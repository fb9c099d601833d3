"""Free-form factors: known ones are found again, nothing parametric is nearer, bad data are a status."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from fitting import LOSSES, fit_factors, robust
from fitting.factor_cells import Sums, make_cells, polar_nodes
from fitting.factor_descent import Problem, descend, make_penalty

FEW = 40, 30, 12  # cells over θ_h, θ_d and φ_d: bins of 15° then hold one each
EDGES = (
    np.pi / 2 * (np.arange(FEW[0] + 1) / FEW[0]) ** 2,
    np.pi / 2 * np.arange(FEW[1] + 1) / FEW[1],
    np.pi * np.arange(FEW[2] + 1) / FEW[2],
)
GRID = jb.HalfDifferenceGrid(*((e[1:] + e[:-1]) / 2 for e in EDGES), *EDGES)
LIMIT = np.deg2rad(80)


def table(grid, rho_d, alpha, f0, masking):
    """f (H, D, P) of a GGX-like D, Schlick's F and G1 = cos^masking at its nodes; −1 below the horizon."""
    h, d, p = np.meshgrid(grid.theta_h, grid.theta_d, grid.phi_d, indexing="ij")
    along, across = np.cos(h) * np.cos(d), np.sin(h) * np.sin(d) * np.cos(p)
    cos = np.stack([along - across, along + across])
    above = np.all(cos > 1e-6, axis=0)
    cos = np.where(above, cos, 1)
    D, F, G1 = known_factors(grid, alpha, f0, masking)
    G = np.interp(np.arccos(np.minimum(cos, 1)), polar_nodes(), G1).prod(axis=0)
    f = rho_d / np.pi + D[:, None, None] * F[None, :, None] * G / (4 * cos.prod(axis=0))
    return np.where(above, f, -1)


def known_factors(grid, alpha, f0, masking):
    """D with ∫ D cos θ dω = 1 by a fine sum, constant beyond 80° as a fit must think; F; G1."""
    theta = (np.arange(200_000) + 0.5) / 200_000 * np.pi / 2
    theta_h = np.minimum(grid.theta_h, grid.theta_h[grid.theta_h < LIMIT].max())
    D = 1 / (1 + np.tan(theta_h) ** 2 / alpha**2) ** 2 / np.cos(theta_h) ** 3
    total = (
        2 * np.pi * np.sum(np.interp(theta, grid.theta_h, D) * np.cos(theta) * np.sin(theta)) * theta[0] * 2
    )
    F = f0 + (1 - f0) * (1 - np.cos(grid.theta_d)) ** 5
    return D / total, F, np.cos(polar_nodes()) ** masking


CHANNELS = [(0.1, 0.3, 0.5, 0.3), (0.0, 0.1, 0.9, 0.05), (0.3, 0.4, 0.05, 0.5)]


@pytest.fixture(scope="module")
def known():
    values = np.stack([table(GRID, *channel) for channel in CHANNELS], axis=-1)
    return jb.MeasuredBRDF(values, np.ones(3), GRID, "known")


@pytest.fixture(scope="module")
def fits(known):
    return {loss: fit_factors(known, loss) for loss in ("l2", "log")}


@pytest.mark.parametrize("loss", ["l2", "log"])
def test_known_factors_are_found_again(fits, loss):
    model = fits[loss].model
    assert np.all(fits[loss].success)
    seen_h, seen_d, seen = GRID.theta_h < 1.2, GRID.theta_d < 1.3, polar_nodes() < 1.35
    for c, (rho_d, *shape) in enumerate(CHANNELS):
        D, F, G1 = known_factors(GRID, *shape)
        assert_allclose(model.rho_d[c], rho_d, atol=1e-3)
        assert_allclose(model.D[seen_h, c], D[seen_h], rtol=1e-3)
        assert_allclose(model.F[seen_d, c], F[seen_d], rtol=1e-3)
        assert_allclose(model.G1[seen, c], G1[seen], rtol=1e-6)


@pytest.mark.parametrize("loss", ["l2", "log"])
def test_the_reflectance_is_found_again(known, fits, loss):
    f = jb.metrics.tabulate(fits[loss].model, GRID)
    cos_i, cos_o = GRID.cosines()
    near = np.asarray(np.minimum(cos_i, cos_o) > np.cos(LIMIT))
    assert_allclose(f[near], known.raw[near], rtol=1e-6)


def test_shapes_names_and_cost(known, fits):
    fit = fits["log"]
    assert fit.recipe == "log"
    assert fit.names == ("known",)
    assert fit.parameters == ()
    assert fit.covariance.shape == (3, 0, 0)
    assert fit.status.shape == fit.cost.shape == fit.steps.shape == fit.model.rho_d.shape == (3,)
    assert fit.model.D.shape == (FEW[0], 3)
    assert fit.model.F.shape == (FEW[1], 3)
    assert fit.model.G1.shape == (46, 3)
    assert_array_equal(fit.model.G1[0], 1)
    assert_array_equal(fit.model.G1[-1], 0)
    assert fit.residuals.shape == (3, FEW[0] + FEW[1])


@pytest.fixture(scope="module")
def noisy():
    """10 % noise and a tenth missing; without samples; Lambertian; with an infinite sample: four channels."""
    rng = np.random.default_rng(5)
    one = table(GRID, *CHANNELS[0])
    noise = np.where(one < 0, -1, one * (1 + 0.1 * rng.normal(size=one.shape)))
    noise[rng.uniform(size=one.shape) < 0.1] = np.nan
    infinite = np.where(one == one[5, 5, 5], np.inf, one)
    spoilt = [noise, np.full_like(one, -1), np.where(one < 0, -1, 0.1), infinite]
    return jb.MeasuredBRDF(np.stack(spoilt, axis=-1), np.ones(4), GRID, "noisy")


@pytest.fixture(scope="module")
def of_noisy(noisy):
    return fit_factors([noisy, noisy], "l2")


def test_what_cannot_be_fitted_is_a_status(of_noisy):
    S = jb.FitStatus
    expected = [S.CONVERGED, S.TOO_FEW_SAMPLES, S.NO_LOBE, S.NOT_FINITE]
    assert_array_equal(of_noisy.status, [expected, expected])
    model = of_noisy[0].model
    for channel in (1, 3):
        assert np.all(np.isnan(model.rho_d[channel]))
        assert np.all(np.isnan(model.D[:, channel]))
    assert_allclose(model.rho_d[2], 0.1 * np.pi, rtol=1e-6)
    assert_array_equal(model.F[:, 2], 0)


def test_a_batch_is_each_material_alone(noisy, of_noisy):
    assert of_noisy.names == ("noisy", "noisy")
    assert of_noisy.model.D.shape == (2, FEW[0], 4)
    assert of_noisy.model.theta_h.shape == (2, FEW[0])
    assert of_noisy.cost.shape == (2, 4)
    assert_array_equal(of_noisy[1].model.F, of_noisy[0].model.F)


def test_no_model_of_this_kind_is_nearer_not_even_the_truth(noisy, of_noisy):
    """Under 10 % noise the fitted factors are nearer to the data than those that made them."""
    m, f, truth = (
        noisy.raw[..., 0],
        jb.metrics.tabulate(of_noisy[0].model, GRID)[..., 0],
        table(GRID, *CHANNELS[0]),
    )
    cos_i, cos_o = (np.asarray(c) for c in GRID.cosines())
    used = (np.minimum(cos_i, cos_o) > np.cos(LIMIT)) & (m >= 0)
    weight = np.where(used, np.asarray(GRID.measure()) * cos_i * cos_o, 0)
    fitted, true = (np.nansum(weight * (a - m) ** 2) for a in (f, truth))
    assert 0.8 * true < fitted < true


@pytest.mark.parametrize("loss", ["l2", "log"])
def test_the_error_falls_step_by_step_to_the_same_end_from_anywhere(noisy, loss):
    cells = make_cells(GRID, LIMIT)
    sums = Sums(cells, GRID)
    values, measure = cells.mean(noisy)
    share = LOSSES[loss].weight(jnp.asarray(cells.cos_i), jnp.asarray(cells.cos_o))
    weight = measure[:, 0] * np.asarray(share)
    problem = Problem(sums, LOSSES[loss], values[:, 0], weight, make_penalty(sums.sizes, 0.01))
    total = np.sum(weight * problem.residual(0 * weight)[0] ** 2)
    problem = problem._replace(weight=weight / total)
    rng, n = np.random.default_rng(0), 1 + sum(sums.sizes)
    ends = [descend(problem, x) for x in (np.zeros(n), rng.normal(size=n), np.full(n, -1.0))]
    for end in ends:
        assert end.converged
        assert np.all(np.diff(end.objective) <= 0)
    assert_allclose([end.error for end in ends], ends[0].error, rtol=5e-3)


def test_sums_are_those_of_the_derivatives():
    """Half the gradient and Gauss–Newton's matrix, against finite differences of f at a random point."""
    sums = Sums(make_cells(GRID, LIMIT), GRID)
    x = 0.3 * np.random.default_rng(2).normal(size=sum(sums.sizes))
    split = np.cumsum(sums.sizes)[:2]

    def lobe(x):
        return sums.lobe(*np.split(np.exp(x), split))[0]

    J = np.stack([(lobe(x + d) - lobe(x - d)) / 2e-5 for d in 1e-5 * np.eye(len(x))])
    s, *g = sums.lobe(*np.split(np.exp(x), split))
    G1 = np.exp(x[split[1] :])
    v = np.random.default_rng(3).uniform(size=len(s))
    assert_allclose(sums.project(v * s, G1, *g), J @ v, rtol=1e-6, atol=1e-6)
    gram = np.triu(sums.gram(v * s**2, G1, *g))
    assert_allclose(gram, np.triu(J * v[None, :] @ J.T), rtol=1e-6, atol=1e-6)


def test_nodes_that_no_sample_determines_follow_their_neighbours(known):
    """Without the 10 cells of θ_h around 30°, and beyond 80°."""
    raw = np.array(known.raw[..., :1])
    raw[20:25] = -1
    model = fit_factors(jb.MeasuredBRDF(raw, np.ones(1), GRID)).model
    D, _, _ = known_factors(GRID, *CHANNELS[0][1:])
    assert_allclose(np.diff(np.log(model.D[19:26, 0]), 2), 0, atol=1e-6)
    assert_allclose(model.D[18, 0] / model.D[27, 0], D[18] / D[27], rtol=1e-3)
    beyond = model.D[GRID.theta_h > LIMIT, 0]
    assert_allclose(beyond, beyond[0], rtol=1e-6)


@pytest.mark.slow
def test_a_merl_material_is_far_nearer_than_published_fits(merl_material):
    from data_loaders import published

    nickel = merl_material("nickel")
    fit = fit_factors(nickel)
    assert np.all(fit.success)
    found, given = (jb.normalized_l2(m, nickel, LIMIT) for m in (fit.model, published("sgd", "nickel")))
    assert np.all(found < 0.2 * given)


def test_misuse_is_refused(known):
    with pytest.raises(ValueError, match="no material"):
        fit_factors([])
    with pytest.raises(ValueError, match="unknown loss 'l3'"):
        fit_factors(known, "l3")
    with pytest.raises(ValueError, match="robust"):
        fit_factors(known, robust("l2"))
    other = jb.MeasuredBRDF(known.raw[..., :1], np.ones(1), GRID)
    with pytest.raises(ValueError, match="share their grid and channels"):
        fit_factors([known, other])
