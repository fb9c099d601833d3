"""A reflectance of images is, at every point, the model of the parameters there."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxbrdf as jb

HEIGHT, WIDTH = 4, 5
RANDOM = np.random.default_rng(0)
IMAGES = RANDOM.uniform([0.1, 0.2, -0.1, -0.2, 0.0], [0.4, 0.6, 0.1, 0.2, 0.5], (HEIGHT, WIDTH, 5))
ETA, KAPPA = np.array([0.2, 0.9, 1.1]), np.array([3.9, 2.5, 2.3])
WI = jb.spherical(jnp.linspace(0.1, 1.2, WIDTH), 0.3)
WO = jb.spherical(jnp.linspace(1.3, 0.3, WIDTH), 2.5)
U, V = (np.arange(WIDTH) + 0.5) / WIDTH, (np.arange(HEIGHT)[:, None] + 0.5) / HEIGHT


def metal(*parameters, eta=ETA, kappa=KAPPA):
    return jb.Microfacet(jb.Ellipsoid(*parameters), jb.Conductor(eta, kappa), jb.Uncorrelated())


def metal_at(i, j):
    return metal(*IMAGES[i % HEIGHT, j % WIDTH])


VARYING = jb.SpatiallyVaryingBRDF(metal(*np.moveaxis(IMAGES, -1, 0)))


@eqx.filter_jit
def evaluate(brdf, *arguments):
    return brdf(*arguments)


def test_at_the_centres_of_texels_it_is_the_model_of_each():
    """In RGB, the directions differing from column to column."""
    found = evaluate(VARYING, U, V, WI, WO)
    assert found.shape == (HEIGHT, WIDTH, 3)
    for i in range(HEIGHT):
        for j in range(WIDTH):
            assert_allclose(found[i, j], evaluate(metal_at(i, j), WI[j], WO[j]), rtol=1e-9)


@pytest.mark.parametrize(
    ("i", "j", "texels"),
    [
        (1, 2.5, [(1, 2), (1, 3)]),
        (1.5, 2, [(1, 2), (2, 2)]),
        (0, -0.5, [(0, 0), (0, -1)]),
        (HEIGHT - 0.5, 1, [(HEIGHT - 1, 1), (0, 1)]),
        (2.5, 0.5, [(2, 0), (2, 1), (3, 0), (3, 1)]),
    ],
    ids=["columns", "rows", "first edge", "last edge", "four"],
)
def test_between_texels_it_is_the_model_of_the_mean_parameters(i, j, texels):
    mean = np.mean([IMAGES[k] for k in texels], axis=0)
    found = evaluate(VARYING, (j + 0.5) / WIDTH, (i + 0.5) / HEIGHT, WI, WO)
    assert_allclose(found, evaluate(metal(*mean), WI, WO), rtol=1e-9)


def test_a_quarter_of_the_way_counts_three_to_one():
    mean = 0.75 * IMAGES[2, 1] + 0.25 * IMAGES[2, 2]
    found = evaluate(VARYING, 1.75 / WIDTH, 2.5 / HEIGHT, WI, WO)
    assert_allclose(found, evaluate(metal(*mean), WI, WO), rtol=1e-9)


def test_constant_images_are_the_plain_model():
    images = (np.full((HEIGHT, WIDTH), p) for p in IMAGES[0, 0])
    varying = jb.SpatiallyVaryingBRDF(metal(*images))
    u, v = RANDOM.uniform(-3, 3, (2, WIDTH))
    assert_allclose(evaluate(varying, u, v, WI, WO), evaluate(metal_at(0, 0), WI, WO), rtol=1e-9)


def test_it_repeats_itself_and_is_reciprocal():
    u, v = RANDOM.uniform(0, 1, (2, WIDTH))
    f = evaluate(VARYING, u, v, WI, WO)
    assert_allclose(evaluate(VARYING, u + 2, v - 3, WI, WO), f, rtol=1e-9)
    assert_allclose(evaluate(VARYING, u, v, WO, WI), f, rtol=1e-12)


def test_images_of_channels_and_single_numbers_go_together():
    """α_x varies in grey, η in colour; the rest are single numbers."""
    eta = RANDOM.uniform(0.5, 2, (HEIGHT, WIDTH, 3))
    varying = jb.SpatiallyVaryingBRDF(metal(IMAGES[..., 0], 0.3, 0.0, 0.1, 0.0, eta=eta, kappa=2.0))
    found = evaluate(varying, U, V, WI, WO)
    expected = evaluate(metal(IMAGES[1, 3, 0], 0.3, 0.0, 0.1, 0.0, eta=eta[1, 3], kappa=2.0), WI[3], WO[3])
    assert_allclose(found[1, 3], expected, rtol=1e-9)


def test_tables_vary_as_images_of_tables():
    """The table of a distribution has two axes of its own: alone it does not vary."""
    tables, f0 = jnp.asarray(RANDOM.uniform(1, 2, (2, 3, 5, 5))), RANDOM.uniform(0, 1, (2, 3))
    of_images = jax.vmap(jax.vmap(jb.TabulatedNDF))(tables)
    for ndf, texel in ((of_images, tables[1, 2]), (jb.TabulatedNDF(tables[0, 0]), tables[0, 0])):
        varying = jb.SpatiallyVaryingBRDF(jb.Microfacet(ndf, jb.Constant(f0)))
        plain = jb.Microfacet(jb.TabulatedNDF(texel), jb.Constant(f0[1, 2]))
        assert_allclose(evaluate(varying, 2.5 / 3, 0.75, WI, WO), evaluate(plain, WI, WO), rtol=1e-9)


def test_a_row_of_models_is_vmapped_over():
    models = VARYING.at(U, 0.5 / HEIGHT)
    assert {leaf.shape[0] for leaf in jax.tree.leaves(models)} == {WIDTH}
    found = jax.vmap(evaluate)(models, WI, WO)
    assert_allclose(found, evaluate(VARYING, U, 0.5 / HEIGHT, WI, WO), rtol=1e-12)
    assert_allclose(evaluate(VARYING.at(U[2], 0.5 / HEIGHT), WI[2], WO[2]), found[2], rtol=1e-12)


def test_gradients_by_texels_and_by_the_point():
    """Against differences; a texel that is not near has none."""

    @jax.jit
    def loss(alpha, u, v):
        brdf = jb.SpatiallyVaryingBRDF(metal(alpha, *np.moveaxis(IMAGES, -1, 0)[1:]))
        return jnp.sum(brdf(u, v, WI, WO))

    alpha, u, v, h = jnp.asarray(IMAGES[..., 0]), jnp.array(0.43), jnp.array(0.71), 1e-5
    by_alpha, by_u, by_v = jax.jit(jax.grad(loss, argnums=(0, 1, 2)))(alpha, u, v)
    for texel in ((2, 1), (3, 2), (0, 0)):
        step = jnp.zeros_like(alpha).at[texel].set(h)
        difference = (loss(alpha + step, u, v) - loss(alpha - step, u, v)) / (2 * h)
        assert_allclose(by_alpha[texel], difference, rtol=1e-6, atol=1e-9)
    assert np.count_nonzero(by_alpha) == 4
    assert_allclose(by_u, (loss(alpha, u + h, v) - loss(alpha, u - h, v)) / (2 * h), rtol=1e-6)
    assert_allclose(by_v, (loss(alpha, u, v + h) - loss(alpha, u, v - h)) / (2 * h), rtol=1e-6)


def test_many_points_are_as_few():
    """More than are evaluated at once, and a number of them that no chunk divides."""
    u = np.linspace(0, 3, 20_001)
    found = evaluate(VARYING, u, 0.3, WI[1], WO[1])
    picked = np.array([0, 8191, 8192, 16_384, 20_000])
    assert_allclose(found[picked], evaluate(VARYING, u[picked], 0.3, WI[1], WO[1]), rtol=1e-12)
    assert evaluate(VARYING, u[:0], 0.3, WI[1], WO[1]).shape == (0, 3)


def test_an_unknown_texel_is_unknown_up_to_its_neighbours():
    alpha = IMAGES[..., 0].copy()
    alpha[1, 2] = np.nan
    varying = jb.SpatiallyVaryingBRDF(metal(alpha, *np.moveaxis(IMAGES, -1, 0)[1:]))
    f = evaluate(varying, np.array([0.9, 1.6, 3.4, 4.1]) / WIDTH, 1.5 / HEIGHT, WI[1], WO[1])
    np.testing.assert_array_equal(np.isnan(f[:, 0]), [False, True, True, False])


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ((0.1, 0.2), "none that varies"),
        ((np.full(3, 0.1), 0.2), "none that varies"),
        ((np.full((2, 3), 0.1), np.full((3, 2), 0.1)), r"\(2, 3\) and \(3, 2\)"),
    ],
)
def test_what_is_no_texture_is_refused(parameters, message):
    with pytest.raises(ValueError, match=message):
        jb.SpatiallyVaryingBRDF(metal(*parameters, 0.0, 0.0, 0.0))


def test_directions_that_are_not_unit_vectors_are_refused():
    with pytest.raises(ValueError, match="unit vectors"):
        VARYING(0.1, 0.2, jnp.array([0.0, 0.0, 2.0]), WO)
