"""Free-form factors: brute-force evaluation in numpy, symmetry, samples, gradients, channels, HDF5."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from data_loaders import load_fit, save_fit
from tests import references
from tests.jaxbrdf.brdf.cases import PAIRS, SEAMS

THETA_H = np.pi / 2 * ((np.arange(30) + 0.5) / 30) ** 2
THETA_D = np.linspace(0, np.pi / 2, 10)
THETA = np.linspace(0, np.pi / 2, 16)
SCALE = np.array([1.0, 0.5, 0.2])


def factors():
    """D (30, 3), F (10, 3) and G1 (16,), which is that of all channels."""
    D = 10 * np.exp(-10 * np.tan(THETA_H[:, None] * SCALE) ** 2)
    F = 0.4 + 0.6 * (1 - np.cos(THETA_D[:, None])) ** 5 * SCALE
    return D, F, np.cos(THETA) ** 0.2


def make(rho_d=0.2):
    D, F, G1 = factors()
    return jb.FreeFormBRDF(rho_d, THETA_H, D, THETA_D, F, THETA, G1)


def by_hand(wi, wo, channel, rho_d=0.2):
    """The formula for one pair, in numpy."""
    D, F, G1 = factors()
    h = (wi + wo) / np.linalg.norm(wi + wo)
    G = np.interp(np.arccos([wi[2], wo[2]]), THETA, G1).prod()
    lobe = np.interp(np.arccos(h[2]), THETA_H, D[:, channel])
    lobe *= np.interp(np.arccos(min(wi @ h, 1)), THETA_D, F[:, channel]) * G
    return rho_d / np.pi + lobe / (4 * wi[2] * wo[2])


def test_it_is_the_formula():
    expected = [[by_hand(i, o, c) for c in range(3)] for i, o in zip(*PAIRS, strict=True)]
    assert_allclose(make()(*PAIRS), expected, rtol=1e-7)


def test_it_is_reciprocal_and_isotropic():
    turn = references.rotation("z", 1.1).T
    f = make()(*PAIRS)
    assert_allclose(make()(*PAIRS[::-1]), f, rtol=1e-12)
    assert_allclose(make()(PAIRS[0] @ turn, PAIRS[1] @ turn), f, rtol=1e-10)


def test_nothing_is_reflected_below_the_horizon_and_everything_is_finite():
    f = np.asarray(make()(*SEAMS))
    below = (SEAMS[0][:, 2] <= 0) | (SEAMS[1][:, 2] <= 0)
    assert np.all(f[below] == 0)
    assert np.all(np.isfinite(f))


def test_gradients_are_finite():
    @eqx.filter_jit
    def gradients(brdf, wi, wo):
        return jax.grad(lambda brdf, wi, wo: jnp.sum(brdf(wi, wo)), (0, 1, 2))(brdf, wi, wo)

    wi, wo = (np.concatenate(w) for w in zip(PAIRS, SEAMS, strict=True))
    for leaf in jax.tree.leaves(gradients(make(), wi, wo)):
        assert np.all(np.isfinite(leaf))


def test_the_gradient_by_a_table_is_that_of_its_node():
    wi, wo = (w[3] for w in PAIRS)
    brdf = make()
    gradient = jax.grad(lambda D: eqx.tree_at(lambda b: b.D, brdf, D)(wi, wo)[1])(brdf.D)
    lobe = by_hand(wi, wo, 1) - 0.2 / np.pi
    assert_allclose(np.sum(gradient * brdf.D), lobe, rtol=1e-8)
    assert np.count_nonzero(gradient) <= 2


@pytest.mark.parametrize("rho_d", [0.0, 0.2])
def test_samples_have_the_albedo_for_their_mean(rho_d):
    brdf = jax.tree.map(lambda leaf: leaf[:, 0] if leaf.ndim == 2 else leaf, make(rho_d))
    wo = references.direction(np.array([0.2, 1.0]), np.array([0.0, 2.0]))
    u = np.random.default_rng(1).uniform(size=(20_000, 1, 2))

    @eqx.filter_jit
    def weights(brdf, u, wo):
        wi = brdf.sample(u, wo)
        pdf = brdf.pdf(wi, wo)
        return jnp.where(pdf > 0, brdf(wi, wo) * wi[..., 2] / jnp.where(pdf > 0, pdf, 1), 0)

    weight = np.asarray(weights(brdf, u, wo))
    error = weight.std(axis=0) / np.sqrt(len(u))
    assert np.all(np.abs(weight.mean(axis=0) - jb.albedo(brdf, wo)) < 4 * error + 1e-3)
    assert np.all(error < 0.01)


def test_a_lobe_without_facets_draws_samples_all_the_same():
    brdf = jb.FreeFormBRDF(0.0, THETA_H, 0 * THETA_H, THETA_D, 0 * THETA_D, THETA, 0 * THETA)
    lobe, wo = brdf.parts[1], np.array([[0, 0.6, 0.8]])
    wi = eqx.filter_jit(lobe.sample)(np.full((1, 2), 0.3), wo)
    assert np.all(np.isfinite(wi))
    assert np.all(np.asarray(eqx.filter_jit(lobe.pdf)(wi, wo)) > 0)


def test_a_batch_is_vmapped():
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), make())
    f = jax.vmap(lambda brdf: brdf(*PAIRS))(batch)
    assert_array_equal(f[1], make()(*PAIRS))


def test_it_is_saved_and_loaded_whole(tmp_path):
    fit = jb.FitResult(
        make(), np.zeros(3, int), np.ones(3), np.ones(3, int), np.empty((3, 0, 0)), np.ones((3, 4)), ()
    )
    save_fit(tmp_path / "fit.h5", fit)
    loaded = load_fit(tmp_path / "fit.h5")
    assert isinstance(loaded.model, jb.FreeFormBRDF)
    for a, b in zip(jax.tree.leaves(loaded), jax.tree.leaves(fit), strict=True):
        assert_array_equal(a, b)


def test_negative_tables_are_refused():
    with pytest.raises(ValueError, match="D must be at least 0"):
        jb.FreeFormBRDF(0.1, THETA_H, -THETA_H, THETA_D, THETA_D, THETA, THETA)
