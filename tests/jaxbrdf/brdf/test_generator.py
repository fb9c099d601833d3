"""Ashikhmin's generator and facets that scatter, against plain numpy; their materials; energy."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from jaxbrdf.brdf.ashikhmin_materials import ASHIKHMIN_MATERIALS, GOLD, ashikhmin_material, star
from jaxbrdf.brdf.facet_scattering import FacetScattering, facet_nodes, to_facet
from jaxbrdf.brdf.generated import CoupledDiffuse, GeneratedBRDF, GeneratedMetal, tabulate_reflectance
from tests import references
from tests.jaxbrdf.brdf.cases import (
    AT_SEAMS,
    EXCHANGED,
    PAIRS,
    PLAIN,
    WI,
    WO,
    Case,
    compiled_quickly,
    evaluated,
)
from tests.jaxbrdf.brdf.truths import generator as truths
from tests.jaxbrdf.brdf.truths.classic import oren_nayar

ROUND, BRUSHED = (0.3, 0.3), (0.2, 0.5)
OBLIQUE = references.direction(
    np.radians([0, 10, 35, 50, 70, 85, 89.5]), np.array([0, 0.3, -2, 1.5, 0.7, 3, -1])
)
FURNACE = references.direction(np.radians([0, 20, 40, 60, 75, 85, 89]), 1.3)


@compiled_quickly
def evaluate(brdf, wi, wo):
    return brdf(wi, wo)


@compiled_quickly
def scattered(brdf, w):
    """∫ f cos θ_o dω_o of something diffuse, for directions (n, 3)."""
    wo, d_omega = jb.hemisphere(96, 64)
    return brdf(w[:, None], wo[None]) @ (wo[:, 2] * d_omega)


def beckmann(alphas):
    return jb.Beckmann(alphas[0]) if alphas[0] == alphas[1] else jb.Beckmann(*alphas)


@cache
def table(alphas):
    with jax.ensure_compile_time_eval():
        return tabulate_reflectance(beckmann(alphas), facets=8192 if alphas == ROUND else 4096)


def in_precision_of(parameter, tree):
    return jax.tree.map(lambda leaf: leaf.astype(parameter.dtype), tree)


def generated(alphas, f0, rho_d):
    ndf, reflectance = in_precision_of(f0, (beckmann(alphas), table(alphas)))
    return GeneratedBRDF(ndf, f0, rho_d, reflectance=reflectance)


def metal(alphas, f0):
    ndf, reflectance = in_precision_of(f0, (beckmann(alphas), table(alphas)))
    return GeneratedMetal(ndf, f0, reflectance=reflectance)


def lambertian_facets(alpha_x, alpha_y, albedo):
    return FacetScattering(jb.Beckmann(alpha_x, alpha_y), jb.Lambertian(albedo))


PLASTIC = Case(partial(generated, ROUND), (0.3, 0.8), partial(truths.generated, *ROUND), error=2e-4)
METAL = Case(partial(metal, BRUSHED), (0.9,), partial(truths.generated_metal, *BRUSHED), error=5e-4)
MATTE = Case(lambertian_facets, (0.2, 0.5, 0.7), truths.lambertian_facets, error=1e-3)
every_case = pytest.mark.parametrize(
    "case", [PLASTIC, METAL, MATTE], ids=["round plastic", "brushed metal", "brushed matte"]
)


def truth(case, *parameters):
    f = case.reference(*(parameters or case.parameters))
    return np.array([f(i, o) for i, o in zip(*PAIRS, strict=True)])


@every_case
def test_value_is_plain_numpys(case):
    f = evaluated(case).value
    assert_allclose(f[PLAIN], truth(case), rtol=case.error, atol=5e-5)
    assert_allclose(f[PLAIN], f[EXCHANGED], rtol=1e-12)


@every_case
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_at_and_below_the_horizon_it_is_zero_and_all_is_finite(case, dtype):
    at = evaluated(case, dtype)
    dark = (WI[:, 2] <= 0) | (WO[:, 2] <= 0)
    assert_array_equal(at.value[dark], 0)
    assert np.all(at.value[AT_SEAMS] >= 0)
    for a in (at.value, at.by_parameter, at.by_wi, at.by_wo):
        assert a.dtype == dtype
        assert np.all(np.isfinite(a))
    assert_allclose(at.value[PLAIN], evaluated(case).value[PLAIN], rtol=2e-3)


@every_case
def test_derivatives_by_the_parameters(case):
    """By central differences of the plain numpy formula; those by the widths include the facets' weights."""
    for i, p in enumerate(case.parameters):
        step = 1e-3 * p
        up, down = (
            truth(case, *(q + s * step * (i == j) for j, q in enumerate(case.parameters))) for s in (1, -1)
        )
        expected = (up - down) / (2 * step)
        scale = np.abs(evaluated(case).value[PLAIN]) / p
        assert_allclose(
            evaluated(case).by_parameter[i, PLAIN] / scale, expected / scale, atol=20 * case.error
        )


# The tables


@pytest.mark.parametrize("alphas", [ROUND, BRUSHED], ids=str)
def test_the_tables_are_plain_numpys(alphas):
    """R_0 and R_1 to 2e-4, between the nodes and down to grazing incidence; a colour's R is between them."""
    expected = np.array([truths.reflectances(*alphas, tuple(w)) for w in OBLIQUE])
    found = table(alphas)(np.array([0.0, 1.0, 0.25]), OBLIQUE)
    assert_allclose(found[:, :2], expected, atol=2e-4)
    assert_allclose(found[:, 2], 0.75 * found[:, 0] + 0.25 * found[:, 1], rtol=1e-12)


@pytest.mark.slow
def test_grooves_with_correlated_shadowing_reflect_what_the_table_says():
    """f itself summed over a fine grid of half vectors on each side of the grooves, one at a time."""
    ndf, angle, sigma = jb.VGrooves(0.7, 0.2), 0.7, 0.2
    facets = jb.Microfacet(jb.tabulate_projected_area(ndf), jb.Constant(1.0), jb.AzimuthCorrelated())
    piece = references.gaussian_microfacets(sigma)
    t = (np.arange(240) + 0.5) / 240 * 12 - 6
    slopes = np.stack([*np.meshgrid(sigma * t, sigma * t), np.ones((240, 240))], axis=-1).reshape(-1, 3)
    slopes /= np.linalg.norm(slopes, axis=-1, keepdims=True)
    d_omega = slopes[:, 2] ** 3 * (sigma * 12 / 240) ** 2
    share = piece(slopes) / (2 * np.cos(angle))  # of D, the other side's being nothing

    @compiled_quickly
    def reflected(w, h):
        wo = jb.reflect(w, h)
        D = jnp.maximum(facets.ndf(h), 1e-300)
        return jnp.sum(facets(w, wo) / D * share * jnp.maximum(wo[:, 2], 0) * 4 * (h @ w[0]) * d_omega)

    found = tabulate_reflectance(facets.ndf, facets.shadowing, facets=4096)(1.0, OBLIQUE)
    sides = [slopes @ references.rotation("y", s * angle).T for s in (1, -1)]
    expected = [sum(reflected(w[None], h) for h in sides) for w in OBLIQUE]
    assert_allclose(found, expected, atol=2e-3)


def test_the_generation_is_differentiable_by_the_distribution():
    """By central differences of numpy's R."""

    def R(alpha):
        return tabulate_reflectance(jb.Beckmann(alpha), nodes=(17, 1), facets=4096)(0.2, OBLIQUE[:6])

    found = compiled_quickly(jax.jacfwd(R))(0.3)
    up, down = ([truths.reflectance(a, a, 0.2, w) for w in OBLIQUE[:6]] for a in (0.303, 0.297))
    assert_allclose(found, np.subtract(up, down) / 0.006, atol=3e-3)


def test_a_distribution_of_several_colours_has_a_table_of_each():
    f0, rho_d = jnp.array([0.9, 0.5, 0.1]), 0.4
    quick = partial(tabulate_reflectance, nodes=(9, 1), facets=512)
    rgb = jb.Beckmann(jnp.array([0.1, 0.3, 0.5]))
    one = jb.Beckmann(0.3)
    found = evaluate(GeneratedBRDF(rgb, f0, rho_d, reflectance=quick(rgb)), *PAIRS)
    assert found.shape == (16, 3)
    alone = evaluate(GeneratedBRDF(one, f0[1], rho_d, reflectance=quick(one)), *PAIRS)
    assert_allclose(found[:, 1], alone, rtol=1e-10)


def test_shares_outside_zero_to_one_are_refused():
    with pytest.raises(ValueError, match=r"rho_d must be at least 0 and at most 1; found 1.2"):
        GeneratedBRDF(beckmann(ROUND), 0.1, 1.2, reflectance=table(ROUND))
    with pytest.raises(ValueError, match=r"f0 must be .* found -0.1"):
        GeneratedMetal(beckmann(ROUND), -0.1, reflectance=table(ROUND))


def test_a_table_of_too_few_nodes_is_refused():
    with pytest.raises(ValueError, match=r"at least 6 polar angles and 6 azimuths.* found \(5, 8\)"):
        tabulate_reflectance(jb.Beckmann(0.1, 0.2), nodes=(5, 8))
    with pytest.raises(ValueError, match=r"found \(10, 1\)"):
        tabulate_reflectance(jb.Beckmann(0.1, 0.2), nodes=(10, 1))


# Energy


@pytest.mark.parametrize("f0", [0.05, 1.0])
@pytest.mark.parametrize("alphas", [ROUND, BRUSHED], ids=str)
def test_facets_and_a_white_diffuse_term_reflect_all_light(alphas, f0):
    """From every direction, and so on average: ρ_s by numpy, the diffuse term summed over the hemisphere."""
    mirrored = [truths.reflectance(*alphas, f0, w) for w in FURNACE]
    diffuse = CoupledDiffuse(table(alphas), f0, 1.0)
    assert_allclose(scattered(diffuse, FURNACE) + np.array(mirrored), 1, atol=3e-4)


def test_half_the_light_left_over_is_scattered_by_a_grey_diffuse_term():
    grey = CoupledDiffuse(table(BRUSHED), 0.05, 0.5)
    weight = grey._weight(jnp.asarray(OBLIQUE))
    assert_allclose(weight, 0.5 * (1 - table(BRUSHED)(0.05, OBLIQUE)), rtol=1e-12)
    assert_allclose(scattered(grey, OBLIQUE), weight, rtol=1e-4)


def test_a_metal_that_reflects_more_than_f0_has_no_diffuse_term():
    """Towards grazing incidence F exceeds f_0: (f_0 − R)+ = 0; a smooth metal has none at all."""
    diffuse, _ = metal(ROUND, jnp.array(0.2)).parts
    grazing, normal = OBLIQUE[-1], OBLIQUE[0]
    assert table(ROUND)(0.2, grazing) > 0.2
    assert evaluate(diffuse, grazing, normal) == 0
    assert evaluate(diffuse, normal, normal) > 0
    smooth = CoupledDiffuse(tabulate_reflectance(jb.Beckmann(1e-3), nodes=(65, 1), facets=512), 0.9, 0.9, 0.9)
    assert_allclose(evaluate(smooth, OBLIQUE, OBLIQUE), 0, atol=1e-6)


class Ratio(jb.AbstractShadowing):
    """cos θ / σ in both directions, as the paper has it: not clipped at 1."""

    def _shadow(self, ndf, wi, wo):
        return wi[..., 2] / ndf.projected_area(wi) * wo[..., 2] / ndf.projected_area(wo)


@pytest.mark.slow
def test_slanted_velvet_reflects_too_much_unless_masking_is_at_most_one():
    """Section 6.4: at some of 10 × 20 directions R_1 exceeds 1 with the paper's ratio; never with G1."""
    velvet = jb.tabulate_projected_area(jb.SlantedVelvet(np.radians(40), 0.5))
    theta, phi = np.radians(np.arange(10) * 9.0)[:, None], np.radians(np.arange(20) * 18.0)[None, :]
    w = references.direction(theta, phi)
    excess = tabulate_reflectance(velvet, Ratio(), (25, 32), 2048)(1.0, w) > 1
    assert 24 <= np.sum(excess) <= 32  # the paper has 14, on a grid that it does not describe
    assert np.all(w[..., 0][excess] > 0)  # where the fibres lean
    assert np.max(tabulate_reflectance(velvet, jb.Uncorrelated(), (25, 32), 2048)(1.0, w)) < 1


# Facets that scatter


def test_a_rough_matte_surface_is_brighter_towards_the_light():
    """Fig. 8: Lambertian facets of a Gaussian surface against brute force, and near Oren & Nayar's model."""
    density = references.gaussian_microfacets(1.0)
    m, area = truths.facets(density)
    angles = np.radians([30, 60, 75])
    w = references.direction(angles, 0.4)
    away = w * [-1, -1, 1]
    ndf = jb.GaussianMicrofacets(1.0)
    wi, wo = np.concatenate([w, w]), np.concatenate([w, away])
    sigma = [references.projected_area(density, v) for v in w] * 2
    integral = [
        np.sum(area * np.maximum(m @ a, 0) * np.maximum(m @ b, 0)) for a, b in zip(wi, wo, strict=True)
    ]
    found = np.pi * evaluate(FacetScattering(ndf, jb.Lambertian(1.0), nodes=16384), wi, wo)
    assert_allclose(found, np.array(integral) / np.square(sigma), rtol=3e-3)
    back, forth = found[:3], found[3:]
    assert np.all(back > 1.1 * forth)
    correlated = np.pi * evaluate(FacetScattering(ndf, jb.Lambertian(1.0), jb.AzimuthCorrelated()), w, w)
    assert_allclose(correlated, [np.pi * oren_nayar(1.0, 0.6)(v, v) for v in w], rtol=0.06)


def test_mirrorlike_facets_are_a_microfacet_surface():
    """The narrower the facets' lobe, the nearer."""
    ndf, wi = jb.Beckmann(0.4), references.direction(0.5, 0.0)
    wo = references.direction(np.array([0.3, 0.6, 0.9]), np.array([3.0, 2.0, -2.5]))
    mirrors = jb.Microfacet(ndf, jb.Constant(1.0))(wi, wo)

    def error(exponent):
        lobe = jb.Microfacet(jb.BlinnPhong(exponent), jb.Constant(1.0), jb.Unshadowed())
        return np.abs(evaluate(FacetScattering(ndf, lobe, nodes=16384), wi, wo) / mirrors - 1)

    dull, bright = error(100.0), error(1600.0)
    assert np.all(bright < 6e-3)
    assert np.all(bright < dull / 8)


def test_flat_facets_keep_their_own_reflectance():
    """A nearly flat surface of brushed facets: the frame of a facet is that of the surface, tangent too."""
    brushed = jb.Ward(0.1, 0.4)
    found = evaluate(FacetScattering(jb.Beckmann(1e-4), brushed, jb.Unshadowed()), *PAIRS)
    assert_allclose(found, brushed(*PAIRS), rtol=1e-4, atol=1e-9)


def test_the_frame_of_a_facet_is_the_shortest_turn():
    """Rodrigues' rotation about n × m takes n to m; its inverse takes directions to the frame."""
    m = references.direction(np.array([0.0, 0.3, 1.2, 2.0]), np.array([0.0, 1.0, -2.0, 0.5]))
    for facet in m:
        x, y, z = np.cross([0, 0, 1], facet)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn = np.eye(3) + cross + cross @ cross / (1 + facet[2])
        assert_allclose(turn @ [0, 0, 1], facet, atol=1e-12)
        assert_allclose(to_facet(jnp.asarray(OBLIQUE), jnp.asarray(facet)), OBLIQUE @ turn, atol=1e-12)
    down = to_facet(jnp.asarray(OBLIQUE), jnp.array([0.0, 0.0, -1.0]))
    assert_allclose(down, OBLIQUE * [1, 1, -1])


def test_facet_nodes_find_sharp_peaks_and_what_looks_below_the_horizon():
    """The sum of D dm over them is the area of all facets, that of D m dm their mean normal."""
    for ndf, density, error in (
        (jb.Beckmann(1e-5), references.beckmann(1e-5), 1e-6),
        (jb.SlantedVelvet(0.7, 0.5), references.slanted_velvet(0.7, 0.5), 3e-3),
    ):
        m, area = compiled_quickly(facet_nodes)(ndf, 4096)
        normals, areas = truths.facets(density)
        assert m.shape == (4096, 3)
        assert_allclose(np.sum(area), np.sum(areas), rtol=error)
        assert_allclose(area @ m, areas @ normals, atol=error)


def test_facets_and_their_reflectance_may_both_have_colours():
    alpha, albedo = jnp.array([0.1, 0.3, 0.5]), jnp.array([0.2, 0.5, 0.9])
    rgb = evaluate(FacetScattering(jb.Beckmann(alpha), jb.Lambertian(albedo), nodes=512), *PAIRS)
    alone = evaluate(FacetScattering(jb.Beckmann(0.3), jb.Lambertian(0.5), nodes=512), *PAIRS)
    assert rgb.shape == (16, 3)
    assert_allclose(rgb[:, 1], alone, rtol=1e-12)


# Materials


def test_gold_is_that_of_the_optical_constants():
    pytest.importorskip("colour")
    from data_loaders import optical_constants

    eta, kappa = optical_constants("Au")
    assert_allclose(GOLD, ((eta - 1) ** 2 + kappa**2) / ((eta + 1) ** 2 + kappa**2), atol=1e-4)


def test_an_unknown_material_is_answered_with_the_names():
    with pytest.raises(
        ValueError, match=r"no material 'silk'; there are: anisotropic-gold, .*image-modulated"
    ):
        ashikhmin_material("silk")


def test_the_star_has_five_rays():
    image = star(65)
    assert image.shape == (65, 65)
    assert np.min(image) >= 0
    ring = [image[round(32 + 12 * np.sin(a)), round(32 + 12 * np.cos(a))] for a in np.arange(10) * np.pi / 5]
    assert np.all(np.array(ring[::2]) > 5 * np.array(ring[1::2]))


@pytest.mark.slow
@pytest.mark.parametrize("name", ASHIKHMIN_MATERIALS)
def test_materials_are_ready_to_use(name):
    """RGB, reciprocal, finite, of a colour; and the light that they reflect is no more than they get."""
    brdf = ashikhmin_material(name, nodes=(17, 24), facets=2048)

    f, exchanged = evaluate(brdf, *PAIRS), evaluate(brdf, PAIRS[1], PAIRS[0])
    assert f.shape == (16, 3)
    assert np.all(np.isfinite(f))
    assert np.all(f >= 0)
    assert np.all(f[:, 0] >= f[:, 2])  # all are reddish, or golden
    assert np.any(f[:, 0] > 1.5 * f[:, 2])
    assert_allclose(f, exchanged, rtol=1e-10, atol=1e-14)
    w = np.concatenate([FURNACE, OBLIQUE])
    assert np.max(brdf.reflectance(1.0, w)) < 1 + 1e-3
