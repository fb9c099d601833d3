"""The ABC models, Sun's rough metal and Kirchhoff's reflectance: truths, seams, samplers, refusals."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad
from scipy.stats import kstest

import jaxbrdf as jb
from jaxbrdf.brdf.abc import ABC, SmoothABC
from jaxbrdf.brdf.kirchhoff import KirchhoffBRDF
from jaxbrdf.brdf.rough_metal import RoughMetal
from tests import references
from tests.jaxbrdf.brdf.cases import PAIRS, SEAMS, compiled_quickly
from tests.jaxbrdf.brdf.truths import physical

GOLD = (0.2, 3.0)
ABC_ROWS = np.array(  # published: nickel, chrome, beige fabric; then the logarithm's exponent and a flat lobe
    [
        [32.745403, 705.733887, 1.945258, 5.441883],
        [771.035522, 64661.257812, 1.90542, 99.999413],
        [0.133698, 3442009.5, 0.08321, 10.406549],
        [2.0, 300.0, 1.0, 1.5],
        [0.3, 1e-3, 0.0, 0.7],
    ]
)
DIFFRACTION = np.array([[0.55, 0.9], [0.3, 0.5], [1.2, 1.0]])
METALS = np.array([[0.3, *GOLD], [2.0, *GOLD], [20.0, 1.5, 7.0]])
U = np.random.default_rng(5).uniform(size=(20_000, 2))
VIEWS = references.direction(np.array([0.0, 0.4, 1.1, 1.5]), np.array([0.0, 2.0, -2.0, 1.0]))


def rough_metal(smoothness, eta, kappa):
    return RoughMetal(smoothness, jb.Conductor(eta, kappa))


def kirchhoff(wavelength, f0):
    dtype = jnp.result_type(float, wavelength)
    tables = jnp.asarray(physical.tables(), dtype), jnp.asarray(physical.WAVELENGTHS_Q, dtype)
    return KirchhoffBRDF(*tables, wavelength, jb.Constant(f0))


FAMILIES = [
    pytest.param(ABC, ABC_ROWS, physical.abc, id="ABC"),
    pytest.param(SmoothABC, ABC_ROWS, physical.smooth_abc, id="SmoothABC"),
    pytest.param(rough_metal, METALS, physical.rough_metal, id="RoughMetal"),
    pytest.param(kirchhoff, DIFFRACTION, physical.kirchhoff, id="Kirchhoff"),
]
every_family = pytest.mark.parametrize(("make", "rows", "truth"), FAMILIES)


@eqx.filter_jit
def evaluate(make, rows, wi, wo):
    """f (rows, N) of models make(*row)."""
    return jax.vmap(lambda row: make(*row)(wi, wo))(rows)


@eqx.filter_jit
def call(brdf, wi, wo):
    return brdf(wi, wo)


@eqx.filter_jit
def density(brdf, wi, wo):
    return brdf.pdf(wi, wo)


@eqx.filter_jit
def sample(brdf, u, wo):
    return brdf.sample(u, wo)


@every_family
def test_value_is_plain_numpys(make, rows, truth):
    wi, wo = PAIRS
    expected = [[truth(*row)(i, o) for i, o in zip(wi, wo, strict=True)] for row in rows]
    assert_allclose(evaluate(make, rows, wi, wo), expected, rtol=1e-8)
    assert_allclose(evaluate(make, rows, wo, wi), expected, rtol=1e-8)  # reciprocity


@every_family
def test_single_precision_stays_single(make, rows, truth):
    single = evaluate(make, *(jnp.asarray(a, jnp.float32) for a in (rows, *PAIRS)))
    assert single.dtype == jnp.float32
    expected = [[truth(*row)(i, o) for i, o in zip(*PAIRS, strict=True)] for row in rows]
    assert_allclose(single, expected, rtol=2e-3, atol=1e-30)


@compiled_quickly
def everything_at_seams(make, rows, wi, wo):
    """f and pdf at each pair, and the gradients of all that a reflectance knows, added up."""

    def total(row, wi, wo):
        brdf = make(*row)
        f, pdf = brdf(wi, wo), brdf.pdf(wi, wo)
        drawn = brdf.sample(jnp.array([0.3, 0.7], wi.dtype), wo)
        return f + pdf + brdf._weight(wo) + jnp.sum(drawn), (f, pdf)

    at = jax.value_and_grad(total, (0, 1, 2), has_aux=True)
    return jax.vmap(lambda row: jax.vmap(partial(at, row))(wi, wo))(rows)


@pytest.mark.parametrize(
    ("make", "rows", "dtype"),
    [
        (ABC, ABC_ROWS, np.float64),
        (ABC, ABC_ROWS, np.float32),
        (SmoothABC, ABC_ROWS, np.float64),
        (SmoothABC, ABC_ROWS, np.float32),
        (kirchhoff, DIFFRACTION, np.float32),
    ],
)
def test_samplers_are_finite_at_the_seams(make, rows, dtype):
    """Values and gradients; 0 where one direction is at or below the horizon; no light without a density."""
    wi, wo = SEAMS
    (total, (f, pdf)), gradients = everything_at_seams(make, *(jnp.asarray(a, dtype) for a in (rows, wi, wo)))
    for leaf in (total, f, pdf, *gradients):
        assert leaf.dtype == dtype
        assert np.all(np.isfinite(leaf))
    dark = (wi[:, 2] <= 0) | (wo[:, 2] <= 0)
    assert_array_equal(f[:, dark], 0)
    assert_array_equal(pdf[:, dark], 0)
    assert np.all(pdf[f > 0] > 0)


@eqx.filter_jit
def sampled(make, rows, u, wo):
    """wi and f cos θ_i / pdf of each row and each wo, (rows, wo, u, 3) and (rows, wo, u)."""

    def of(row, wo):
        brdf = make(*row)
        wi = brdf.sample(u, wo[None])
        f, pdf = brdf(wi, wo[None]), brdf.pdf(wi, wo[None])
        return wi, jnp.where(pdf > 0, f * wi[:, 2] / jnp.where(pdf > 0, pdf, 1), 0)

    return jax.lax.map(lambda row: jax.lax.map(lambda wo: of(row, wo), wo), rows)


@eqx.filter_jit
def albedos(make, rows, wo):
    return jax.lax.map(lambda row: jb.albedo(make(*row), wo), rows)


@pytest.mark.parametrize(("make", "rows", "truth"), FAMILIES[:2])
def test_the_mean_over_samples_is_the_albedo(make, rows, truth):
    wi, weight = (np.asarray(a) for a in sampled(make, rows, U, VIEWS))
    albedo = np.asarray(albedos(make, rows, VIEWS))
    assert_allclose(np.linalg.norm(wi, axis=-1), 1, atol=1e-12)
    error = 4.5 * weight.std(axis=-1) / np.sqrt(len(U)) + 2e-3 * albedo
    assert np.all(np.abs(weight.mean(axis=-1) - albedo) < error)


# ABC


def test_it_is_the_form_of_the_published_table():
    """`data_loaders.published_parameters` gives what `ABC` takes, each colour of its own height."""
    from data_loaders import published_parameters

    nickel = published_parameters("abc", "nickel")
    brdf = jb.Lambertian(nickel["kD"]) + ABC(nickel["A"], nickel["B"], nickel["C"], nickel["ior"])
    wi, wo = PAIRS[0][0], PAIRS[1][0]
    green = nickel["kD"][1] / np.pi + physical.abc(*ABC_ROWS[0])(wi, wo)
    f = call(brdf, wi, wo)
    assert f.shape == (3,)
    assert_allclose(f[1], green, rtol=1e-8)


@pytest.mark.parametrize(("b", "c"), [(1e-3, 0.0), (10.0, 0.3), (1e3, 1.0), (1e3, 1 + 1e-12), (1e5, 2.5)])
def test_half_vectors_of_abc_follow_its_lobe(b, c):
    """Kolmogorov–Smirnov against scipy's integral of (1 + b x)^{−c} over x = 1 − cos θ_h; even azimuths."""
    wo = np.array([0.0, 0.0, 1.0])
    wi = np.asarray(sample(ABC(1.0, b, c, 1.5), U[:4000], wo))
    h = wi + wo
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    x = np.geomspace(1e-9, 1, 400)
    pieces = [quad(lambda t: (1 + b * t) ** -c, lo, hi)[0] for lo, hi in zip([0, *x[:-1]], x, strict=True)]
    cumulative = np.cumsum(pieces) / np.sum(pieces)
    found = (h[:, 0] ** 2 + h[:, 1] ** 2) / (1 + h[:, 2])
    assert kstest(found, lambda t: np.interp(t, x, cumulative)).pvalue > 1e-3
    assert kstest(np.arctan2(h[:, 1], h[:, 0]) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3


def test_weights_of_abc_are_bounded():
    """f cos θ_i / pdf ≤ 16 F ∫ S dx: G (wo·h) ≤ 2 cos θ_h cos θ_o."""
    _, weight = sampled(ABC, ABC_ROWS, U, VIEWS)
    for (a, b, c, _), most in zip(ABC_ROWS, np.max(weight, axis=(1, 2)), strict=True):
        area = quad(lambda t, b=b, c=c: (1 + b * t) ** -c, 0, 1, points=[1e-6, 1e-4, 1e-2])[0]
        assert 0 < most < 16 * a * area * (1 + 1e-3)


def test_of_the_weights_of_smooth_abc_only_fresnel_varies():
    """At each view f cos θ_i / pdf over F is one number for all directions above the horizon."""
    wi, weight = (np.asarray(a) for a in sampled(SmoothABC, ABC_ROWS, U, VIEWS))
    wi, weight = wi[:, :, :500], weight[:, :, :500]
    for i, (_, _, _, eta) in enumerate(ABC_ROWS):
        for j, wo in enumerate(VIEWS):
            above = (wi[i, j, :, 2] > 1e-6) & (weight[i, j] > 0)
            cosines = np.cos(np.arccos(np.clip(wi[i, j, above] @ wo, -1, 1)) / 2)
            left = weight[i, j, above] / [physical.conductor(x, eta, 0) for x in cosines]
            assert above.sum() > 50
            assert_allclose(left, left[0], rtol=1e-6)


def test_close_to_the_mirror_no_digits_are_lost():
    """A sharp lobe in single precision, half vectors 1e-4 to 1e-2 off the normal."""
    wi = references.direction(np.geomspace(2e-4, 2e-2, 8), 0.3)
    wo = np.array([0.0, 0.0, 1.0])
    row = (700.0, 5e5, 1.5, 2.0)
    expected = [physical.abc(*row)(w, wo) for w in wi]
    brdf = ABC(*np.float32(row))
    assert_allclose(call(brdf, wi.astype(np.float32), wo.astype(np.float32)), expected, rtol=1e-4)


@pytest.mark.parametrize("family", [ABC, SmoothABC])
@pytest.mark.parametrize(
    ("k", "name", "bound"), [(0, "a", "at least"), (1, "b", "greater"), (2, "c", "at least")]
)
def test_abc_refuses_parameters_without_a_meaning(family, k, name, bound):
    parameters = [1.0, 10.0, 1.0, 1.5]
    parameters[k] = -0.1
    with pytest.raises(ValueError, match=f"{family.__name__}: {name} must be {bound}"):
        family(*parameters)
    with pytest.raises(ValueError, match="eta must be greater"):
        family(1.0, 10.0, 1.0, 0.0)


# Sun's rough metal


@eqx.filter_jit
def as_printed(rows, wi, wo):
    """ρ and f (rows, N)."""

    def both(row):
        brdf = rough_metal(*row)
        return brdf.as_printed(wi, wo), brdf(wi, wo)

    return jax.vmap(both)(rows)


def test_as_printed_is_equation_3_5_3_and_not_the_usual_reflectance():
    """ρ = f cos θ_i · cos θ_h cos θ_o / cos θ_d, all of it by numpy but f and ρ; 0 below the horizon."""
    wi, wo = (np.concatenate([PAIRS[k], PAIRS[1 - k], SEAMS[k]]) for k in (0, 1))
    rho, f = (np.asarray(a) for a in as_printed(METALS, wi, wo))
    pairs = len(PAIRS[0])
    expected = [[physical.sun_as_printed(*row)(i, o) for i, o in zip(*PAIRS, strict=True)] for row in METALS]
    assert_allclose(rho[:, :pairs], expected, rtol=1e-8)
    assert_allclose(rho[:, pairs : 2 * pairs], expected, rtol=1e-8)
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    length = np.linalg.norm(wi + wo, axis=-1)[above]
    cos_h, cos_d = (wi + wo)[above, 2] / length, length / 2
    assert_allclose((f * wi[:, 2] * wo[:, 2])[:, above] * cos_h / cos_d, rho[:, above], rtol=1e-8)
    assert_array_equal(rho[:, ~above], 0)
    assert np.all(rho[:, (wi[:, 2] == 1) & (wo[:, 2] == 1)] > 0)


def test_as_printed_has_channels_and_refuses_vectors_of_other_lengths():
    gold = RoughMetal(3.0, jb.Conductor(jnp.array([0.2, 0.4, 1.4]), jnp.array([3.1, 2.4, 1.8])))
    rho = eqx.filter_jit(RoughMetal.as_printed)(gold, *PAIRS)
    grey = [physical.sun_as_printed(3.0, 1.4, 1.8)(i, o) for i, o in zip(*PAIRS, strict=True)]
    assert rho.shape == (len(grey), 3)
    assert_allclose(rho[:, 2], grey, rtol=1e-8)
    with pytest.raises(ValueError, match="unit vectors"):
        gold.as_printed(2 * VIEWS, VIEWS)


def test_rough_metal_is_mirror_facets_of_the_slopes_that_sun_states():
    same = jb.Microfacet(jb.Beckmann(2 / 3), jb.Conductor(*GOLD), jb.FreeTravel(3.0))
    assert_allclose(call(rough_metal(3.0, *GOLD), *PAIRS), call(same, *PAIRS), rtol=1e-12)
    with pytest.raises(ValueError, match="smoothness must be greater than 0"):
        rough_metal(0.0, *GOLD)


# Kirchhoff


TABLES, WAVELENGTHS_Q = physical.tables(), physical.WAVELENGTHS_Q
MIRROR = jb.Constant(1.0)


def test_equal_tables_are_one_distribution():
    """Whatever the wavelength, it is the microfacet formula of the table."""
    table = TABLES[1]
    brdf = KirchhoffBRDF(np.stack([table] * 3), WAVELENGTHS_Q, np.array([0.3, 0.55, 2.0]), jb.Schlick(0.6))
    facets = jb.Microfacet(jb.TabulatedNDF(table), jb.Schlick(0.6))
    expected = np.asarray(call(facets, *PAIRS))
    assert np.sum(expected > 1e-3) >= 10
    assert_allclose(call(brdf, *PAIRS), np.stack([expected] * 3, axis=-1), rtol=1e-12)


def test_a_spectrum_trails_and_each_wavelength_is_alone():
    wavelengths = np.array([0.35, 0.5, 0.65, 0.8])
    brdf = kirchhoff(wavelengths, 0.8)
    expected = [[physical.kirchhoff(x, 0.8)(i, o) for x in wavelengths] for i, o in zip(*PAIRS, strict=True)]
    assert_allclose(call(brdf, *PAIRS), expected, rtol=1e-8)


def test_the_effective_wavelength_grows_with_the_angle_between_the_directions():
    """θ_d = 60° doubles it: 0.3 µm is looked up at 0.6 µm, and 0.36 µm halfway between 1/0.6 and 1/0.9."""
    n = np.array([0.0, 0.0, 1.0])
    wi = references.direction(np.pi / 3, 0.0)
    wo = wi * [-1, -1, 1]
    D = [physical.cell_value(table, n) for table in TABLES]
    for wavelength, expected in [(0.3, D[1]), (0.36, (D[1] + D[2]) / 2), (0.1, D[0]), (5.0, D[2])]:
        brdf = KirchhoffBRDF(TABLES, WAVELENGTHS_Q, wavelength, MIRROR, jb.Unshadowed())
        assert_allclose(call(brdf, wi, wo), expected, rtol=1e-9)  # 4 cos θ_i cos θ_o = 1


def test_one_table_serves_all_wavelengths():
    brdf = KirchhoffBRDF(TABLES[:1], WAVELENGTHS_Q[:1], np.array([0.2, 0.9]), MIRROR)
    expected = call(jb.Microfacet(jb.TabulatedNDF(TABLES[0]), MIRROR), *PAIRS)
    assert_allclose(call(brdf, *PAIRS), np.stack([expected] * 2, axis=-1), rtol=1e-12)


def test_shadowing_takes_another_distribution_and_sampling_does_not():
    brdf = kirchhoff(0.5, 1.0)
    tabulated = replace(brdf, ndf=jb.tabulate_projected_area(brdf.mean_ndf, (17, 24)))
    assert_allclose(call(tabulated, *PAIRS), call(brdf, *PAIRS), rtol=2e-2)
    rough = replace(brdf, ndf=jb.Beckmann(1.0))
    G, smooth = jb.Uncorrelated()(jb.Beckmann(1.0), *PAIRS), replace(brdf, shadowing=jb.Unshadowed())
    assert_allclose(call(rough, *PAIRS), call(smooth, *PAIRS) * G, rtol=1e-12)
    assert_array_equal(density(rough, *PAIRS), density(brdf, *PAIRS))


def test_kirchhoff_samples_are_unbiased_and_miss_no_cell_that_reflects():
    """The mean against a sum over half vectors, dω_o = 4 (wi·h) dA / h_z; one table is half empty."""
    empty = TABLES[0] * (np.arange(physical.CELLS) > 16)
    brdf = KirchhoffBRDF(np.stack([empty, TABLES[2]]), WAVELENGTHS_Q[[0, 2]], 0.35, MIRROR, jb.Unshadowed())
    wo = VIEWS[1]
    _, weight = sampled(lambda: brdf, np.zeros((1, 0)), U, wo[None])
    weight = np.asarray(weight)[0, 0]
    fine = (2 * np.arange(330) + 1) / 330 - 1
    h = np.stack([*np.meshgrid(fine, fine), np.zeros((330, 330))], axis=-1).reshape(-1, 3)
    h = h[np.sum(h**2, axis=-1) < 1 - 1e-6]
    h[:, 2] = np.sqrt(1 - np.sum(h**2, axis=-1))
    light = 2 * (h @ wo)[:, None] * h - wo
    f = np.asarray(call(brdf, light, wo[None]))
    pdf = np.asarray(density(brdf, light, wo[None]))
    assert np.all(pdf[f > 0] > 0)
    expected = np.sum(f * np.maximum(light[:, 2], 0) * 4 * np.abs(h @ wo) / h[:, 2]) * (2 / 330) ** 2
    assert abs(weight.mean() - expected) < 4.5 * weight.std() / np.sqrt(len(U)) + 2e-3 * expected
    assert weight.std() < weight.mean()
    inside = np.sum(pdf * 4 * np.abs(h @ wo) / h[:, 2]) * (2 / 330) ** 2
    assert 0.9 < inside < 1 + 1e-3


def test_a_million_pairs_of_a_spectrum_stay_small():
    brdf = kirchhoff(np.linspace(0.4, 0.7, 5), 0.9)
    brdf = replace(brdf, ndf=jb.tabulate_projected_area(brdf.mean_ndf, (17, 24)))
    pairs = jax.ShapeDtypeStruct((1_000_000, 3), jnp.float64)
    compiled = jax.jit(lambda wi, wo: brdf(wi, wo)).lower(pairs, pairs).compile()
    assert compiled.memory_analysis().temp_size_in_bytes < 2e9


def test_kirchhoff_refuses_tables_and_wavelengths_that_do_not_belong_together():
    def make(values=TABLES, wavelengths_q=WAVELENGTHS_Q, wavelengths=0.5):
        return KirchhoffBRDF(values, wavelengths_q, wavelengths, MIRROR)

    for wrong, message in [
        ({"wavelengths_q": WAVELENGTHS_Q[::-1]}, "must increase"),
        ({"wavelengths_q": WAVELENGTHS_Q[[0, 0, 1]]}, "must increase"),
        ({"wavelengths_q": WAVELENGTHS_Q - 0.4}, "wavelengths_q must be greater than 0"),
        ({"wavelengths_q": WAVELENGTHS_Q[:2]}, r"one wavelength for each of the 3 tables.*found \(2,\)"),
        ({"wavelengths": -0.5}, "wavelengths must be greater than 0"),
        ({"values": -TABLES}, "values must be at least 0"),
        ({"values": TABLES[0]}, r"shape \(L, N, N\); found \(33, 33\)"),
        ({"values": TABLES[:, :5]}, r"shape \(L, N, N\); found \(3, 5, 33\)"),
    ]:
        with pytest.raises(ValueError, match=message):
            make(**wrong)
