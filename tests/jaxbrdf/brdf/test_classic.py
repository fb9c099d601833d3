"""The classic reflectances beyond the table of cases: limits, sharp lobes, energy, sampling."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from jaxbrdf.brdf.ashikhmin_shirley import AshikhminShirley, AshikhminShirleyDiffuse, AshikhminShirleyLobe
from jaxbrdf.brdf.lafortune import Lafortune
from jaxbrdf.brdf.oren_nayar import OrenNayar
from jaxbrdf.brdf.phong import BlinnPhongBRDF, Phong
from jaxbrdf.brdf.ward import Ward, WardDuer
from tests import references
from tests.jaxbrdf.brdf.cases import PAIRS, compiled_quickly
from tests.jaxbrdf.brdf.truths import classic

NORMAL = np.array([0.0, 0.0, 1.0])
VIEWS = references.direction(np.array([0.3, 1.1]), np.array([0.4, -2.0]))


def facets(f0, *exponents):
    return AshikhminShirleyLobe(jb.Schlick(f0), *exponents)


SHARP = {  # make, parameters, truth, and how wide the lobe is in wi
    "Phong": (Phong, (1e4,), classic.phong, 1e-2),
    "BlinnPhongBRDF": (BlinnPhongBRDF, (1e6,), classic.blinn_phong, 2e-3),
    "Lafortune": (Lafortune, (1e4, -1.0, -1.0, 1.0), classic.lafortune, 1e-2),
    "Ward": (Ward, (1e-5,), classic.ward, 2e-5),
    "Ward, anisotropic": (Ward, (0.01, 0.02), classic.ward, 2e-2),
    "WardDuer": (WardDuer, (0.001, 0.003), classic.ward_duer, 2e-3),
    "AshikhminShirleyLobe": (facets, (0.9, 1e6, 3e5), classic.ashikhmin_shirley_lobe, 2e-3),
}
every_sharp = pytest.mark.parametrize("name", SHARP)
TOO_SHARP = ("Ward", "Lafortune")  # for differences
DULL = {
    "OrenNayar": (OrenNayar, (0.8, 0.5, 0.57), classic.oren_nayar),
    "Lafortune, anisotropic": (Lafortune, (3.0, 0.8, -0.5, 1.2), classic.lafortune),
    "AshikhminShirley": (AshikhminShirley, (0.3, 0.6, 10.0, 300.0), classic.ashikhmin_shirley),
}


def unit(w):
    return w / np.linalg.norm(w, axis=-1, keepdims=True)


@compiled_quickly
def evaluate(brdfs, wi, wo):
    return [brdf(wi, wo) for brdf in brdfs]


# Values and gradients


@compiled_quickly
def value_and_gradients(make, parameters, wi, wo):
    def f(parameters, wi, wo):
        return make(*parameters)(wi, wo)

    def at(wi, wo):
        return f(parameters, wi, wo), f(parameters, wo, wi), *jax.grad(f, (0, 1))(parameters, wi, wo)

    return jax.vmap(at)(wi, wo)


def in_the_lobe(width, n=6):
    """Pairs about as far from mirror pairs as a lobe is wide."""
    rng = np.random.default_rng(8)
    wo = references.direction(rng.uniform(0.1, 1.2, n), rng.uniform(-np.pi, np.pi, n))
    return unit(wo * [-1, -1, 1] + width * rng.normal(size=(n, 3))), wo


@every_sharp
def test_the_value_inside_a_sharp_lobe(name):
    """To the digits that the directions leave; the same with the directions exchanged."""
    make, parameters, truth, width = SHARP[name]
    wi, wo = in_the_lobe(width)
    f, exchanged, _, _ = value_and_gradients(make, parameters, wi, wo)
    expected = [truth(*parameters)(i, o) for i, o in zip(wi, wo, strict=True)]
    assert np.min(expected) > 1e-4 * np.max(expected)
    assert_allclose(f, expected, rtol=1e-14 / width + 1e-11)
    assert_allclose(f, exchanged, rtol=1e-14 / width)


@pytest.mark.parametrize("name", [name for name in (*SHARP, *DULL) if name not in TOO_SHARP])
def test_gradients_by_the_parameters_and_by_direction(name):
    """By central differences of the plain numpy formula, with wi moved within the unit sphere."""
    make, parameters, truth, *width = (SHARP | DULL)[name]
    wi, wo = in_the_lobe(*width or [0.3])
    f, _, by_parameters, by_wi = value_and_gradients(make, parameters, wi, wo)

    def rate(change):
        up, down = change(1e-4), change(-1e-4)
        return [(up(i, o) - down(i, o)) / 2e-4 for i, o in zip(wi, wo, strict=True)]

    for k, p in enumerate(parameters):
        expected = rate(lambda s: truth(*(q * (1 + s * (j == k)) for j, q in enumerate(parameters))))  # noqa: B023
        assert_allclose(by_parameters[k] * p / f, np.array(expected) / f, rtol=1e-6, atol=1e-6)
    f_of, scale = truth(*parameters), (width or [0.3])[0]
    for axis in np.eye(3):
        tangent = axis - (wi @ axis)[:, None] * wi
        expected = rate(lambda s: lambda i, o: f_of(unit(i + s * scale * axis), o))  # noqa: B023
        found = np.sum(by_wi * tangent, axis=-1) * scale
        assert_allclose(found / f, np.array(expected) / f, rtol=1e-6, atol=1e-6)


def test_parameters_left_out_do_not_make_single_precision_double():
    single = [jnp.float32(0.5), jnp.float32(0.3)]
    wi, wo = (w.astype(np.float32) for w in PAIRS)
    for f in evaluate(
        [OrenNayar(*single), Lafortune(*single), Ward(single[0]), AshikhminShirley(*single, *single)], wi, wo
    ):
        assert f.dtype == jnp.float32


# Limits


def test_smooth_and_broadest_are_lambertian():
    """Phong's lobe ends at a right angle to the mirror direction, however broad it is."""
    smooth, blinn, phong, mirror, lambertian = evaluate(
        [OrenNayar(0.6, 0.0), BlinnPhongBRDF(0.0), Phong(0.0), Lafortune(1.0, -1.0), jb.Lambertian(1.0)],
        *PAIRS,
    )
    assert_allclose(smooth, 0.6 * lambertian, rtol=1e-14)
    assert_allclose(blinn, lambertian, rtol=1e-14)
    assert_allclose(phong, np.where(mirror > 0, lambertian, 0), rtol=1e-14)
    assert 0 < np.sum(mirror > 0) < len(mirror)


def test_one_roughness_is_two_that_are_equal():
    one = [
        Ward(0.2),
        WardDuer(0.2),
        Lafortune(4.0, -0.7, None, 0.6),
        facets(0.3, 50.0),
        AshikhminShirley(0.1, 0.2, 9.0),
    ]
    two = [
        Ward(0.2, 0.2),
        WardDuer(0.2, 0.2),
        Lafortune(4.0, -0.7, -0.7, 0.6),
        facets(0.3, 50.0, 50.0),
        AshikhminShirley(0.1, 0.2, 9.0, 9.0),
    ]
    values = evaluate(one + two, *PAIRS)
    for a, b in zip(values[: len(one)], values[len(one) :], strict=True):
        assert_allclose(a, b, rtol=1e-14)


def test_a_mirrored_cosine_lobe_is_phongs_without_its_normalisation():
    e = 12.0
    phong, lobe, scaled = evaluate([Phong(e), Lafortune(e, -1.0), Lafortune(e, -0.5, c_z=0.5)], *PAIRS)
    assert_allclose((e + 2) / (2 * np.pi) * lobe, phong, rtol=1e-12)
    assert_allclose(2**e * scaled, lobe, rtol=1e-12)


def test_where_a_cosine_lobe_points():
    """Positive c_x reflect back to the light, c_z < −c_x leans the lobe towards the horizon."""
    wo = references.direction(0.7, 0.0)
    theta = np.linspace(-1.5, 1.5, 301)
    wi = references.direction(theta, 0.0)
    retro, specular, leaning = evaluate(
        [Lafortune(20.0, 1.0), Lafortune(20.0, -1.0), Lafortune(20.0, -1.0, c_z=0.6)], wi, wo[None]
    )
    assert_allclose(theta[np.argmax(retro)], 0.7)
    assert_allclose(theta[np.argmax(specular)], -0.7)
    assert_allclose(theta[np.argmax(leaning)], -np.arctan(np.tan(0.7) / 0.6), atol=0.01)


def test_the_anisotropic_lobes_are_narrow_where_alpha_is_small_and_the_exponent_large():
    wi = references.direction(0.2, np.array([0.0, np.pi / 2]))
    for along_x, along_y in evaluate(
        [Ward(0.05, 0.3), WardDuer(0.05, 0.3), facets(0.5, 800.0, 20.0)], wi, NORMAL[None]
    ):
        assert along_x < 0.1 * along_y


def test_ashikhmin_shirley_is_its_two_parts():
    whole, diffuse, lobe = evaluate(
        [AshikhminShirley(0.3, 0.2, 20.0, 50.0), AshikhminShirleyDiffuse(0.3, 0.2), facets(0.2, 20.0, 50.0)],
        *PAIRS,
    )
    assert_allclose(whole, diffuse + lobe, rtol=1e-14)


# Energy

DEGREES = np.array([0.0, 40.0, 80.0, 89.0, 89.9])
AT_DEGREES = references.direction(np.radians(DEGREES), 0.7)
COSINES = np.cos(np.radians(DEGREES))


def nodes(wi, n_r=128, n_phi=64):
    """Directions wo (N, 3) above the horizon, and cos θ_o dω_o = 4 (wi·h) cos θ_o dω_h, with θ_h ∝ r³."""
    r, weights = (
        (a + b)[:, None] / 2 for a, b in zip(np.polynomial.legendre.leggauss(n_r), (1, 0), strict=True)
    )
    phi = (np.arange(n_phi) + 0.5) * 2 * np.pi / n_phi
    along = wi[0] * np.cos(phi) + wi[1] * np.sin(phi)
    last_theta_h = np.arctan2(wi[2], -along) / 2
    theta_h = last_theta_h * r**3
    h = references.direction(theta_h, phi)
    wo = 2 * (h @ wi)[..., None] * h - wi
    d_omega_h = last_theta_h * 3 * r**2 * weights * np.sin(theta_h) * 2 * np.pi / n_phi
    return wo.reshape(-1, 3), (4 * (h @ wi) * wo[..., 2] * d_omega_h).ravel()


@eqx.filter_jit
def values_and_weights(make, parameters, wi, wo):
    return jax.vmap(lambda p: (make(*p)(wi, wo), make(*p)._weight(wi)))(parameters)


def albedos(make, *parameters, weighed=True):
    """(models, angles) at DEGREES, of parameters that are (models,) each.

    The weights by which sums choose are these to a factor of two up to 80° (if `weighed`).
    """
    wo, measure = (np.stack(a) for a in zip(*map(nodes, AT_DEGREES), strict=True))
    f, weights = values_and_weights(make, tuple(np.array(p) for p in parameters), AT_DEGREES[:, None], wo)
    found = np.sum(np.asarray(f) * measure, axis=-1)
    if weighed:
        ratio = (weights[..., 0] / found)[:, :3]
        assert np.all((ratio > 0.5) & (ratio < 2)), ratio
    return found


def test_oren_nayars_albedo():
    """ρ (A + B g) by hand; above ρ by as much as the docstring says."""
    theta = np.radians(DEGREES)
    bowl = np.sin(theta) * (theta - np.sin(theta) * np.cos(theta))
    g = (bowl + 2 / 3 * np.tan(theta) * (1 - np.sin(theta) ** 3)) / np.pi
    sigma, constant = np.array([0.29, 0.56, 0.2, 0.33]), np.array([0.57, 0.57, 0.33, 0.33])
    A, B = 1 - sigma**2 / (2 * (sigma**2 + constant)), 0.45 * sigma**2 / (sigma**2 + 0.09)
    found = albedos(OrenNayar, np.full(4, 0.7), sigma, constant)
    assert_allclose(found, 0.7 * (A[:, None] + B[:, None] * g), rtol=2e-3)
    assert_allclose((A + B / 2)[[0, 2]], [1.0444, 1.0152], atol=1e-4)
    assert np.all((A + B / 2)[[1, 3]] < 1)


def test_phongs_albedo_is_one_at_normal_incidence_and_less_elsewhere():
    found = albedos(Phong, [0.0, 5.0, 1e4])
    assert_allclose(found[:, 0], 1, rtol=1e-6)
    assert np.all(np.diff(found, axis=1) < 0)
    assert_allclose(found[2, :3], COSINES[:3], rtol=1e-3)


def test_blinn_phongs_albedo_is_up_to_four():
    """At normal incidence ∫ f cos = 4 (e + 2) ∫ c^{e+1} (2c² − 1) dc over c = cos θ_h ≥ 1/√2."""
    e = np.array([0.0, 5.0, 1e4])
    fourth, second = ((1 - 2 ** (-(e + k) / 2)) / (e + k) for k in (4, 2))
    found = albedos(BlinnPhongBRDF, e)
    assert_allclose(found[:, 0], 4 * (e + 2) * (2 * fourth - second), rtol=1e-6)
    assert_allclose(found[2, :3], 4 * COSINES[:3] ** 2, rtol=0.01)


def test_the_bound_on_a_cosine_lobes_albedo():
    e, c_x, c_z = (
        np.array([0.0, 3.0, 50.0, 50.0]),
        np.array([-1.0, 1.1, -1.0, -1.0]),
        np.array([1.0, 0.9, 1.0, 0.8]),
    )
    bound = np.maximum(np.abs(c_x), c_z) ** e * 2 * np.pi / (e + 2)
    found = albedos(lambda e, x, z: Lafortune(e, x, None, z), e, c_x, c_z)
    assert np.all(found < bound[:, None] * (1 + 1e-3))
    assert_allclose(found[[0, 2], 0], bound[[0, 2]], rtol=1e-5)


def test_wards_albedo_falls_like_the_cosine_and_has_no_bound():
    found = albedos(Ward, [0.01, 0.5])
    assert_allclose(found[0, :3], COSINES[:3], rtol=2e-3)
    assert_allclose(found[1, [0, 2, 3, 4]], [0.59, 0.27, 0.50, 1.5], atol=0.02)


def test_duers_albedo_is_even_and_has_no_bound():
    found = albedos(WardDuer, [0.01, 0.05, 0.1, 0.2])
    assert_allclose(found[:3, :3], 1, atol=0.06)
    assert np.all(found[1:, 3] > 1.3)
    assert np.all(found[:, 4] > 2)


def test_ashikhmin_shirleys_albedo():
    """The diffuse part's closed form, and the lobe's bound F."""
    found = albedos(AshikhminShirleyDiffuse, [0.6, 1.0], [0.2, 0.0])
    assert_allclose(found, np.array([[0.48], [1.0]]) * (1 - (1 - COSINES / 2) ** 5), rtol=1e-5)
    lobe = albedos(
        lambda f0, e: AshikhminShirleyLobe(jb.Constant(f0), e), [0.4] * 3, [0.0, 10.0, 1e4], weighed=False
    )
    assert np.all(lobe < 0.4 * (1 + 1e-3))
    assert_allclose(lobe[2, :2], 0.4, rtol=0.01)


# Sampling

COUNT = 20_000
U = np.random.default_rng(5).uniform(size=(COUNT, 2))
DRAWN = {  # lobes too sharp for a grid, and how much an estimate may vary, over its mean
    "Phong": (Phong(1e4), 0.1),
    "BlinnPhongBRDF": (BlinnPhongBRDF(4e4), 0.1),
    "Lafortune": (Lafortune(1e4, -1.0, None, 0.99), 0.1),
    "Ward": (Ward(0.01, 0.02), 0.1),
    "WardDuer": (WardDuer(0.01, 0.02), 0.1),
    "AshikhminShirleyLobe": (AshikhminShirleyLobe(jb.Schlick(0.5), 1e4, 1e3), 0.1),
}


@eqx.filter_jit
def drawn(brdf, wo):
    """Of one wo: samples, f and pdf at them, and the estimates f cos θ / pdf."""
    wo = wo[None]
    wi = brdf.sample(U, wo)
    f, pdf = brdf(wi, wo), brdf.pdf(wi, wo)
    return wi, f, pdf, jnp.where(pdf > 0, f * wi[:, 2] / jnp.where(pdf > 0, pdf, 1), 0)


@cache
def estimates(name, view):
    wi, f, _, weight = drawn(DRAWN[name][0], jnp.asarray(VIEWS[view]))
    return tuple(np.asarray(a) for a in (wi, f, weight))


@pytest.mark.parametrize("view", [0, 1])
@pytest.mark.parametrize("name", DRAWN)
def test_sharp_lobes_are_drawn_with_little_variance(name, view):
    """The mean is the albedo; the variance a small share of what cosine sampling has, E[(π f)²] − mean²."""
    wi, f, weight = estimates(name, view)
    directions, measure = nodes(VIEWS[view])
    mean, expected = weight.mean(), evaluate([DRAWN[name][0]], directions, VIEWS[view][None])[0] @ measure
    assert_allclose(np.linalg.norm(wi, axis=-1), 1, atol=1e-12)
    assert abs(mean - expected) < 4.5 * weight.std() / np.sqrt(COUNT) + 2e-4 * expected
    assert weight.std() < DRAWN[name][1] * mean
    by_cosine = np.pi * np.mean(f * weight) - mean**2
    assert weight.var() < 1e-3 * by_cosine


def test_no_estimate_is_large():
    """Phong's is (e + 2)/(e + 1) cos θ_i, Ashikhmin & Shirley's is at most F."""
    for view in (0, 1):
        wi, _, phong = estimates("Phong", view)
        assert_allclose(phong, np.maximum(wi[:, 2], 0) * (1e4 + 2) / (1e4 + 1), rtol=1e-9)
        assert estimates("AshikhminShirleyLobe", view)[2].max() < 1


def test_cosine_lobes_wherever_they_point_are_drawn_without_bias():
    """∫ f cos θ_i = ‖C wo‖^e 2π/(e + 2) times the cosine of the lobe's axis, if the horizon cuts nothing."""
    e, wo = 500.0, VIEWS[1]
    for C in ([1.0, 1.0, 1.0], [-1.0, -0.7, 0.9], [0.3, -0.8, 0.6]):
        _, _, _, weight = drawn(Lafortune(e, *C), jnp.asarray(wo))
        length = np.linalg.norm(C * wo)
        expected = length**e * 2 * np.pi / (e + 2) * C[2] * wo[2] / length
        assert abs(weight.mean() - expected) < 4.5 * weight.std() / np.sqrt(COUNT)
        assert weight.std() < 0.2 * expected


def test_a_lobe_about_nothing_is_drawn_about_the_normal_and_one_about_the_nadir_below():
    """C wo = 0 reflects nothing, and its density is still that of its samples; C wo = −n is never seen."""
    wi, f, pdf, _ = drawn(Lafortune(5.0, -1.0, c_z=0.0), jnp.asarray(NORMAL))
    assert_array_equal(f, 0)
    assert_allclose(pdf, 6 / (2 * np.pi) * wi[:, 2] ** 5, rtol=1e-9)
    assert_allclose(jnp.mean(wi[:, 2]), 6 / 7, atol=5e-3)
    wi, _, pdf, _ = drawn(Lafortune(5.0, 0.0, c_z=-1.0), jnp.asarray(NORMAL))
    assert_allclose(jnp.mean(wi[:, 2]), -6 / 7, atol=5e-3)
    assert_array_equal(pdf, 0)


# Misuse


@pytest.mark.parametrize(
    ("make", "name", "bad"),
    [
        (lambda: OrenNayar(0.5, -0.1), "sigma", -0.1),
        (lambda: OrenNayar(0.5, 0.1, constant=0.0), "constant", 0),
        (lambda: Phong(-1.0), "exponent", -1),
        (lambda: BlinnPhongBRDF(-0.5), "exponent", -0.5),
        (lambda: Lafortune(-2.0, -1.0), "exponent", -2),
        (lambda: Ward(0.0), "alpha_x", 0),
        (lambda: Ward(0.1, -0.2), "alpha_y", -0.2),
        (lambda: WardDuer(-0.1), "alpha_x", -0.1),
        (lambda: WardDuer(0.1, 0.0), "alpha_y", 0),
        (lambda: AshikhminShirley(0.5, 1.1, 10.0), "rho_s", 1.1),
        (lambda: AshikhminShirleyDiffuse(0.5, -0.1), "rho_s", -0.1),
        (lambda: AshikhminShirley(0.5, 0.1, -1.0), "exponent_x", -1),
        (lambda: facets(0.5, 10.0, -1.0), "exponent_y", -1),
    ],
)
def test_a_parameter_outside_its_domain(make, name, bad):
    with pytest.raises(ValueError, match=rf"{name} must be .*; found {bad:.3g}"):
        make()


# What the literature published


def test_published_conventions_can_be_written_as_sums():
    """Löw et al. 2012 and Ngan et al. 2005, RGB, at the mirror pair of 45° where h = n."""
    rgb = jnp.array([0.1, 0.2, 0.3])
    wi, wo = jb.spherical(np.pi / 4, 0.0)[None], jb.spherical(np.pi / 4, np.pi)[None]
    F = jb.Dielectric(1.5)(np.cos(np.pi / 4))
    low = jb.Lambertian(rgb) + rgb * AshikhminShirleyLobe(jb.Dielectric(1.5), 99.0)
    e, c_xy, c_z = 1e4, -0.577, 0.577  # c^e is nothing: C is divided by its largest
    cosine_lobe = Lafortune(e, -1.0, c_z=c_z / abs(c_xy))
    ngan = jb.Lambertian(rgb) + rgb * (e + 2) / (2 * np.pi) * cosine_lobe
    f_low, f_ngan = evaluate([low, ngan], wi, wo)
    assert_allclose(f_low, [rgb / np.pi + rgb * 100 / (8 * np.pi) * F / 0.5], rtol=1e-6)
    assert_allclose(f_ngan, [rgb / np.pi + rgb * (e + 2) / (2 * np.pi)], rtol=1e-6)
