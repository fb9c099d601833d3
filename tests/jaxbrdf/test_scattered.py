"""Scattered samples: interpolated against closed forms and symmetries, integrated by other means."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import ConvexHull

import jaxbrdf as jb
from jaxbrdf.scattered import interpolate, sample_albedos

NORMAL = np.array([0.0, 0.0, 1.0])
MIRROR = np.array([1.0, -1.0, 1.0])  # about the plane y = 0
CORNELL = ["garnet_red", "krylon_blue"]
MINIDIFF = ["C1_White", "C8_Silver", "C10_Copper", "Metal_Blue"]


def hemisphere(count, seed, lowest=0.2):
    """Random directions of density ∝ cos θ, with cos θ > lowest."""
    rng = np.random.default_rng(seed)
    z, phi = np.sqrt(rng.uniform(lowest**2, 1, count)), rng.uniform(-np.pi, np.pi, count)
    return np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], axis=-1)


def turned(w, angle):
    x, y, z = np.moveaxis(w, -1, 0)
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def measured(wi, wo, values, weights=None):
    angles = [
        angle
        for w in (wi, wo)
        for angle in (np.arctan2(np.hypot(*w.T[:2]), w[:, 2]), np.arctan2(*w.T[1::-1]))
    ]
    weights = np.ones(len(wi)) if weights is None else weights
    return jb.MeasuredSamples(
        *angles, values if np.ndim(values) == 2 else np.asarray(values)[:, None], weights
    )


def ggx(*alpha):
    return jb.Lambertian(jnp.array([0.1, 0.4])) + jb.Microfacet(
        jb.TrowbridgeReitz(*alpha), jb.Schlick(0.5), jb.HeightCorrelated()
    )


def sampled(brdf, count, seed=0):
    wi, wo = hemisphere(count, seed), hemisphere(count, seed + 1)
    return measured(wi, wo, np.asarray(brdf(wi, wo)))


@pytest.fixture(scope="module")
def noise():
    """Samples that no reflectance has, at 500 pairs in two channels."""
    values = np.random.default_rng(5).lognormal(size=(500, 2))
    return measured(hemisphere(500, 3), hemisphere(500, 4), values)


@pytest.mark.parametrize("isotropic", [True, False])
def test_exact_at_the_samples_and_their_exchange(noise, isotropic):
    for wi, wo in ((noise.wi, noise.wo), (noise.wo, noise.wi)):
        assert_allclose(interpolate(noise, wi, wo, isotropic=isotropic), noise.values, rtol=1e-7)


def test_exact_at_mirrored_and_turned_samples(noise):
    for wi, wo in ((noise.wi * MIRROR, noise.wo * MIRROR), (turned(noise.wi, 2.0), turned(noise.wo, 2.0))):
        assert_allclose(interpolate(noise, wi, wo), noise.values, rtol=1e-7)


@pytest.mark.parametrize("isotropic", [True, False])
def test_reciprocal_between_the_samples(noise, isotropic):
    wi, wo = hemisphere(300, 8), hemisphere(300, 9)
    there, back = (interpolate(noise, *pair, np.inf, isotropic) for pair in ((wi, wo), (wo, wi)))
    assert_allclose(there, back, rtol=1e-9)


def test_isotropic_between_the_samples(noise):
    wi, wo = hemisphere(300, 8), hemisphere(300, 9)
    f = interpolate(noise, wi, wo, np.inf)
    assert_allclose(interpolate(noise, wi * MIRROR, wo * MIRROR, np.inf), f, rtol=1e-9)
    assert_allclose(interpolate(noise, turned(wi, -0.7), turned(wo, -0.7), np.inf), f, rtol=1e-6)


@pytest.mark.parametrize("isotropic", [True, False])
def test_a_constant_stays_one(isotropic):
    samples = sampled(jb.Lambertian(jnp.array([0.5, 0.2])), 200)
    f = interpolate(samples, hemisphere(500, 8, 0.01), hemisphere(500, 9, 0.01), np.inf, isotropic)
    assert_allclose(f, np.broadcast_to(np.array([0.5, 0.2]) / np.pi, f.shape), rtol=1e-9)


def test_never_outside_the_values_of_the_samples(noise):
    f = interpolate(noise, hemisphere(2000, 8, 0.0), hemisphere(2000, 9, 0.0), np.inf)
    assert np.all((f >= noise.values.min(axis=0)) & (f <= noise.values.max(axis=0)))


@pytest.mark.parametrize("isotropic", [True, False])
@pytest.mark.parametrize("theta", [0.0, 0.6])
def test_continuous_where_angles_are_undefined(noise, isotropic, theta):
    """About θ_h = 0, wo being the mirror image of wi, and about θ_d = 0, where they are one."""
    wi = np.array([np.sin(theta), 0.0, np.cos(theta)])
    step = 1e-9 * np.stack([np.cos(np.arange(6.0)), np.sin(np.arange(6.0)), np.zeros(6)], axis=-1)
    for wo in (wi * [-1, 1, 1], wi):
        f = interpolate(noise, wi, wo, np.inf, isotropic)
        near = interpolate(noise, wi, wo + step, np.inf, isotropic)
        assert_allclose(near, np.broadcast_to(f, near.shape), rtol=2e-3)


@pytest.mark.parametrize(("count", "error"), [(1000, 0.03), (10_000, 0.01)])
def test_a_rough_ggx(count, error):
    """Median and root mean square of the relative error at α = 0.4."""
    brdf, wi, wo = ggx(0.4), hemisphere(1000, 8, 0.3), hemisphere(1000, 9, 0.3)
    relative = interpolate(sampled(brdf, count), wi, wo, np.inf) / np.asarray(brdf(wi, wo)) - 1
    assert np.median(np.abs(relative)) < error / 5
    assert np.sqrt(np.mean(relative**2)) < error


def test_an_anisotropic_ggx():
    brdf, wi, wo = ggx(0.2, 0.5), hemisphere(1000, 8, 0.4), hemisphere(1000, 9, 0.4)
    samples, truth = sampled(brdf, 10_000), np.asarray(brdf(wi, wo))
    error, blind = (
        np.median(np.abs(interpolate(samples, wi, wo, np.inf, i) / truth - 1)) for i in (False, True)
    )
    assert error < 0.01
    assert blind > 10 * error


def test_directions_broadcast(noise):
    wi, wo = hemisphere(4, 8)[:, None], hemisphere(3, 9)
    f = interpolate(noise, wi, wo, np.inf)
    assert f.shape == (4, 3, 2)
    assert_array_equal(f[2, 1], interpolate(noise, wi[2, 0], wo[1], np.inf))
    assert interpolate(noise, np.zeros((0, 3)), wo[:1]).shape == (0, 2)


def test_nan_beyond_the_reach():
    """All samples are near retroreflection at the normal."""
    samples = measured(hemisphere(200, 0, 0.99), hemisphere(200, 1, 0.99), np.ones(200))
    grazing = np.array([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]])
    assert np.all(np.isnan(interpolate(samples, *grazing)))
    assert_allclose(interpolate(samples, *grazing, np.inf), 1)
    assert_allclose(interpolate(samples, samples.wi, samples.wo, 0.0), 1)
    assert np.all(np.isnan(interpolate(samples, hemisphere(50, 2), hemisphere(50, 3), 1e-5)))


def test_the_default_reach_covers_what_is_sampled_throughout():
    f = interpolate(sampled(ggx(0.4), 1000), hemisphere(2000, 8, 0.3), hemisphere(2000, 9, 0.3))
    assert np.mean(np.isnan(f)) < 1e-3


def test_nan_at_and_below_the_horizon(noise):
    up, below = np.array([0.0, 0.0, 1.0]), np.array([[1.0, 0.0, 0.0], [0.6, 0.0, -0.8]])
    assert np.all(np.isnan(interpolate(noise, below, up, np.inf)))
    assert np.all(np.isnan(interpolate(noise, up, below, np.inf)))


def test_coincident_samples_are_averaged_by_weight():
    """A pair measured three times, as itself, exchanged and mirrored; and pairs measured 50 times."""
    wi, wo = hemisphere(40, 3), hemisphere(40, 4)
    pairs = [(wi, wo), (wo[:1], wi[:1]), (wi[:1] * MIRROR, wo[:1] * MIRROR)]
    wi, wo = (np.concatenate(ws) for ws in zip(*pairs, strict=True))
    samples = measured(wi, wo, np.arange(42.0), np.r_[2.0, np.ones(41)])
    assert_allclose(interpolate(samples, wi[0], wo[0]), [(0 * 2 + 40 + 41) / 4], rtol=1e-6)
    often = measured(np.tile(wi[:2], (50, 1)), np.tile(wo[:2], (50, 1)), np.tile([1.0, 3.0], 50))
    middle = (wi[0] + wi[1]) / np.linalg.norm(wi[0] + wi[1])
    assert 1 < interpolate(often, middle, wo[0], np.inf)[0] < 3


def test_one_sample_is_known_at_itself_alone():
    samples = measured(hemisphere(1, 3), hemisphere(1, 4), [[0.5]])
    assert_allclose(interpolate(samples, samples.wi, samples.wo), [[0.5]])
    assert np.isnan(interpolate(samples, samples.wi, samples.wi)).all()
    assert_allclose(interpolate(samples, samples.wi, samples.wi, np.inf), [[0.5]])


def test_samples_of_no_weight_or_not_valid_are_not_used(noise):
    odd = np.arange(500) % 2 == 1
    few = measured(noise.wi[~odd], noise.wo[~odd], noise.values[~odd])
    unweighted = measured(noise.wi, noise.wo, noise.values, np.where(odd, 0.0, 1.0))
    invalid = measured(noise.wi, noise.wo, np.where(odd[:, None], -1.0, noise.values))
    unknown = measured(noise.wi, noise.wo, np.where(odd[:, None], np.nan, noise.values))
    wi, wo = hemisphere(50, 8), hemisphere(50, 9)
    for samples in (unweighted, invalid, unknown):
        assert_array_equal(interpolate(samples, wi, wo), interpolate(few, wi, wo))


def test_each_channel_has_its_own_valid_samples(noise):
    values = noise.values.copy()
    values[::3, 0] = np.nan
    wi, wo = hemisphere(50, 8), hemisphere(50, 9)
    both = interpolate(measured(noise.wi, noise.wo, values), wi, wo, np.inf)
    for channel in (0, 1):
        alone = interpolate(measured(noise.wi, noise.wo, values[:, channel]), wi, wo, np.inf)
        assert_array_equal(both[:, channel], alone[:, 0])
    values[:, 0] = np.nan
    both = interpolate(measured(noise.wi, noise.wo, values), wi, wo, np.inf)
    assert_array_equal(np.isnan(both), np.tile([True, False], (50, 1)))


def test_dark_samples_are_dark():
    samples = measured(hemisphere(50, 3), hemisphere(50, 4), np.zeros((50, 1)))
    assert_array_equal(interpolate(samples, hemisphere(9, 8), hemisphere(9, 9), np.inf), np.zeros((9, 1)))


@pytest.mark.parametrize("values", [np.zeros((0, 2)), -np.ones((5, 2)), np.full((5, 2), np.nan)])
def test_without_valid_samples_there_is_nothing_to_interpolate(values):
    samples = jb.MeasuredSamples(*np.zeros((4, len(values))), values, np.ones(len(values)))
    with pytest.raises(ValueError, match="valid"):
        interpolate(samples, NORMAL, NORMAL)


@pytest.mark.parametrize("wrong", [[0.0, 1.0], [0.0, 0.0, 2.0], 1.0, [np.nan, 0.0, 1.0]])
def test_what_is_no_direction_is_refused(noise, wrong):
    with pytest.raises(ValueError, match="wo must hold"):
        interpolate(noise, NORMAL, np.array(wrong))


def one_incidence(f, theta_i=0.5, count=2000, half=False):
    """Samples of f(wo) at one incidence, and its share of the disk, by scipy's convex hull."""
    wo = hemisphere(count, 7, 0.05)
    wo[:, 1] = np.abs(wo[:, 1]) if half else wo[:, 1]
    wi = np.tile([np.sin(theta_i), 0.0, np.cos(theta_i)], (count, 1))
    both = np.concatenate([wo, wo * MIRROR]) if half else wo
    return measured(wi, wo, f(wo)), ConvexHull(both[:, :2]).volume / np.pi


@pytest.mark.parametrize("half", [False, True])
def test_albedo_of_a_diffuse_surface(half):
    samples, share = one_incidence(lambda wo: np.tile([0.5, 0.2], (len(wo), 1)) / np.pi, half=half)
    found = sample_albedos(samples)
    assert_allclose(found.covered, [share], atol=1e-5)
    assert 0.97 < found.covered[0] < 1
    assert_allclose(found.albedo, found.covered[:, None] * [[0.5, 0.2]], rtol=1e-12)
    assert_allclose([found.theta_i, found.phi_i], [[0.5], [0.0]], atol=1e-12)


@pytest.mark.parametrize("half", [False, True])
def test_albedo_of_a_cosine(half):
    """∫ cos² θ_o dω_o = 2π/3, less the rim, where f is near 0."""
    found = sample_albedos(one_incidence(lambda wo: wo[:, 2], count=20_000, half=half)[0])
    assert_allclose(found.albedo, [[2 * np.pi / 3]], rtol=2e-3)


def test_albedo_of_a_ggx_against_the_quadrature_of_the_model():
    brdf, wi = ggx(0.4), np.array([np.sin(0.5), 0.0, np.cos(0.5)])
    samples, _ = one_incidence(lambda wo: np.asarray(brdf(wi, wo)), count=20_000)
    assert_allclose(sample_albedos(samples).albedo[0], jb.albedo(brdf, wi), rtol=0.01)


def test_incidences_are_told_apart_and_sorted():
    """Within 1e-3 rad they are one; so are all φ_i of normal incidence; φ_i counts elsewhere."""
    wo, up = hemisphere(400, 7), np.array([0.0, 0.0, 1.0])
    wi = np.repeat([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8], up, [0.0, 0.0, 1.0]], 100, axis=0)
    samples = measured(wi, wo, np.ones(400))
    jitter = 2e-4 * np.sin(np.arange(400.0))
    phi_i = np.where(wi[:, 2] == 1, np.arange(400.0), samples.phi_i + jitter)
    jittered = jb.MeasuredSamples(
        samples.theta_i + np.abs(jitter) * (wi[:, 2] < 1),
        phi_i,
        samples.theta_o,
        samples.phi_o,
        samples.values,
        samples.weights,
    )
    found = sample_albedos(jittered)
    assert_allclose(found.theta_i, [0, np.arccos(0.8), np.arccos(0.8)], atol=1e-3)
    assert_allclose(np.sort(found.phi_i[1:]), [0, np.pi / 2], atol=1e-3)
    assert_allclose(found.albedo[:, 0], found.covered * np.pi, rtol=1e-9)


def test_repeated_samples_are_averaged():
    samples, _ = one_incidence(lambda wo: np.ones(len(wo)), count=100)
    wi, wo, values = (np.tile(a, (2, 1)) for a in (samples.wi, samples.wo, samples.values))
    values[100:] = 3
    twice = sample_albedos(measured(wi, wo, values, np.r_[np.ones(100), np.full(100, 3.0)]))
    assert_allclose(twice.albedo[:, 0], 2.5 * np.pi * twice.covered, rtol=1e-9)


@pytest.mark.parametrize("wo", [hemisphere(9, 7), np.tile(hemisphere(1, 7), (50, 1)), np.zeros((0, 3))])
def test_incidences_of_too_few_samples_are_left_out(wo):
    found = sample_albedos(measured(np.tile(NORMAL, (len(wo), 1)), wo, np.ones((len(wo), 2))))
    assert [a.shape for a in found] == [(0,), (0,), (0, 2), (0,)]


@pytest.mark.parametrize("error", [0.0, 2e-4])
@pytest.mark.parametrize("phi", [0.0, 1.0])
def test_incidences_measured_in_one_plane_are_left_out(phi, error):
    phi_o = phi + error * np.sin(np.arange(60.0))
    theta = np.linspace(-1.3, 1.3, 60)
    wo = np.stack([np.sin(theta) * np.cos(phi_o), np.sin(theta) * np.sin(phi_o), np.cos(theta)], axis=-1)
    wi = np.tile([np.sin(0.5) * np.cos(phi), np.sin(0.5) * np.sin(phi), np.cos(0.5)], (60, 1))
    assert len(sample_albedos(measured(wi, wo, np.ones(60))).covered) == 0


def test_invalid_and_unweighted_samples_are_no_part_of_an_albedo():
    samples, _ = one_incidence(lambda wo: np.tile([0.5, 0.2], (len(wo), 1)), count=300)
    values, weights = samples.values.copy(), np.ones(300)
    values[:50, 0], values[50:100] = np.nan, -7
    values[100:150], weights[100:150] = 99, 0
    found = sample_albedos(measured(samples.wi, samples.wo, values, weights))
    assert_allclose(found.albedo, np.pi * found.covered[:, None] * [[0.5, 0.2]], rtol=1e-9)


def on_squares(samples, theta_i, cells=400):
    """∫ f cos θ_o dω_o of every tenth channel at one incidence, of samples on one side of the plane: twice
    the sum over squares of half the disk of scipy's interpolant at their midpoints."""
    at = np.flatnonzero(np.isclose(samples.theta_i, theta_i, atol=1e-3))
    phi = samples.phi_o[at] - samples.phi_i[at]
    points = np.stack([np.cos(phi), np.abs(np.sin(phi))], axis=-1) * np.sin(samples.theta_o[at])[:, None]
    centres = (np.arange(cells) + 0.5) / cells
    x, y = np.meshgrid(2 * centres - 1, centres)
    f = LinearNDInterpolator(points, samples.values[at, ::10], fill_value=0.0)(x, y)
    return 2 * f.sum(axis=(0, 1)) * 2 / cells**2


def on_rings(samples, theta_i):
    """The same by trapezia along θ_o of means over φ_o, for samples in rings."""
    at = np.flatnonzero(np.isclose(samples.theta_i, theta_i, atol=1e-3) & samples.valid.all(axis=1))
    theta, ring = np.unique(np.round(samples.theta_o[at], 6), return_inverse=True)
    means = [samples.values[at[ring == k]].mean(axis=0) for k in range(len(theta))]
    return np.trapezoid(np.pi * np.sin(2 * theta)[:, None] * means, theta, axis=0)


@pytest.mark.parametrize("name", CORNELL)
def test_albedos_of_cornell(shared_data, name):
    """Half the disk has other triangles than the whole, which at the sharp peak of 10° makes up 0.0035."""
    from data_loaders import read_cornell

    samples = read_cornell(shared_data / "cornell" / f"{name}.brdf")
    found = sample_albedos(samples)
    assert_allclose(found.theta_i, np.radians(np.arange(10, 90, 10)), atol=1e-3)
    assert np.all((found.covered > 0.95) & (found.covered < np.sin(np.radians(79.1)) ** 2))
    assert np.all((found.albedo > 0.02) & (found.albedo < 0.55))
    for k in (0, 3, 6):
        assert_allclose(found.albedo[k, ::10], on_squares(samples, found.theta_i[k]), rtol=0.01, atol=0.004)


@pytest.mark.parametrize("name", MINIDIFF)
def test_albedos_of_minidiff(shared_data, name):
    """At θ_i = 60° the instrument's channels disagree: the white paint reflects 104 % of its green."""
    from data_loaders import read_minidiff

    samples = read_minidiff(shared_data / "minidiff" / f"{name}.astm")
    found = sample_albedos(samples)
    assert_allclose(found.theta_i, np.radians([0, 20, 40, 60]), atol=1e-9)
    assert np.all((found.covered > 0.99) & (found.covered < 1))
    assert np.all((found.albedo > 0.1) & (found.albedo < 1.05))
    assert np.all(found.albedo[:3] < 1)
    for k in range(4):
        assert_allclose(found.albedo[k], on_rings(samples, found.theta_i[k]), rtol=0.01)


@pytest.mark.parametrize("name", MINIDIFF)
def test_left_out_samples_of_minidiff_are_found_again(shared_data, name):
    """A tenth of the samples, from the others: the median error is of the order of the noise."""
    from data_loaders import read_minidiff

    samples = read_minidiff(shared_data / "minidiff" / f"{name}.astm")
    left_out = samples.valid.all(axis=1) & (samples.theta_o < np.radians(75)) & (np.arange(12964) % 10 == 3)
    others = measured(samples.wi, samples.wo, samples.values, np.where(left_out, 0.0, 1.0))
    f = interpolate(others, samples.wi[left_out], samples.wo[left_out])
    assert np.mean(np.isnan(f)) < 0.01
    assert np.nanmedian(np.abs(f / samples.values[left_out] - 1)) < 0.04
