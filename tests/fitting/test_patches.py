"""Ellipsoids and others fitted to many small tables: truths come back, noise is told of, none gets stuck."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from fitting import fit_ndf, fit_ndf_patches
from jaxbrdf import (
    Beckmann,
    Ellipsoid,
    FitStatus,
    ShiftedGamma,
    StudentT,
    TabulatedNDF,
    TrowbridgeReitz,
    gaussian_surface,
    patch_ndfs,
)
from jaxbrdf.ndf.tabulated import disk_cells
from jaxbrdf.surface.heightfield import Heightfield

N, COUNT = 65, 256
M = np.moveaxis(disk_cells(N), 0, -1)
INSIDE = M[..., 2] > 0
AREA = (2 / N) ** 2
ANY = Ellipsoid(jnp.array(0.2), jnp.array(0.2), jnp.array(0.0), jnp.array(0.0), jnp.array(0.0))
LOSSES = ("l2", "likelihood")


@pytest.fixture(scope="module")
def truth():
    rng = np.random.default_rng(1)
    alphas = np.exp(rng.uniform(np.log(0.06), np.log(0.5), (2, COUNT)))
    parts = (*alphas, *rng.uniform(-0.25, 0.25, (2, COUNT)), rng.uniform(-0.7, 0.7, COUNT))
    return Ellipsoid(*(jnp.asarray(part) for part in parts))


@pytest.fixture(scope="module")
def clean(truth):
    table = jax.jit(jax.vmap(lambda e: jnp.where(INSIDE, e._density(jnp.asarray(M)), 0)))
    return np.asarray(table(truth))


def counted(clean, normals, seed=2):
    """Tables of so many normals, each cell Poisson distributed."""
    return np.random.default_rng(seed).poisson(normals * clean * AREA) / (normals * AREA)


def numbers(model):
    return np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(model)], axis=-1)


def slopes(model):
    return [np.asarray(part) for part in jax.jit(jax.vmap(Ellipsoid.slope_form))(model)]


def named_like(truth, model):
    """The numbers of the truth, each by the name nearest to that of a fit."""
    mean, G = slopes(truth)
    theta_z = np.asarray(model.theta_z)
    named = [Ellipsoid.of_slopes(mean[k], G[k], float(theta_z[k])) for k in range(len(mean))]
    return np.stack([numbers(ellipsoid) for ellipsoid in named])


@pytest.mark.parametrize("loss", LOSSES)
def test_what_made_the_tables_comes_back(truth, clean, loss):
    result = fit_ndf_patches(ANY, TabulatedNDF(clean), loss=loss)
    assert np.all(result.status == FitStatus.CONVERGED)
    for found, expected in zip(slopes(result.model), slopes(truth), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-7)
    assert result.covariance.shape == (COUNT, 5, 5)
    assert result.residuals.shape == (COUNT, 0)
    # The names are those nearest to the orientation of all.
    assert np.ptp(result.model.theta_z) < np.pi / 2 + 0.3


def test_without_angles_it_is_a_trowbridge_reitz():
    alphas = np.array([[0.3, 0.1], [0.08, 0.2], [0.15, 0.15]])
    tables = [np.where(INSIDE, TrowbridgeReitz(*alpha)._density(jnp.asarray(M)), 0) for alpha in alphas]
    model = fit_ndf_patches(ANY, TabulatedNDF(np.stack(tables))).model
    for found, alpha in zip(zip(*slopes(model), strict=True), alphas, strict=True):
        np.testing.assert_allclose(found[0], 0, atol=1e-8)
        np.testing.assert_allclose(found[1], np.diag(alpha**2), atol=1e-9)


@pytest.mark.parametrize("normals", [1e3, 1e4, 1e6])
@pytest.mark.parametrize("loss", LOSSES)
def test_noise_is_told_of(truth, clean, loss, normals):
    """Within three standard errors in 99 % of patches, of parameters that there are: the orientation and
    names of nearly isotropic ones are none."""
    result = fit_ndf_patches(ANY, TabulatedNDF(counted(clean, normals)), loss=loss)
    assert result.success.all()
    expected = named_like(truth, result.model)
    errors = np.sqrt(np.diagonal(result.covariance, axis1=1, axis2=2))
    deviations = (numbers(result.model) - expected) / errors
    told = np.abs(np.log(expected[:, 0] / expected[:, 1])) > 0.2
    assert np.sum(told) > 150
    assert np.mean(np.abs(deviations[told]) < 3) > 0.99
    assert 0.85 < np.sqrt(np.mean(deviations[told] ** 2)) < 1.15


def test_the_likelihood_tells_more_than_the_area(truth, clean):
    """It is what the normals of small patches deserve: the error of log α is some .7 of that of L2."""
    table = TabulatedNDF(counted(clean, 1e3))
    errors = {}
    for loss in LOSSES:
        G = slopes(fit_ndf_patches(ANY, table, loss=loss).model)[1]
        expected = slopes(truth)[1]
        errors[loss] = np.sqrt(np.mean(np.log(np.linalg.det(G) / np.linalg.det(expected)) ** 2))
    assert 0.5 < errors["likelihood"] / errors["l2"] < 0.85


@pytest.mark.parametrize("loss", LOSSES)
def test_no_patch_is_stuck(truth, clean, loss):
    """No minimum is above that from the truth itself by scipy, for any count of normals."""
    few = [(seed, normals) for seed, normals in enumerate((3e2, 3e3, 1e5)) for _ in range(4)]
    tables = np.stack([counted(clean[k], normals, k) for k, (_, normals) in enumerate(few)])
    result = fit_ndf_patches(ANY, TabulatedNDF(tables), loss=loss)
    m = jnp.asarray(M[INSIDE])

    def deviance(D, T):
        y = T / D
        return 200 * AREA * D * (np.where(y > 0, y * np.log(np.where(y > 0, y, 1)), 0) - y + 1)

    density = jax.jit(lambda p: Ellipsoid(*p)._density(m))
    for k in range(len(few)):
        T = tables[k][INSIDE]

        def residual(p, T=T):
            D = np.asarray(density(jnp.asarray(p)))
            if loss == "likelihood":
                return np.sign(D - T) * np.sqrt(np.maximum(deviance(D, T), 0))
            return 10 * (D - T) / np.sqrt(np.sum(T**2))

        best = least_squares(residual, numbers(truth)[k], x_scale=0.1)
        assert result.cost[k] < best.cost * (1 + 1e-6) + 1e-9


def test_a_tilted_random_surface_tells_its_tilt():
    """Of patches on a slope mean slopes are the slope, and the roughness is that of the level one."""
    level = gaussian_surface(jax.random.key(0), (256, 384), 0.5, 0.25, 4.0)
    x, y = 0.5 * np.arange(384), 0.5 * np.arange(256)
    tilted = Heightfield(level.z + 0.2 * x[None, :] - 0.1 * y[:, None], 0.5, 0.5)
    found = [
        fit_ndf_patches(ANY, patch_ndfs(surface, 32.0, extent=0.6), loss="likelihood")
        for surface in (level, tilted)
    ]
    (mean_0, G_0), (mean, G) = (slopes(result.model) for result in found)
    assert np.all([result.success for result in found])
    # Normals lean against the slope; half a cell is .01.
    np.testing.assert_allclose(np.mean(mean - mean_0, axis=0), [-0.2, 0.1], atol=4e-3)
    np.testing.assert_allclose(np.mean(G, axis=0), np.mean(G_0, axis=0), atol=0.06 * np.mean(G_0))


def test_others_are_fitted_as_one_by_one():
    truths = [Beckmann(0.1, 0.3), Beckmann(0.25, 0.12), Beckmann(0.4, 0.4)]
    tables = TabulatedNDF(np.stack([np.where(INSIDE, t._density(jnp.asarray(M)), 0) for t in truths]))
    start = Beckmann(jnp.array(0.2), jnp.array(0.2))
    together, apart = fit_ndf_patches(start, tables), fit_ndf(start, tables)
    np.testing.assert_allclose(numbers(together.model), [[0.1, 0.3], [0.25, 0.12], [0.4, 0.4]], rtol=1e-6)
    np.testing.assert_allclose(numbers(together.model), numbers(apart.model), rtol=1e-7)
    np.testing.assert_array_equal(together.status, apart.status)
    assert together.parameters == ("alpha_x", "alpha_y")


@pytest.mark.parametrize(
    ("truth", "start"),
    [(StudentT(0.15, 3.0), StudentT(0.3, 2.0)), (ShiftedGamma(0.1, 0.8), ShiftedGamma(0.3, 0.5))],
    ids=["Student t", "shifted gamma"],
)
def test_isotropic_ones_by_likelihood(truth, start):
    table = np.where(INSIDE, truth._density(jnp.asarray(M)), 0)
    model = fit_ndf_patches(start, TabulatedNDF(np.stack([table, table])), loss="likelihood").model
    np.testing.assert_allclose(numbers(model), [numbers(truth)] * 2, rtol=1e-4)


def test_fixed_angles_leave_an_anisotropic_trowbridge_reitz(clean):
    result = fit_ndf_patches(ANY, TabulatedNDF(clean[:3]), fixed=("theta_x", "theta_y", "theta_z"))
    assert result.parameters == ("alpha_x", "alpha_y")
    np.testing.assert_array_equal(result.model.theta_z, 0)


def broken(clean, kind):
    table = np.array(clean[0])
    column = np.argmax(table) % N
    return {
        "empty": np.zeros_like(table),
        "missing": np.full_like(table, np.nan),
        "one cell": np.where(table == table.max(), table, 0),
        "one line": np.where(np.arange(N)[None, :] == column, table, 0),
        "a diagonal": np.where(np.eye(N, dtype=bool), 1.0, 0),
    }[kind]


@pytest.mark.parametrize("kind", ["empty", "missing", "one cell", "one line", "a diagonal"])
@pytest.mark.parametrize("loss", LOSSES)
def test_patches_that_determine_nothing_are_a_status(clean, kind, loss):
    stack = np.stack([clean[1], broken(clean, kind), clean[2]])
    result = fit_ndf_patches(ANY, TabulatedNDF(stack), loss=loss)
    np.testing.assert_array_equal(result.status, [0, FitStatus.TOO_FEW_SAMPLES, 0])
    assert np.isnan(numbers(result.model)[1]).all()
    assert np.isnan(result.covariance[1]).all()
    alone = fit_ndf_patches(ANY, TabulatedNDF(clean[1:3]), loss=loss)
    np.testing.assert_allclose(numbers(result.model)[[0, 2]], numbers(alone.model), atol=1e-9)


def test_cells_without_a_value_do_not_count(truth, clean):
    holed = np.where(np.random.default_rng(0).random(clean.shape) < 0.2, np.nan, clean)
    G = slopes(fit_ndf_patches(ANY, TabulatedNDF(holed)).model)[1]
    np.testing.assert_allclose(G, slopes(truth)[1], atol=1e-6)


def test_a_stack_is_the_same_in_any_company(clean):
    """What a patch comes out as does not depend on what is fitted with it, or in which block."""
    tables = counted(clean, 1e4)
    whole = slopes(fit_ndf_patches(ANY, TabulatedNDF(tables)).model)
    part = slopes(fit_ndf_patches(ANY, TabulatedNDF(tables[100:103])).model)
    for a, b in zip(whole, part, strict=True):
        np.testing.assert_allclose(a[100:103], b, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("model", "tables", "options", "message"),
    [
        (ANY, np.ones((2, 5, 5)), {"loss": "l3"}, "l2, likelihood"),
        (Beckmann(jnp.array([0.1, 0.2])), np.ones((2, 5, 5)), {}, "without channels"),
        (ANY, np.ones((5, 5, 2)), {}, "without channels"),
        (ANY, np.ones((0, 5, 5)), {}, "one table or more"),
        (ANY, np.ones((2, 5, 5)), {"fixed": ("alpha",)}, "names no parameter"),
    ],
)
def test_misuse_is_explained(model, tables, options, message):
    with pytest.raises(ValueError, match=message):
        fit_ndf_patches(model, TabulatedNDF(tables), **options)
