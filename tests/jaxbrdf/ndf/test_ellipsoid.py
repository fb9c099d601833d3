"""What names an ellipsoid: its slopes in one way, its angles in several."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_t

import jaxbrdf as jb
from jaxbrdf.ndf.ellipsoid import Monomials, mean_theta_z, nearest_slopes
from jaxbrdf.ndf.tabulated import disk_cells

COUNT = 200
M = disk_cells(65).reshape(3, -1).T
M = M[M[:, 2] > 0]


@pytest.fixture(scope="module")
def many():
    """Of every shape, tilted in every direction; the first isotropic and one extremely narrow."""
    rng = np.random.default_rng(0)
    alphas = np.exp(rng.uniform(np.log(1e-3), np.log(1.0), (2, COUNT)))
    angles = rng.uniform(-0.6, 0.6, (2, COUNT))
    turn = rng.uniform(-3, 3, COUNT)
    alphas[:, 0], alphas[:, 1] = 0.2, (1e-5, 1.0)
    return jb.Ellipsoid(*(jnp.asarray(a) for a in (*alphas, *angles, turn)))


@pytest.fixture(scope="module")
def slopes(many):
    return [np.asarray(part) for part in jax.jit(jax.vmap(jb.Ellipsoid.slope_form))(many)]


def densities(ellipsoids, m):
    return np.asarray(jax.jit(jax.vmap(lambda e: e._density(m)))(ellipsoids))


def drawn(many, count=40):
    """Normals of each."""
    u = np.random.default_rng(1).random((count, 2))
    return jax.jit(jax.vmap(lambda e: e._sample(jnp.asarray(u))))(many)


def test_slopes_are_a_student_t_of_two_degrees(many, slopes):
    """By scipy: its shape matrix is G/2, and D cos⁴θ a density over slopes."""
    m = np.asarray(drawn(many))
    D = np.asarray(jax.jit(jax.vmap(lambda e, m: e._density(m)))(many, m))
    for k in range(2, COUNT, 20):
        mean, G = slopes[0][k], slopes[1][k]
        expected = multivariate_t(mean, G / 2, df=2).pdf(m[k, :, :2] / m[k, :, 2:])
        above = m[k, :, 2] > 0
        np.testing.assert_allclose((D[k] * m[k, :, 2] ** 4)[above], expected[above], rtol=1e-8)


@pytest.mark.parametrize("theta_z", [0.0, 0.7, -1.5])
def test_every_name_is_the_same_distribution(many, slopes, theta_z):
    named = jb.Ellipsoid.of_slopes(*slopes, theta_z)
    m = drawn(many)
    both = [jax.jit(jax.vmap(lambda e, m: e._density(m)))(e, m) for e in (many, named)]
    ordinary = np.arange(COUNT) != 1
    np.testing.assert_allclose(both[1][ordinary], both[0][ordinary], rtol=1e-7)
    np.testing.assert_allclose(both[1][1], both[0][1], rtol=1e-4)  # α = 1e-5: eigenvalues of 1e-10 beside 1
    # Nearest by the direction of the x axis in space; tilted by up to .6 it turns a little more in the plane.
    assert np.all(np.abs(named.theta_z - theta_z) < np.pi / 4 + 0.25)


def test_no_angles_are_a_trowbridge_reitz(slopes):
    alpha = np.array([0.3, 0.1])
    named = jb.Ellipsoid.of_slopes(np.zeros(2), np.diag(alpha**2))
    np.testing.assert_allclose(jax.tree.leaves(named), [*alpha, 0, 0, 0], atol=1e-15)


def test_what_is_unknown_has_no_name():
    mean, G = np.array([[0.1, 0.0], [np.nan, 0.0], [0.1, 0.0]]), np.tile(np.eye(2), (3, 1, 1))
    G[2] = np.diag([0.04, 0.0])  # no roughness at all along y
    named = jb.Ellipsoid.of_slopes(mean, G)
    assert np.isfinite([leaf[0] for leaf in jax.tree.leaves(named)]).all()
    assert np.isnan([leaf[1:] for leaf in jax.tree.leaves(named)]).all()


def test_brushed_patches_are_named_alike():
    """Around an orientation at which single names would jump, and named at random to begin with."""
    rng = np.random.default_rng(3)
    turn = 0.75 + 0.1 * rng.standard_normal((6, 8))
    sign = rng.choice([-1, 1], turn.shape)
    tilt = 0.05 * rng.standard_normal((2, 6, 8))
    given = jb.Ellipsoid(
        jnp.full((6, 8), 0.05),
        jnp.full((6, 8), 0.3),
        jnp.asarray(sign * tilt[0]),
        jnp.asarray(sign * tilt[1]),
        jnp.asarray(turn + np.where(sign < 0, np.pi, 0)),
    )
    named = jb.aligned(given)
    expected = [np.full((6, 8), 0.05), np.full((6, 8), 0.3), tilt[0], tilt[1], turn]
    for found, value in zip(jax.tree.leaves(named), expected, strict=True):
        np.testing.assert_allclose(found, value, atol=1e-9)


def test_the_orientation_of_none_is_nothing():
    assert mean_theta_z(np.zeros((0, 2, 2))) == 0
    assert mean_theta_z(np.tile(np.eye(2), (3, 1, 1))) == 0


def test_the_nearest_quadric_of_a_table_is_exact(many, slopes):
    wide = np.asarray(many.alpha_x > 0.05) & np.asarray(many.alpha_y > 0.05)
    D = densities(many, jnp.asarray(M))[wide]
    find = jax.jit(jax.vmap(lambda D: nearest_slopes(Monomials.of(M), D, jnp.ones(len(M)))))
    mean, G = find(D)
    np.testing.assert_allclose(mean, slopes[0][wide], atol=1e-6)
    np.testing.assert_allclose(G, slopes[1][wide], rtol=1e-5, atol=1e-6)


def test_a_table_without_a_quadric_gives_its_moments():
    """More at the rim than in the middle: D^(−1/2) falls outwards."""
    r2 = (M[:, 0] - 0.05) ** 2 + M[:, 1] ** 2
    D = np.where(r2 < 0.25, 1 / (1 - 3 * np.minimum(r2, 0.3)) ** 2, 0)
    mean, G = nearest_slopes(Monomials.of(M), jnp.asarray(D), jnp.ones(len(M)))
    s = M[:, :2] / M[:, 2:]
    np.testing.assert_allclose(mean, np.average(s, axis=0, weights=D), atol=1e-12)
    np.testing.assert_allclose(G, np.cov(s.T, aweights=D, bias=True) / 3, atol=1e-12)
