"""What the distributions are to each other, and what holds for every parameter and direction."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import jaxbrdf as jb
from tests import references

N = references.direction(np.linspace(0, 1.5, 12), np.linspace(-3, 3, 12))
W = np.concatenate([N, -N])


@eqx.filter_jit
def density_and_area(ndf, m, w):
    return ndf(m), ndf.projected_area(w)


def assert_same(one, other, rtol=1e-9, atol=1e-13):
    for a, b in zip(density_and_area(one, N, W), density_and_area(other, N, W), strict=True):
        assert_allclose(a, b, rtol=rtol, atol=atol)


@pytest.mark.parametrize(
    ("form", "make"), [("beckmann", jb.Beckmann), ("trowbridge_reitz", jb.TrowbridgeReitz)]
)
@pytest.mark.parametrize("alphas", [(0.05, 0.5), (1e-5, 1.0)])
def test_smiths_lambda(form, make, alphas):
    """σ = cos θ (1 + Λ) with the Λ of the literature, by mpmath; σ(−w) = σ(w) − w·n."""
    _, area = density_and_area(make(*alphas), N, W)
    expected = [w[2] * (1 + references.smith_lambda(form, *alphas, w)) if w[2] < 1 else 1 for w in N]
    assert_allclose(area[: len(N)], expected, rtol=1e-13)
    assert_allclose(area[len(N) :], expected - N[:, 2], atol=1e-15)


def test_the_area_of_the_ellipsoid():
    parameters = (0.2, 0.6, 0.5, -0.3, 1.0)
    A = references.ellipsoid_matrix(*parameters)
    _, area = density_and_area(jb.Ellipsoid(*parameters), N, W)
    assert_allclose(area, [references.ellipsoid_area(A, w) for w in W], rtol=1e-13, atol=1e-15)
    assert np.max(W[:, 2] / np.asarray(area)) > 1  # skewed: masking alone clips it


def test_an_upright_ellipsoid_is_trowbridge_reitz():
    assert_same(jb.Ellipsoid(0.1, 0.4, 0.0, 0.0, 0.0), jb.TrowbridgeReitz(0.1, 0.4))


def test_an_ellipsoid_turned_by_a_right_angle_has_its_axes_exchanged():
    assert_same(jb.Ellipsoid(0.1, 0.4, 0.0, 0.0, np.pi / 2), jb.TrowbridgeReitz(0.4, 0.1))


def test_one_roughness_is_two_alike():
    for make in (jb.Beckmann, jb.TrowbridgeReitz, jb.GaussianMicrofacets):
        assert make(0.3).is_isotropic
        assert not make(0.3, 0.3).is_isotropic
        assert len(jax.tree.leaves(make(0.3))) == 1
        assert_same(make(0.3), make(0.3, 0.3))


def test_student_t_spans_trowbridge_reitz_to_beckmann():
    assert_same(jb.StudentT(0.3, 2.0), jb.TrowbridgeReitz(0.3))
    assert_same(jb.StudentT(0.9, 1e5), jb.Beckmann(0.9), rtol=1e-3, atol=1e-9)


def test_student_t_near_beckmann_approaches_it_like_one_over_gamma():
    beckmann = density_and_area(jb.Beckmann(0.5), N, W)[1]
    gap = [np.max(np.abs(density_and_area(jb.StudentT(0.5, g), N, W)[1] - beckmann)) for g in (1e3, 1e4)]
    assert 9 < gap[0] / gap[1] < 11


def test_blinn_phong_is_a_student_t():
    """(γ − 1) α² = 1, γ = (e + 4)/2."""
    e = 37.0
    gamma = (e + 4) / 2
    assert_same(jb.BlinnPhong(e), jb.StudentT(1 / np.sqrt(gamma - 1), gamma))


def test_equal_exponents_are_blinn_phong():
    assert_same(jb.AnisotropicPhong(20.0, 20.0), jb.BlinnPhong(20.0), rtol=1e-6)


def test_a_cylinder_is_a_gaussian_without_end():
    assert_same(jb.GaussianCylinder(0.3), jb.GaussianMicrofacets(0.3, np.inf))
    assert_same(jb.GaussianCylinder(0.3), jb.GaussianMicrofacets(0.3, 1e9), rtol=1e-6)


def test_grooves_without_an_angle_are_flat():
    assert_same(jb.VGrooves(0.0, 0.3), jb.GaussianMicrofacets(0.3))


def test_upright_velvet_is_half_a_cylinder():
    half = density_and_area(jb.GaussianCylinder(0.5), N, W)
    for a, b in zip(density_and_area(jb.SlantedVelvet(0.0, 0.5), N, W), half, strict=True):
        assert_allclose(a, b / 2, rtol=1e-12, atol=1e-15)


def test_satin():
    """Ashikhmin 2000, section 6.3: areas of 0.7 and 0.3, whatever they sum to; D and σ are sums."""
    parts = [jb.GaussianCylinder(0.1), jb.GaussianCylinder(0.3)]
    satin = jb.mixture([0.7, 0.3], parts)
    shares = references.mixture_shares([0.7, 0.3], [(0.1, np.inf), (0.3, np.inf)])
    assert_allclose(satin.shares, shares, atol=1e-5)
    assert_allclose(jb.mixture([7.0, 3.0], parts).shares, satin.shares, rtol=1e-12)
    sums = [shares @ np.stack(pair) for pair in zip(*(density_and_area(p, N, W) for p in parts), strict=True)]
    for a, b in zip(density_and_area(satin, N, W), sums, strict=True):
        assert_allclose(a, b, rtol=2e-5, atol=1e-15)


def test_the_student_t_of_infinite_mean_slope_has_no_projected_area():
    """γ ≤ 3/2: ⟨tan θ⟩ diverges, σ is infinite off the normal; D is what it is."""
    for gamma in (1.2, 1.5):
        D, area = density_and_area(jb.StudentT(0.3, gamma), N, N[1:])
        assert_allclose(D, references.student_t(0.3, gamma)(N), rtol=1e-12)
        assert np.all(np.isposinf(area))
    assert np.all(np.isfinite(density_and_area(jb.StudentT(0.3, 1.51), N, N[1:])[1]))


# Every parameter, every direction

alpha = st.floats(-5, 0.5).map(lambda x: 10**x)
angle = st.floats(-0.7, 0.7)
turn = st.floats(-np.pi, np.pi)
PARAMETERS = {
    jb.Beckmann: st.tuples(alpha, alpha),
    jb.TrowbridgeReitz: st.tuples(alpha, alpha),
    jb.Ellipsoid: st.tuples(alpha, alpha, angle, angle, turn),
    jb.StudentT: st.tuples(alpha, st.floats(1.55, 60)),
}
direction = st.builds(references.direction, st.floats(0, np.pi), turn)


@eqx.filter_jit
def at_directions(make, parameters, w):
    ndf = make(*parameters)
    return ndf(w), ndf.projected_area(w)


@pytest.mark.parametrize("make", PARAMETERS, ids=lambda make: make.__name__)
def test_a_projected_area_is_a_support_function(make):
    """D ≥ 0; σ(w) ≥ max(0, w·⟨m⟩), ⟨m⟩ being σ's odd part on the axes; σ is subadditive, as ∫ (w·m)+ is."""

    @settings(max_examples=40, deadline=None)
    @given(PARAMETERS[make], direction, direction)
    def check(parameters, a, b):
        between = a + b
        length = np.linalg.norm(between)
        assume(length > 1e-3)
        w = np.concatenate([np.eye(3), -np.eye(3), [a, b, -a, -b, between / length]])
        D, area = (np.asarray(x) for x in at_directions(make, jnp.array(parameters), jnp.asarray(w)))
        mean = area[:3] - area[3:6]
        tolerance = 1e-13 * (1 + area.max())
        assert np.all(D >= 0)
        assert_allclose(mean[2], 1, rtol=1e-12)
        assert_allclose(area[6:8] - area[8:10], w[6:8] @ mean, atol=tolerance)
        assert np.all(area >= np.maximum(w @ mean, 0) - tolerance)
        assert area[10] * length <= area[6] + area[7] + tolerance

    check()
