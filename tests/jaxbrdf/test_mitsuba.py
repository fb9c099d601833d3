"""Beckmann and Trowbridge–Reitz against Mitsuba 3, which has them in single precision; skips without it."""

import equinox as eqx
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxbrdf as jb
from tests import references

mitsuba = pytest.importorskip("mitsuba")
mitsuba.set_variant("scalar_rgb")  # needs no compiler on the machine; a few hundred calls a test

KINDS = {
    jb.Beckmann: ("Beckmann", references.beckmann),
    jb.TrowbridgeReitz: ("GGX", references.trowbridge_reitz),
}
CASES = [(make, alphas) for make in KINDS for alphas in [(0.3,), (0.1, 0.5)]]
every_case = pytest.mark.parametrize(
    ("make", "alphas"), CASES, ids=[f"{make.__name__}{alphas}" for make, alphas in CASES]
)
RNG = np.random.default_rng(3)
M = references.direction(np.arccos(RNG.uniform(0.05, 1, 300)), RNG.uniform(-np.pi, np.pi, 300))
VIEWS = references.direction(np.array([0.0, 0.5, 1.1, 1.5]), np.array([0.0, 0.3, -2.0, 1.5]))
U = RNG.uniform(size=(4000, 2))


def theirs(make, alphas, visible=True):
    kind = getattr(mitsuba.MicrofacetType, KINDS[make][0])
    return mitsuba.MicrofacetDistribution(kind, alphas[0], alphas[-1], visible)


@eqx.filter_jit
def density_and_area(ndf, m):
    return ndf(m), ndf.projected_area(m)


@every_case
def test_density(make, alphas):
    other = theirs(make, alphas)
    D, _ = density_and_area(make(*alphas), M)
    expected = np.array([other.eval(m) for m in M])
    assert_allclose(D, expected, rtol=2e-4, atol=1e-18)
    assert np.sum(expected > 0) > 100


@every_case
def test_masking(make, alphas):
    """Their G1 is of one facet: ours, σ's, where the facet faces w. Beckmann's is Walter's fit, to 0.4 %."""
    other = theirs(make, alphas)
    _, sigma = density_and_area(make(*alphas), VIEWS)
    for w, area in zip(VIEWS, np.asarray(sigma), strict=True):
        facing = M @ w > 1e-3
        expected = [other.smith_g1(w, m) for m in M[facing]]
        assert_allclose(w[2] / area, expected, rtol=5e-3 if make is jb.Beckmann else 2e-5)


@every_case
def test_densities_of_samples(make, alphas):
    """D (m·n), and (w·m)+ D / σ(w), at Mitsuba's own normals against the density it states for them."""
    for visible in (False, True):
        other = theirs(make, alphas, visible)
        for w in VIEWS if visible else VIEWS[:1]:
            pairs = [other.sample(w, u) for u in U[:100]]
            m, pdf = np.array([np.ravel(m) for m, _ in pairs], float), np.array([p for _, p in pairs])
            D, _ = density_and_area(make(*alphas), m / np.linalg.norm(m, axis=-1, keepdims=True))
            _, sigma = density_and_area(make(*alphas), w[None])
            ours = D * (m @ w) / sigma if visible else D * m[:, 2]
            # Walter's fit of Λ again, and single precision far out in the tail
            assert_allclose(ours, pdf, rtol=6e-3 if make is jb.Beckmann else 1e-3)


@every_case
@pytest.mark.parametrize("view", range(len(VIEWS)))
def test_samples(make, alphas, view):
    """Normals that Mitsuba draws, all and visible ones, are as our density says, by χ²; so are ours."""
    w, reference = VIEWS[view], KINDS[make][1](*alphas)
    bins = references.bins(reference, lambda m: np.maximum(m @ w, 0), rings=8, sectors=6)
    drawn = np.array([np.ravel(theirs(make, alphas).sample(w, u)[0]) for u in U], float)
    assert bins.chi_squared(drawn) > 1e-3
    assert bins.chi_squared(np.asarray(make(*alphas).sample_visible(U, w))) > 1e-3


@pytest.fixture(scope="module")
def pairs():
    """wo and wi above the horizon, of which half are near mirror pairs."""
    wo = references.direction(np.arccos(RNG.uniform(0.1, 1, 200)), RNG.uniform(-np.pi, np.pi, 200))
    wi = references.direction(np.arccos(RNG.uniform(0.1, 1, 200)), RNG.uniform(-np.pi, np.pi, 200))
    wi[:100] = wo[:100] * [-1, -1, 1] + 0.1 * RNG.normal(size=(100, 3))
    wi[:, 2] = np.abs(wi[:, 2])
    return wo, wi / np.linalg.norm(wi, axis=-1, keepdims=True)


@eqx.filter_jit
def reflectance_and_density(brdf, wi, wo):
    return brdf(wi, wo), brdf.pdf(wi, wo)


@every_case
def test_rough_conductor(make, alphas, pairs):
    """f cos θ_i and the density of its samples; they take visible normals and independent heights too."""
    wo, wi = pairs
    eta, kappa = 0.2, 3.9
    other = mitsuba.load_dict(
        {
            "type": "roughconductor",
            "distribution": KINDS[make][0].lower(),
            "alpha_u": alphas[0],
            "alpha_v": alphas[-1],
            "eta": eta,
            "k": kappa,
        }
    )
    f, pdf = reflectance_and_density(jb.Microfacet(make(*alphas), jb.Conductor(eta, kappa)), wi, wo)
    context, interaction = mitsuba.BSDFContext(), mitsuba.SurfaceInteraction3f()
    expected = []
    for o, i in zip(wo, wi, strict=True):
        interaction.wi = o
        value, density = other.eval_pdf(context, interaction, i)
        expected.append((value[0], density))
    value, density = np.array(expected).T
    rtol = 1e-2 if make is jb.Beckmann else 1e-3  # Walter's fit of Λ, twice
    assert_allclose(f * wi[:, 2], value, rtol=rtol, atol=1e-6)
    assert_allclose(pdf, density, rtol=rtol, atol=1e-6)
    assert np.sum(value > 1e-3) > 50
