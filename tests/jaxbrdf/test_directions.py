"""Directions, frames and half/difference angles against rotation matrices, and at the poles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from jaxbrdf import directions
from tests import references

RNG = np.random.default_rng(7)


def random_directions(n, lowest=-1.0):
    cos = RNG.uniform(lowest, 1, n)
    return references.direction(np.arccos(cos), RNG.uniform(-np.pi, np.pi, n))


def test_spherical_both_ways():
    theta, phi = RNG.uniform(0, np.pi, 100), RNG.uniform(-np.pi, np.pi, 100)
    w = jb.spherical(jnp.asarray(theta), jnp.asarray(phi))
    assert_allclose(w, references.direction(theta, phi), atol=1e-15)
    assert_allclose(np.stack(jb.to_spherical(w)), np.stack([theta, phi]), atol=1e-14)


def test_spherical_broadcasts_its_angles():
    w = jb.spherical(jnp.linspace(0, 1, 4)[:, None], jnp.linspace(0, 1, 5)[None, :])
    assert w.shape == (4, 5, 3)
    assert_allclose(w[3, 2], references.direction(1.0, 0.5), atol=1e-15)


@pytest.mark.parametrize("theta", [0.0, 1e-12, 1e-8, np.pi - 1e-8, np.pi])
def test_angles_near_the_poles_are_exact_and_have_finite_gradients(theta):
    w = jb.spherical(theta, 0.0)
    assert_allclose(jb.to_spherical(w)[0], theta, rtol=1e-9, atol=1e-15)
    assert np.all(np.isfinite(jax.jacfwd(jb.to_spherical)(w)))
    assert np.all(np.isfinite(jax.jacrev(jb.to_spherical)(w)))


def test_at_the_pole_phi_is_zero():
    assert_array_equal(jb.to_spherical(jnp.array([0.0, 0.0, 1.0])), [0, 0])


def test_half_difference_angles_are_those_of_rotation_matrices():
    wi, wo = random_directions(200), random_directions(200)
    angles = np.stack(jb.to_half_difference(jnp.asarray(wi), jnp.asarray(wo)), axis=-1)
    expected = [references.half_difference(i, o) for i, o in zip(wi, wo, strict=True)]
    assert_allclose(angles, expected, atol=1e-12)


def test_half_difference_both_ways():
    wi, wo = jnp.asarray(random_directions(200)), jnp.asarray(random_directions(200))
    assert_allclose(
        np.stack(jb.from_half_difference(*jb.to_half_difference(wi, wo))), np.stack([wi, wo]), atol=1e-12
    )


def test_exchanging_the_directions_turns_phi_d_by_pi():
    wi, wo = (jnp.asarray(random_directions(50, lowest=0.0)) for _ in range(2))
    theta_h, phi_h, theta_d, phi_d = jb.to_half_difference(wi, wo)
    swapped = jb.to_half_difference(wo, wi)
    assert_allclose(np.stack(swapped[:3]), np.stack([theta_h, phi_h, theta_d]), atol=1e-12)
    assert_allclose(np.cos(swapped[3] - phi_d), -1, atol=1e-12)


def test_theta_d_is_half_the_angle_between_the_directions():
    wi, wo = random_directions(50), random_directions(50)
    theta_d = jb.to_half_difference(jnp.asarray(wi), jnp.asarray(wo))[2]
    assert_allclose(2 * theta_d, np.arccos(np.sum(wi * wo, axis=-1)), atol=1e-7)


SEAMS = {
    "both at the normal": ((0.0, 0.0), (0.0, 0.0)),
    "mirror pair": ((0.7, 0.0), (0.7, np.pi)),
    "backscattering": ((0.7, 0.3), (0.7, 0.3)),
    "both grazing": ((np.pi / 2, 0.0), (np.pi / 2, 1.0)),
    "one at the normal": ((0.0, 0.0), (0.5, 0.2)),
}


GRADIENTS = jax.jit(jax.jacrev(jb.to_half_difference, (0, 1)))


@pytest.mark.parametrize("pair", SEAMS.values(), ids=SEAMS)
def test_half_difference_is_finite_with_its_gradient_at_the_seams(pair):
    wi, wo = (jb.spherical(*angles) for angles in pair)
    assert np.all(np.isfinite(jnp.stack(jb.to_half_difference(wi, wo))))
    for jacobian in GRADIENTS(wi, wo):
        assert np.all(np.isfinite(jacobian))


def test_opposite_directions_have_no_half_vector():
    w = jb.spherical(0.4, 0.1)
    assert_array_equal(jb.half_vector(w, -w), np.zeros(3))
    assert np.all(np.isfinite(jax.jacfwd(jb.half_vector)(w, -w)))


def test_reflect_swaps_the_sides_of_the_normal():
    wi, m = random_directions(30), random_directions(30)
    wo = jb.reflect(jnp.asarray(wi), jnp.asarray(m))
    householder = 2 * m[:, :, None] * m[:, None, :] - np.eye(3)
    assert_allclose(wo, np.einsum("nij,nj->ni", householder, wi), atol=1e-14)


def test_frames_both_ways():
    rotation = references.rotation("z", 0.7) @ references.rotation("y", -0.4)
    s, t, n = (jnp.broadcast_to(axis, (20, 3)) for axis in rotation.T)
    world = random_directions(20)
    local = jb.to_frame(jnp.asarray(world), s, t, n)
    assert_allclose(local, world @ rotation, atol=1e-14)
    assert_allclose(jb.from_frame(local, s, t, n), world, atol=1e-14)


def test_leading_axes_broadcast():
    """A grid of viewers against one light; a user's JAX allows the promotion that these tests forbid."""
    wi, wo = jb.spherical(0.3, 0.0), jnp.asarray(random_directions(6, lowest=0.1))
    with jax.numpy_rank_promotion("allow"):
        assert jb.half_vector(wi, wo).shape == (6, 3)
        brdf = jb.ShiftedGammaBRDF(0.1, 0.2, 0.1, 0.5, 0.8, 0.1)
        assert jax.eval_shape(brdf, wi, wo).shape == (6,)


def test_safe_normalize():
    v = jnp.array([[0.0, 0, 0], [3.0, 0, 4.0]])
    assert_allclose(directions.safe_normalize(v), [[0, 0, 0], [0.6, 0, 0.8]])
    jacobian = jax.jacfwd(directions.safe_normalize)(v)
    assert_array_equal(jacobian[0, :, 0, :], np.zeros((3, 3)))
    n = np.array([0.6, 0, 0.8])
    assert_allclose(jacobian[1, :, 1, :], (np.eye(3) - np.outer(n, n)) / 5, atol=1e-15)
