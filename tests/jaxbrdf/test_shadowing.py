"""Every shadowing term by every property, and each formula against digits, rays or a mean over heights."""

import importlib.util
from functools import cache
from math import erf
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad

import jaxbrdf as jb
from jaxbrdf.shadowing import AzimuthCorrelated, FreeTravel, HeightCorrelated, Unshadowed, VCavity
from tests import references

THETA = np.array([0.0, 0.3, 1.0, 1.4, 1.55, np.pi / 2 - 1e-9])
W = jb.spherical(jnp.asarray(THETA), 0.4)
LOBES = [(1e-5, 0.5), (0.05, 1.0), (1.0, 0.0)]
MIRROR_LIKE = (31.0579, 1.63655e109, 251.7)  # the published c reaches 1e109


@eqx.filter_jit
def evaluate(function, *arguments):
    return function(*arguments)


@jax.jit
def gradients(alpha, p, w):
    return jax.jacrev(lambda a, p, w: jb.smith_G1(jb.ShiftedGamma(a, p), w), (0, 1, 2))(alpha, p, w)


@pytest.mark.parametrize(("alpha", "p"), LOBES)
def test_smith_is_cosine_over_projected_area(alpha, p):
    G1 = evaluate(jb.smith_G1, jb.ShiftedGamma(alpha, p), W)
    density = references.sgd(alpha, p)
    expected = [w[2] / references.projected_area(density, w) for w in references.direction(THETA, 0.4)]
    assert_allclose(G1, np.minimum(expected, 1), rtol=1e-8)
    assert np.all((G1 >= 0) & (G1 <= 1))
    assert np.all(np.diff(G1) <= 1e-15)


@pytest.mark.parametrize(("alpha", "p"), LOBES)
def test_smith_at_and_below_the_horizon_is_zero_with_finite_gradients(alpha, p):
    w = jnp.array([[1.0, 0.0, 0.0], [0.6, 0.0, -0.8], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    value = evaluate(jb.smith_G1, jb.ShiftedGamma(alpha, p), w)
    assert_array_equal(value[:3], 0)
    assert_allclose(value[3], 1, rtol=1e-15)
    for gradient in gradients(alpha, p, w):
        assert np.all(np.isfinite(gradient))


def test_uncorrelated_is_the_product_of_both_maskings():
    ndf = jb.ShiftedGamma(jnp.array([0.1, 0.3]), 0.5)
    wi, wo = W, W[::-1]
    G = evaluate(jb.Uncorrelated(), ndf, wi, wo)
    assert G.shape == (len(THETA), 2)
    density = references.sgd(0.3, 0.5)
    masks = np.array([w[2] / references.projected_area(density, w) for w in references.direction(THETA, 0.4)])
    assert_allclose(G[:, 1], masks * masks[::-1], rtol=1e-8)


def approximation(lam, c, k):
    return jb.ShiftedGammaShadowing(jnp.array(lam), jnp.array(c), jnp.array(k))


@pytest.mark.parametrize(
    ("lam", "c", "k"),
    [(2.60672, 1.12717e-07, 47.783), (1.5, 0.8, 5.57), MIRROR_LIKE, (1.5e7, 3e-8, 12.0), (4.5e-8, 5e3, 20.0)],
    ids=["alum-bronze", "rough", "mirror-like", "large lambda", "small lambda"],
)
def test_approximation_is_equation_9_in_50_digits(lam, c, k):
    shadowing = approximation(lam, c, k)
    truth = [references.mask_approximation(t, lam, c, k) for t in THETA]
    assert_allclose(shadowing.theta_0, truth[0][1], rtol=1e-12)
    value = shadowing.G1(jnp.asarray(np.cos(THETA)))
    assert_allclose(value, [g for g, _ in truth], rtol=1e-9, atol=3e-7)
    assert np.all((value >= 0) & (value <= 1))


@pytest.mark.parametrize("parameters", [(2.6, 1e-7, 47.8), MIRROR_LIKE], ids=["bronze", "mirror-like"])
def test_approximation_at_its_seams(parameters):
    """0 at and below the horizon, 1 up to θ_0, and finite gradients at each, and at the normal."""
    shadowing = approximation(*parameters)
    at_theta_0 = jnp.cos(shadowing.theta_0)
    cos = jnp.stack([jnp.array(0.0), jnp.array(-0.5), at_theta_0, jnp.array(1.0), at_theta_0 * 0.999])
    value = shadowing.G1(cos)
    assert_array_equal(value[:2], 0)
    assert_allclose(value[2:4], 1, atol=1e-12)
    for leaf in jax.tree.leaves(jax.jit(jax.jacrev(lambda s, x: s.G1(x), (0, 1)))(shadowing, cos)):
        assert np.all(np.isfinite(leaf))


def test_approximation_multiplies_both_directions_and_does_not_ask_the_distribution():
    shadowing = approximation(2.6, 1e-7, 47.8)
    G = shadowing(jb.ShiftedGamma(0.5, 0.5), W[3], W[4])
    one, other = (references.mask_approximation(t, 2.6, 1e-7, 47.8)[0] for t in THETA[3:5])
    assert_allclose(G, one * other, rtol=1e-10)


def test_approximation_is_close_to_smith_for_a_published_material():
    """alum-bronze, red: the paper's fit of eq. 9 to G1 stays within 1e-2 up to 85°, as its Fig. 5 shows."""
    theta = np.linspace(0, np.deg2rad(85), 18)
    w = jb.spherical(jnp.asarray(theta), 0.0)
    smith = evaluate(jb.smith_G1, jb.ShiftedGamma(0.014832, 0.459076), w)
    approximate = approximation(2.60672, 1.12717e-07, 47.783).G1(w[:, 2])
    assert_allclose(approximate, smith, atol=1e-2)


def trowbridge_reitz_area(alpha, cos):
    return (cos + (cos**2 + alpha**2 * (1 - cos**2)) ** 0.5) / 2


class Projected(jb.AbstractNDF):
    """A distribution known by its projected area alone: `scale` times that of Trowbridge and Reitz."""

    alpha: jax.Array = eqx.field(converter=jnp.asarray)
    scale: jax.Array = eqx.field(converter=jnp.asarray, default=1.0)

    @property
    def is_isotropic(self):
        return True

    def _density(self, m):
        raise NotImplementedError

    def _sample(self, u):
        raise NotImplementedError

    def _projected_area(self, w):
        return self.scale * trowbridge_reitz_area(self.alpha, w[..., 2])


TERMS = {
    "unshadowed": Unshadowed(),
    "uncorrelated": jb.Uncorrelated(),
    "height": HeightCorrelated(),
    "azimuth": AzimuthCorrelated(),
    "cavity": VCavity(),
    "travel": FreeTravel(2.0),
    "gamma": jb.ShiftedGammaShadowing(2.6, 1e-7, 47.8),
}
ROUGH = Projected(0.6)
every_term = pytest.mark.parametrize("name", TERMS)


def random_pairs(count=300):
    rng = np.random.default_rng(5)
    theta, phi = np.arccos(1 - rng.random((2, count))), rng.uniform(-np.pi, np.pi, (2, count))
    return references.direction(theta, phi)


def seams():
    """Pairs at which a formula could break: horizon, normal, equal, opposite, equal and opposite azimuths."""
    n, x, w = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), references.direction(1.0, 0.4)
    grazing = [np.array([1.0, 0.0, c]) for c in (0.0, 1e-30, 1e-12, 1e-7, 1e-4)]
    level = references.direction(1.0, 0.0)
    others = [
        (n, n),
        (n, w),
        (np.array([1e-9, 0.0, 1.0]), w),
        (np.array([1e-30, 0.0, 1.0]), np.array([-1e-30, 0.0, 1.0])),
        (np.array([1e-12, 0.0, 1.0]), np.array([0.0, 1e-12, 1.0])),
        (w, w),
        (w, -w),
        (-w, -w),
        (-n, n),
        (np.zeros(3), n),
        (w, references.direction(0.3, 0.4)),
        (level, references.direction(1.0, np.pi)),
        (level, level * [-1, 1, 1]),
        (references.direction(0.3, 0.0), level * [-1, -1, 1]),
    ]
    mirrored = [(g, g * [-1, 1, 1]) for g in grazing]
    return np.swapaxes(
        [*others, *mirrored, *((g, g) for g in grazing), *((g, w) for g in grazing), (x, -x)], 0, 1
    )


@eqx.filter_jit
def value_and_gradients(term, ndf, wi, wo):
    def total(models):
        term, ndf, wi, wo = models
        return jnp.sum(term(ndf, wi, wo))

    return term(ndf, wi, wo), eqx.filter_grad(total)((term, ndf, wi, wo))


def cast(tree, dtype):
    return jax.tree.map(lambda a: jnp.asarray(a, dtype), tree)


@every_term
def test_every_term_is_a_fraction_symmetric_and_zero_at_and_below_the_horizon(name):
    wi, wo = np.concatenate([random_pairs(), seams()], axis=1)
    G = evaluate(TERMS[name], ROUGH, wi, wo)
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    assert np.all((G >= 0) & (G <= 1))
    assert np.all(G[above & (wi[:, 2] > 0.1) & (wo[:, 2] > 0.1)] > 0)
    assert_array_equal(G[~above], 0)
    assert_allclose(evaluate(TERMS[name], ROUGH, wo, wi), G, rtol=1e-14)
    assert_allclose(G[300], 1, rtol=1e-14)  # both at the normal


@every_term
@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_every_term_has_finite_gradients_at_the_seams_in_its_own_precision(name, dtype):
    value, gradients = value_and_gradients(*cast((TERMS[name], ROUGH, *seams()), dtype))
    assert value.dtype == dtype
    assert np.all(np.isfinite(value))
    for leaf in jax.tree.leaves(gradients):
        assert leaf.dtype == dtype
        assert np.all(np.isfinite(leaf))


@every_term
def test_every_term_in_single_precision_is_the_term(name):
    arguments = (TERMS[name], ROUGH, *random_pairs())
    assert_allclose(evaluate(*cast(arguments, jnp.float32)), evaluate(*arguments), atol=2e-5)


@pytest.mark.parametrize(
    ("term", "ndf"),
    [
        (lambda c: jb.Uncorrelated(), lambda c: Projected(0.2 * c)),
        (lambda c: HeightCorrelated(), lambda c: Projected(0.2 * c)),
        (lambda c: AzimuthCorrelated(0.2 * c), lambda c: ROUGH),
        (lambda c: AzimuthCorrelated(0.2 * c), lambda c: Projected(0.2 * c)),
        (lambda c: FreeTravel(c), lambda c: ROUGH),
        (lambda c: jb.ShiftedGammaShadowing(c, 0.8, 5.57), lambda c: ROUGH),
    ],
)
def test_channels_of_the_term_and_of_the_distribution_trail(term, ndf):
    wi, wo = random_pairs(4)
    c = jnp.array([1.0, 2.0, 3.0])
    G = evaluate(term(c), ndf(c), wi, wo)
    assert G.shape == (4, 3)
    for j in range(3):
        assert_allclose(G[:, j], evaluate(term(c[j]), ndf(c[j]), wi, wo), rtol=1e-13)


def test_channels_of_a_distribution_that_is_not_asked_are_there_all_the_same():
    wi, wo = random_pairs(4)
    for term in (Unshadowed(), VCavity(), FreeTravel(2.0)):
        G = evaluate(term, Projected(jnp.ones(3)), wi, wo)
        assert_allclose(G, np.stack([evaluate(term, ROUGH, wi, wo)] * 3, axis=-1))


@every_term
def test_directions_broadcast_and_vmap(name):
    wi, wo = random_pairs(4)

    def calls(term, ndf, wi, wo):
        stack = jnp.stack([wo, wo])
        return term(ndf, wi, wo), jax.vmap(term, (None, 0, 0))(ndf, wi, wo), term(ndf, wi[0], stack)

    G, mapped, stacked = evaluate(calls, TERMS[name], ROUGH, wi, wo)
    assert_allclose(mapped, G, rtol=1e-13)
    assert stacked.shape == (2, 4)
    assert_allclose(stacked[:, 0], [G[0]] * 2, rtol=1e-13)


def test_a_batch_of_terms_is_a_vmap_over_their_leaves():
    wi, wo = random_pairs(5)
    terms = jax.vmap(FreeTravel)(jnp.array([0.5, 1.0, 4.0]))
    G = evaluate(jax.vmap(lambda term, wi, wo: term(ROUGH, wi, wo), (0, None, None)), terms, wi, wo)
    assert G.shape == (3, 5)
    assert_allclose(G[2], evaluate(FreeTravel(4.0), ROUGH, wi, wo), rtol=1e-13)


@every_term
def test_directions_of_wrong_length_or_shape_are_refused(name):
    n = np.array([0.0, 0.0, 1.0])
    with pytest.raises(ValueError, match="wi must hold unit vectors"):
        TERMS[name](ROUGH, 2 * n, n)
    with pytest.raises(ValueError, match="wo must hold directions"):
        TERMS[name](ROUGH, n, n[:2])


@pytest.mark.parametrize("value", [0.0, -1.0, [1.0, 0.0, 1.0]])
def test_width_and_smoothness_must_be_positive(value):
    with pytest.raises(ValueError, match="width must be greater than 0"):
        AzimuthCorrelated(value)
    with pytest.raises(ValueError, match="smoothness must be greater than 0"):
        FreeTravel(value)


@pytest.mark.parametrize("alpha", [0.05, 0.4, 1.0])
def test_smith_over_gaussian_slopes_is_the_closed_form_and_what_drawn_facets_show(alpha):
    """ShiftedGamma(α², 0) is Beckmann's distribution: slopes of variance α²/2 each way."""
    theta = np.array([0.5, 1.2, 1.5])
    a = 1 / (alpha * np.tan(theta))
    Lambda = (np.array([erf(v) for v in a]) - 1) / 2 + np.exp(-(a**2)) / (2 * a * np.sqrt(np.pi))
    G1 = evaluate(jb.smith_G1, jb.ShiftedGamma(alpha**2, 0.0), jb.spherical(theta, 0.0))
    assert_allclose(G1, 1 / (1 + Lambda), rtol=1e-8)
    slope = np.random.default_rng(1).standard_normal(400_000) * alpha / np.sqrt(2)
    facing = np.maximum(np.cos(theta)[:, None] - np.sin(theta)[:, None] * slope, 0)  # (w·m)+ / (m·n)
    error = facing.std(axis=1) / np.sqrt(slope.size) / np.cos(theta)
    assert np.all(np.abs(1 / np.asarray(G1) - facing.mean(axis=1) / np.cos(theta)) < 4 * error)


def test_height_correlated_is_the_average_over_one_height_for_both_directions():
    """From a point above a share u of the surface, a direction sees out with probability u^Λ."""
    wi, wo = references.direction(np.array([[0.4, 1.45, 1.5], [1.2, 1.3, 0.1]]), 0.3)
    G = evaluate(HeightCorrelated(), jb.ShiftedGamma(0.3, 0.5), wi, wo)
    density = references.sgd(0.3, 0.5)
    both = [
        sum(references.projected_area(density, w) / w[2] - 1 for w in pair)
        for pair in zip(wi, wo, strict=True)
    ]
    expected = [quad(lambda u, exponent=e: u**exponent, 0, 1)[0] for e in both]
    assert_allclose(G, expected, rtol=1e-7)


def test_height_correlated_never_counts_negative_masking():
    """σ < w·n near the normal: Λ is 0 there, and G is G1 of the other direction."""
    low = Projected(0.6, 0.5)
    theta = np.array([0.2, 1.5])
    steep, flat = references.direction(theta, 0.1)
    Lambda = 0.5 * trowbridge_reitz_area(0.6, np.cos(theta)) / np.cos(theta) - 1
    assert Lambda[0] < 0 < Lambda[1]
    G = evaluate(HeightCorrelated(), low, steep, np.stack([flat, steep]))
    assert_allclose(G, [1 / (1 + Lambda[1]), 1], rtol=1e-13)


def ashikhmin(alpha, width, wi, wo):
    """Eq. 14, with azimuths from the complex plane."""
    a, b = (w[..., 2] / trowbridge_reitz_area(alpha, w[..., 2]) for w in (wi, wo))
    phi = np.angle((wi[..., 0] + 1j * wi[..., 1]) / (wo[..., 0] + 1j * wo[..., 1]))
    t = np.exp(-(phi**2) / (2 * width**2))
    return (1 - t) * a * b + t * np.minimum(a, b)


def test_azimuth_correlated_is_equation_14():
    wi, wo = random_pairs()
    for width in (np.radians(15), 1.0):
        expected = ashikhmin(0.6, width, wi, wo)
        assert_allclose(evaluate(AzimuthCorrelated(width), ROUGH, wi, wo), expected, rtol=1e-12)
    assert_allclose(AzimuthCorrelated().width, np.pi / 12, rtol=1e-15)


def test_azimuth_correlated_between_its_limits():
    theta = np.array([1.3, 0.9])
    a, b = np.cos(theta) / trowbridge_reitz_area(0.6, np.cos(theta))
    wi, same = references.direction(theta, 2.0)
    opposite = references.direction(theta[1], 2.0 - np.pi)
    steep = references.direction(np.array([1e-12, 1e-6]), 1.0)
    wo = np.stack([same, opposite, *steep])
    assert_allclose(evaluate(AzimuthCorrelated(), ROUGH, wi, wo), [a, a * b, a, a], rtol=1e-11)
    assert_allclose(evaluate(AzimuthCorrelated(1e9), ROUGH, wi, wo), a, rtol=1e-11)
    assert a < b


@pytest.mark.parametrize("phi", [1e-9, 0.2, 3.0])
def test_azimuth_correlated_by_azimuth_and_width(phi):
    def G(phi, width):
        return AzimuthCorrelated(width)(ROUGH, jb.spherical(1.3, 0.5), jb.spherical(0.9, 0.5 + phi))

    def truth(phi, width):
        return ashikhmin(0.6, width, references.direction(1.3, 0.5), references.direction(0.9, 0.5 + phi))

    d = 1e-6
    expected = [
        (truth(phi + d, 0.6) - truth(phi - d, 0.6)) / (2 * d),
        (truth(phi, 0.6 + d) - truth(phi, 0.6 - d)) / (2 * d),
    ]
    assert_allclose(jax.jit(jax.grad(G, (0, 1)))(phi, 0.6), expected, atol=1e-9)


def traced_groove(wi, wo, points=20_000):
    """The share of points, on a wall of a symmetric V-groove whose normal is h, that both rays leave freely.

    Across the groove the wall comes down from (−run, rise) to (0, 0), and the other goes up to (run, rise).
    """
    h = (wi + wo) / np.linalg.norm(wi + wo)
    run, rise = h[2], np.hypot(h[0], h[1])
    across = np.array([h[0], h[1], 0]) / rise
    up = (np.arange(points) + 0.5) / points
    free = np.ones(points, bool)
    for w in (wi, wo):
        if w @ across > 0:
            free &= up * rise + (run + up * run) * w[2] / (w @ across) > rise
    return free.mean()


def test_cavity_is_a_traced_groove():
    wi, wo = random_pairs(60)
    traced = [traced_groove(i, o) for i, o in zip(wi, wo, strict=True)]
    assert np.sum(np.array(traced) < 0.99) > 20
    assert_allclose(evaluate(VCavity(), ROUGH, wi, wo), traced, atol=1e-4)


def test_cavity_does_not_mask_flat_facets():
    theta = np.array([0.0, 1.0, np.pi / 2 - 1e-3, np.pi / 2 - 1e-9])
    wi, wo = references.direction(theta, 1.0), references.direction(theta, 1.0 + np.pi)
    G = evaluate(VCavity(), ROUGH, wi, wo)
    assert_allclose(G, 1, rtol=1e-15)


def probability_and_slope(term, theta):
    def gamma(theta):
        return term.probability(jnp.cos(theta))

    return jax.jvp(gamma, (theta,), (jnp.ones_like(theta),))


@pytest.mark.parametrize("s", [1e-3, 0.1, 1.0, 5.0, 1e3])
def test_free_travel_is_equation_3_4_23(s):
    theta = np.array([1e-3, 0.02, 0.3, 1.0, 1.4, 1.57])

    def gamma(t):
        tan, root = mpmath.tan(t), mpmath.sqrt(2 * mpmath.pi)
        return mpmath.exp(-tan / (root * s) * mpmath.exp(-((s / tan) ** 2) / 4))

    with mpmath.workdps(30):
        expected = [float(gamma(mpmath.mpf(t))) for t in theta]
        expected_slope = [float(mpmath.diff(gamma, mpmath.mpf(t))) for t in theta]
    value, slope = evaluate(probability_and_slope, FreeTravel(s), theta)
    assert_allclose(value, expected, rtol=1e-9, atol=1e-14)
    assert_allclose(slope, expected_slope, rtol=1e-8, atol=1e-12)


def test_free_travel_multiplies_both_directions_and_does_not_ask_the_distribution():
    wi, wo = random_pairs(50)
    tan = np.sqrt(1 / np.stack([wi, wo])[..., 2] ** 2 - 1)
    expected = np.exp(-np.sum(tan * np.exp(-0.49 / 4 / tan**2), axis=0) / np.sqrt(2 * np.pi) / 0.7)
    assert_allclose(evaluate(FreeTravel(0.7), Projected(np.nan), wi, wo), expected, rtol=1e-12)


def value_and_slopes(method, smoothness, cos):
    """Γ and its derivatives by smoothness and by cos θ, each (smoothness, cos)."""
    one = jax.value_and_grad(lambda s, c: method(FreeTravel(s), c), (0, 1))
    return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(smoothness, cos)


@pytest.mark.parametrize("method", [FreeTravel.probability, lambda term, c: term.probability_from(0.0, c)])
def test_free_travel_at_the_normal_at_the_horizon_and_below(method):
    cos = jnp.array([1.0, 1 - 1e-12, 0.0, 1e-80, -0.5, 1e-12, 1e-40])
    value, gradients = evaluate(value_and_slopes, method, jnp.array([1e-6, 1.0, 1e6]), cos)
    assert_allclose(value[:, 0], 1, rtol=1e-15)
    assert_array_equal(value[:, 2:5], 0)
    assert_allclose(value[:, 6], 0, atol=1e-15)
    for gradient in gradients:
        assert np.all(np.isfinite(gradient))


@cache
def blockings(h, a, digits=25):
    """∫_0^∞ Q(ξ) dξ from a height h at steepness a = s cot θ, in mpmath."""
    with mpmath.workdps(digits):
        h, a = mpmath.mpf(h), mpmath.mpf(a)

        def Q(x):
            rise = -mpmath.expm1(-x * x)  # 1 − C
            return mpmath.erfc((h * rise + a * x) / mpmath.sqrt(2 * rise * (2 - rise))) / 2

        end = max(mpmath.mpf(8), (12 - h) / a)
        far = [8 * (end / 8) ** (mpmath.mpf(k) / 8) for k in range(1, 9)]
        ends = [mpmath.mpf("1e-15"), 0.05, 0.2, 0.5, 1, 2, 4, 8, *far]
        return float(mpmath.quad(Q, ends, maxdegree=5))


HEIGHTS = [(0, 0.05), (0, 0.5), (0, 1.754), (0, 6.0), (-2, 0.3), (-8, 3.0), (1, 0.1), (2.5, 0.01), (8, 1.0)]


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_free_travel_from_a_height_is_the_integral_in_25_digits(dtype):
    h, a = np.transpose(HEIGHTS)
    term, h, cos = cast((FreeTravel(0.7), h, np.cos(np.arctan(0.7 / a))), dtype)
    value = evaluate(lambda term, h, c: term.probability_from(h, c), term, h, cos)
    assert value.dtype == dtype
    expected = np.exp([-blockings(*pair) for pair in HEIGHTS])
    assert_allclose(value, expected, rtol=0, atol=1e-13 if dtype == jnp.float64 else 1e-5)


def test_free_travel_from_a_height_by_height_and_smoothness():
    """∂Γ/∂h and ∂Γ/∂s are Γ times ∫ φ(w) (1 − C)/√(1 − C²) dξ and ∫ φ(w) ξ cot θ/√(1 − C²) dξ."""
    s, theta = 0.7, 0.9
    cot = 1 / np.tan(theta)

    def integral(h, factor):
        def integrand(x):
            rise = -np.expm1(-x * x)  # 1 − C
            root = np.sqrt(rise * (2 - rise))
            w = (h * rise + x * s * cot) / root
            return np.exp(-w * w / 2) / np.sqrt(2 * np.pi) * factor(x, rise) / root

        return quad(integrand, 0, 40, epsabs=1e-13, limit=200, points=[1, 4])[0]

    by_both = jax.jit(jax.grad(lambda h, s: FreeTravel(s).probability_from(h, np.cos(theta)), (0, 1)))
    for h in (0.0, -1.0, 2.0):
        gamma = np.exp(-blockings(h, s * cot))
        expected = [integral(h, lambda x, rise: rise), integral(h, lambda x, rise: x * cot)]
        assert_allclose(by_both(h, s), gamma * np.array(expected), rtol=1e-9)


def test_free_travel_from_heights_broadcasts_and_has_channels():
    def gamma(s, h, cos):
        return FreeTravel(s).probability_from(h, cos)

    h, cos = np.array([[-1.0], [0.0], [1.0], [2.0]]), np.array([0.2, 0.5])
    value = evaluate(gamma, jnp.array([0.5, 1.0, 2.0]), h, cos)
    assert value.shape == (4, 2, 3)
    assert_allclose(value[3, 1, 2], evaluate(gamma, jnp.array(2.0), h[3, 0], cos[1]), rtol=1e-13)
    assert np.all(np.diff(value, axis=0) > 0)


@pytest.fixture(scope="module")
def benchmark():
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "free_travel.py"
    spec = importlib.util.spec_from_file_location("free_travel", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_benchmark_counts_rays_as_a_long_profile_does(benchmark):
    """Rays from the first points of conditioned profiles, against all crossings and the horizon ahead."""
    rng = np.random.default_rng(3)
    limit, slope, _ = benchmark.trace(rng, 8000)
    a = np.array([0.3, 0.9, 1.7])
    _, by_crossing, _ = benchmark.escaping(limit, slope, a)
    z, start = benchmark.profiles(rng, 60)
    step = benchmark.STEP
    assert_allclose(z.std(), 1, atol=0.03)
    assert_allclose(np.mean(z[:, :-32] * z[:, 32:]), np.exp(-1), atol=0.03)  # at a distance of 1
    assert_allclose((z[:, 1] - z[:, -1]) / (2 * step), start, atol=0.02)
    x = step * np.arange(z.shape[1])
    half = len(x) // 2
    for a_k, share in zip(a, by_crossing, strict=True):
        ahead = np.flip(np.maximum.accumulate(np.flip(z - a_k * x, 1), axis=1), 1)
        row, i = np.nonzero(np.signbit(z[:, :half]) != np.signbit(z[:, 1 : half + 1]))
        crossing = x[i] + step * z[row, i] / (z[row, i] - z[row, i + 1])
        assert_allclose(np.mean(ahead[row, i + 1] <= -a_k * crossing), share, atol=0.04)


def test_the_benchmark_prints_draws_and_writes(benchmark, monkeypatch, tmp_path, capsys):
    files = ["--csv", str(tmp_path / "curves.csv"), "--figure", str(tmp_path / "figure.png")]
    monkeypatch.setattr("sys.argv", ["free_travel.py", "--rays", "200", *files])
    monkeypatch.setattr(benchmark, "THETA", np.radians([10, 45, 80]))
    benchmark.main()
    assert "by crossing" in capsys.readouterr().out
    lines = (tmp_path / "curves.csv").read_text().splitlines()
    assert len(lines) == 1 + 6 * 3
    gamma = np.exp(-np.tan(np.radians(45)) / (np.sqrt(2 * np.pi) * 0.1) * np.exp(-(0.1**2) / 4))
    assert_allclose([float(v) for v in lines[2].split(",")[:3]], [0.1, 45, gamma], rtol=1e-12)
    assert (tmp_path / "figure.png").stat().st_size > 10_000
