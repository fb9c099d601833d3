"""Every reflectance's samples: as its density says, and with a mean that is its albedo."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

import jaxbrdf as jb
from jaxbrdf.energy import albedo_by_quadrature
from tests import references
from tests.jaxbrdf.brdf.cases import CASES, every_brdf, every_kind

VIEWS = references.direction(np.array([0.3, 1.1, 1.5, np.radians(89)]), np.array([0.4, -2.0, 1.0, 0.2]))
COUNT = 30_000
U = np.random.default_rng(4).uniform(size=(COUNT, 2))
# a fine grid of the hemisphere, even in cos θ and φ, in whose blocks samples are counted
COS = (np.arange(240) + 0.5) / 240
PHI = (np.arange(480) + 0.5) / 480 * 2 * np.pi
GRID = references.direction(np.arccos(COS)[:, None], PHI[None, :])
D_OMEGA = 2 * np.pi / (len(COS) * len(PHI))
BLOCKS = (12, 16)  # of cos θ and of φ


@eqx.filter_jit
def everything(make, parameters, u, wo):
    """Of one wo: the samples, f cos θ / pdf at them, and f and pdf over the grid."""
    brdf = make(*parameters)
    wo = wo[None]
    wi = brdf.sample(u, wo)
    f, pdf = brdf(wi, wo), brdf.pdf(wi, wo)
    weight = jnp.where(pdf > 0, f * wi[:, 2] / jnp.where(pdf > 0, pdf, 1), 0)
    grid = jnp.asarray(GRID.reshape(-1, 3))
    return wi, weight, brdf(grid, wo), brdf.pdf(grid, wo)


@cache
def sampled(case, view):
    arrays = everything(case.make, jnp.array(case.parameters), U, VIEWS[view])
    return tuple(np.asarray(a) for a in arrays)


every_view = pytest.mark.parametrize("view", range(len(VIEWS) - 1))  # 89° is for energy alone


def in_blocks(values):
    shape = (BLOCKS[0], len(COS) // BLOCKS[0], BLOCKS[1], len(PHI) // BLOCKS[1])
    return values.reshape(shape).sum(axis=(1, 3)).ravel()


def counts(wi):
    i = np.clip((wi[:, 2] * BLOCKS[0]).astype(int), 0, BLOCKS[0] - 1)
    j = np.clip((np.arctan2(wi[:, 1], wi[:, 0]) / (2 * np.pi) % 1 * BLOCKS[1]).astype(int), 0, BLOCKS[1] - 1)
    return np.bincount(i * BLOCKS[1] + j, minlength=BLOCKS[0] * BLOCKS[1])


def chi_squared(observed, expected):
    """The probability of counts as far off; blocks of few are taken together."""
    many = expected > 10
    observed, expected = (np.append(a[many], a[~many].sum()) for a in (observed, expected))
    expected = np.maximum(expected, 1e-9)
    used = expected > 5
    return chi2.sf(np.sum((observed - expected)[used] ** 2 / expected[used]), used.sum() - 1)


def resolved(case):
    """Whether the grid resolves the lobe."""
    return case.parameters[2:3] != (0.014832,)


@every_brdf
@every_view
def test_samples_follow_the_density(case, view):
    """χ² over blocks of the hemisphere, with those below the horizon in a block of their own."""
    wi, _, _, pdf = sampled(case, view)
    assert_allclose(np.linalg.norm(wi, axis=-1), 1, atol=1e-12)
    inside = in_blocks(pdf) * D_OMEGA
    assert inside.sum() < 1 + 2e-3
    if resolved(case):
        above = wi[:, 2] > 0
        observed = np.append(counts(wi[above]), np.sum(~above))
        expected = COUNT * np.append(inside, max(1 - inside.sum(), 0))
        assert chi_squared(observed, expected) > 1e-4


@every_brdf
@every_view
def test_the_mean_over_samples_is_the_albedo(case, view):
    """Against the sum over the grid, and where that is too coarse against the quadrature in half vectors."""
    _, weight, f, _ = sampled(case, view)
    brute = np.sum(f.reshape(GRID.shape[:2]) * COS[:, None]) * D_OMEGA
    expected = (
        brute if resolved(case) else float(albedo_by_quadrature(case.brdf, jnp.asarray(VIEWS[view]))[0])
    )
    assert abs(weight.mean() - expected) < 4.5 * weight.std() / np.sqrt(COUNT) + 1e-3 * expected


@every_kind
def test_what_promises_it_reflects_no_more_than_it_gets(case):
    """White furnace, by the samples, up to 89 degrees."""
    for view in range(len(VIEWS)):
        _, weight, _, _ = sampled(case, view)
        assert np.all(np.isfinite(weight))
        if case.conserves:
            assert weight.mean() < 1 + 4.5 * weight.std() / np.sqrt(COUNT) + 1e-3


def test_the_chi_squared_test_can_fail():
    """Samples of another roughness are found out."""
    case = next(c for c in CASES if str(c).startswith("ggx_facets"))
    _, _, _, pdf = sampled(case, 1)
    wi = np.asarray(everything(case.make, jnp.array([0.12, 0.5, 0.6]), U, VIEWS[1])[0])
    expected = COUNT * in_blocks(pdf) * D_OMEGA
    above = wi[:, 2] > 0
    found = chi_squared(np.append(counts(wi[above]), 0), np.append(expected, 0))
    assert found < 1e-6


def test_a_key_draws_one_direction_for_each():
    brdf, wo = jb.Lambertian(0.5), np.broadcast_to(VIEWS[0], (7, 3))
    new, old = brdf.sample(jax.random.key(3), wo), brdf.sample(jax.random.PRNGKey(3), wo)
    assert new.shape == (7, 3)
    assert_allclose(new, old)
    assert np.all(np.ptp(new, axis=0) > 0)
    assert brdf.sample(jax.random.key(3), VIEWS[0]).shape == (3,)


def test_points_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"u must hold points of .* \(or be a key .* found \(3,\)"):
        jb.Lambertian(0.5).sample(np.full(3, 0.5), VIEWS[0])


def test_below_the_horizon_nothing_is_drawn_with_a_density():
    brdf = jb.Microfacet(jb.TrowbridgeReitz(0.3), jb.Constant(1.0))
    down = np.array([0.6, 0.0, -0.8])
    assert brdf.pdf(down, VIEWS[0]) == 0
    assert brdf.pdf(VIEWS[0], down) == 0
    assert np.all(np.isfinite(brdf.sample(U[:5], down)))


def test_terms_are_drawn_by_their_weights():
    """A bright lobe over a dark diffuse part is nearly always the one that is drawn, and one of two alike."""
    dull, bright = jb.Lambertian(0.001), jb.Microfacet(jb.TrowbridgeReitz(0.01), jb.Constant(0.9))
    mirror = VIEWS[1] * [-1, -1, 1]

    def near_the_mirror(brdf):
        return np.mean(np.asarray(brdf.sample(U[:2000], VIEWS[1][None])) @ mirror > 0.9)

    assert near_the_mirror(dull + bright) > 0.98
    assert near_the_mirror(jb.Lambertian(0.9) + bright) == pytest.approx(0.5, abs=0.1)
    black = jb.Lambertian(0.0) + 0.0 * bright
    assert near_the_mirror(black) == pytest.approx(0.5, abs=0.1)


def test_a_sharp_shifted_gamma_lobe_is_drawn_with_little_variance():
    """Bagher 2012, section 4.5, with the width of GGX from the median: no weight of a thousand."""
    brdf = jb.Microfacet(jb.ShiftedGamma(1.6e-4, 0.38), jb.Constant(1.0))
    _, weight, _, _ = everything(lambda: brdf, (), U, VIEWS[0])
    weight = np.asarray(weight)
    assert weight.mean() == pytest.approx(1, abs=0.01)
    assert weight.std() < 0.6
    assert weight.max() < 10


def test_each_colour_has_its_share_of_directions():
    """Channels of different roughness: the density is the mean of theirs, and each estimate is unbiased."""
    alpha = jnp.array([0.05, 0.2, 0.6])
    brdf = jb.Microfacet(jb.TrowbridgeReitz(alpha), jb.Constant(1.0))
    wo = jnp.asarray(VIEWS[0])[None]
    wi = brdf.sample(U, wo)
    f, pdf = brdf(wi, wo), brdf.pdf(wi, wo)
    weight = np.asarray(jnp.where(pdf > 0, wi[:, 2] / pdf, 0)[:, None] * f)
    expected = np.asarray(albedo_by_quadrature(brdf, jnp.asarray(VIEWS[0]))[0])
    assert_allclose(weight.mean(axis=0), expected, atol=5 * np.max(weight.std(axis=0)) / np.sqrt(COUNT))
    assert weight.max() < 3.01  # each lobe is drawn by a third of them: no estimate is above three
