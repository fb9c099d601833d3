"""Every distribution × every property that a distribution has; a new one is a line in CASES."""

from dataclasses import dataclass
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

import jaxbrdf as jb
from tests import references


@dataclass(frozen=True)
class Case:
    name: str
    ndf: jb.AbstractNDF
    density: references.Density
    area_error: float = 1e-8  # relative, above the horizon

    def __str__(self):
        return self.name


CASES = [
    *(
        Case(f"SGD {a:g} {p:g}", jb.ShiftedGamma(a, p), references.sgd(a, p))
        for a, p in references.PUBLISHED_LOBES
    ),
    Case(
        "SGD 0.2 1.8, tabulated area",
        jb.tabulate_projected_area(jb.ShiftedGamma(0.2, 1.8)),
        references.sgd(0.2, 1.8),
        area_error=1e-7,
    ),
]
every_ndf = pytest.mark.parametrize("case", CASES, ids=str)

POLAR = np.array([0.0, 1e-6, 3e-3, 0.2, 0.8, 1.3, 1.55, np.pi / 2 - 1e-7])
WAVES = jnp.asarray(references.direction(POLAR, np.linspace(-2, 2, len(POLAR))))
SEAMS = jnp.array(  # normal incidence; grazing, exactly and nearly; below the horizon; the nadir
    [
        [0.0, 0.0, 1.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 1e-9],
        [0.0, 1.0, 6e-17],
        [0.6, 0.0, -0.8],
        [0.0, 0.0, -1.0],
    ]
)


@eqx.filter_jit
def density(ndf, m):
    return ndf(m)


@eqx.filter_jit
def projected_area(ndf, w):
    return ndf.projected_area(w)


@eqx.filter_jit
def sample(ndf, u):
    return ndf.sample(u)


@every_ndf
def test_density_is_the_reference(case):
    theta = np.concatenate(
        [[0], np.geomspace(1e-7, 1.5, 60), [1.57, np.pi / 2 - 1e-9, np.pi / 2, 1.7, np.pi]]
    )
    m = references.direction(theta, np.linspace(-3, 3, len(theta)))
    expected = case.density(m)
    assert_allclose(density(case.ndf, jnp.asarray(m)), expected, rtol=1e-10, atol=1e-290)
    assert_array_equal(expected[m[:, 2] <= 0], 0)
    assert np.sum(expected > 0) > 30


@every_ndf
def test_normalised(case):
    """∫ D(m) (m·n) dm = 1, signed, over the whole sphere."""

    def integrand(m):
        m = jnp.asarray(m)
        return np.asarray((density(case.ndf, m) - density(case.ndf, -m)) * m[..., 2])

    assert_allclose(references.hemisphere_integral(integrand), 1, rtol=1e-10)


@every_ndf
def test_projected_area_is_brute_force(case):
    expected = [references.projected_area(case.density, w) for w in np.asarray(WAVES)]
    assert_allclose(projected_area(case.ndf, WAVES), expected, rtol=case.area_error)


@every_ndf
def test_projected_area_below_the_horizon(case):
    """σ(−w) = σ(w) − w·n, and never below either."""
    above, below = projected_area(case.ndf, WAVES), projected_area(case.ndf, -WAVES)
    assert_allclose(below, above - WAVES[:, 2], rtol=1e-12, atol=1e-14)
    assert np.all(above >= WAVES[:, 2] - 1e-14)
    assert np.all(below >= -1e-14)


@every_ndf
def test_projected_area_has_the_gradient_of_brute_force(case):
    """dσ/dθ by central differences of the reference, at grazing too, where both sides must meet."""
    theta = np.array([0.3, 1.1, 1.5, np.pi / 2])
    step = 1e-4

    def reference(t):
        return np.array([references.projected_area(case.density, references.direction(a, 0.0)) for a in t])

    slope = (reference(theta + step) - reference(theta - step)) / (2 * step)

    def area(t):
        return projected_area(case.ndf, jb.spherical(t, 0.0))

    # where σ bends faster than `step` the difference is the wrong truth: sharp lobes at grazing
    bend = np.abs(reference(theta + step) - 2 * reference(theta) + reference(theta - step)) / step
    smooth = bend < 1e-2
    assert smooth.sum() >= 3
    assert_allclose(jax.vmap(jax.grad(area))(jnp.asarray(theta))[smooth], slope[smooth], rtol=1e-5, atol=1e-6)


@every_ndf
def test_projected_area_at_grazing_has_slope_one_half(case):
    """σ(−w) = σ(w) − w·n makes dσ/dcos θ = 1/2 at the horizon, for every symmetric distribution."""
    slope = jax.grad(lambda z: projected_area(case.ndf, jnp.stack([1.0, 0.0, z])))(0.0)
    assert_allclose(slope, 0.5, atol=1e-9)


def bins(case):
    """Edges in θ that split the probability D cos dω about evenly, and the exact share of each bin."""
    theta, d_theta = references.graded_nodes([0, np.pi / 2])

    def share(theta, weight):
        ring = 2 * np.pi * np.sin(theta) * weight
        return case.density(references.direction(theta, 0.0)) * np.cos(theta) * ring

    cumulative = np.cumsum(share(theta, d_theta))
    edges = np.concatenate([[0], np.interp(np.linspace(0, 1, 13)[1:-1], cumulative, theta), [np.pi / 2]])
    pieces = [references.graded_nodes([a, b]) for a, b in pairwise(edges)]
    return edges, np.array([np.sum(share(*piece)) for piece in pieces])


def chi_squared(case, m, n_phi=8):
    """The probability of a histogram in (θ, φ) as far off as that of the normals m, were they from `case`."""
    edges, share = bins(case)
    theta, phi = np.arctan2(np.hypot(m[:, 0], m[:, 1]), m[:, 2]), np.arctan2(m[:, 1], m[:, 0])
    counts, _, _ = np.histogram2d(theta, phi, [edges, np.linspace(-np.pi, np.pi, n_phi + 1)])
    expected = np.broadcast_to(len(m) * share[:, None] / n_phi, counts.shape)
    return chi2.sf(np.sum((counts - expected) ** 2 / expected), counts.size - 1)


@pytest.fixture(scope="module")
def uniform():
    return jax.random.uniform(jax.random.key(20120), (40_000, 2))


@every_ndf
def test_samples_follow_the_density(case, uniform):
    m = np.asarray(sample(case.ndf, uniform))
    assert_allclose(np.linalg.norm(m, axis=-1), 1, atol=1e-14)
    assert np.all(m[:, 2] > 0)
    assert chi_squared(case, m) > 1e-3


def test_the_chi_squared_test_can_fail(uniform):
    m = np.asarray(sample(jb.ShiftedGamma(0.2, 1.7), uniform))
    assert chi_squared(Case("wrong p", None, references.sgd(0.2, 1.8)), m) < 1e-6


@every_ndf
def test_sampling_stands_the_ends_of_the_unit_square(case):
    u = jnp.array([[0.0, 0.0], [1 - 2**-53, 0.5], [0.0, 1 - 2**-53]])
    m = sample(case.ndf, u)
    assert np.all(np.isfinite(m))
    assert_allclose(m[0], [0, 0, 1], atol=1e-6)


@eqx.filter_jit
def values_and_gradients(ndf, m):
    """What D and σ, and their gradients by every parameter and by the direction, are at each direction."""

    def both(ndf, m):
        return jnp.stack([ndf(m), ndf.projected_area(m)])

    return jax.vmap(lambda m: (both(ndf, m), jax.jacrev(both)(ndf, m), jax.jacrev(both, 1)(ndf, m)))(m)


@every_ndf
def test_values_and_gradients_are_finite_at_the_seams(case):
    for leaf in jax.tree.leaves(values_and_gradients(case.ndf, jnp.concatenate([SEAMS, WAVES]))):
        assert np.all(np.isfinite(leaf))


@every_ndf
def test_density_is_zero_at_and_below_the_horizon(case):
    assert_array_equal(density(case.ndf, SEAMS[jnp.array([1, 3, 4, 5])]), 0)


def scaled(ndf, factor):
    return jax.tree.map(lambda leaf: leaf * factor, ndf)


@every_ndf
def test_channels_are_models_of_their_own(case):
    factors = (1.0, 0.9, 0.8)
    rgb = jax.tree.map(lambda leaf: jnp.stack([leaf * f for f in factors], axis=-1), case.ndf)
    m, u = WAVES.reshape(2, -1, 3), jnp.linspace(0.05, 0.9, 10).reshape(5, 2)
    assert density(rgb, m).shape == (2, len(WAVES) // 2, 3)
    for evaluate, at in [(density, m), (projected_area, m), (sample, u)]:
        apart = jnp.stack([evaluate(scaled(case.ndf, f), at) for f in factors], axis=-1)
        assert_allclose(evaluate(rgb, at), apart, rtol=1e-12, atol=1e-14)


@every_ndf
def test_a_batch_is_a_vmap_over_the_leaves(case):
    factors = jnp.array([1.0, 0.7])
    batch = jax.vmap(lambda f: scaled(case.ndf, f))(factors)
    for evaluate in (density, projected_area):
        apart = jnp.stack([evaluate(scaled(case.ndf, f), WAVES) for f in factors])
        assert_allclose(jax.vmap(evaluate, (0, None))(batch, WAVES), apart, rtol=1e-12, atol=1e-14)


@every_ndf
def test_single_precision_stays_single_and_is_accurate(case):
    ndf = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), case.ndf)
    m = WAVES[:-1].astype(jnp.float32)
    wide = jax.tree.map(lambda leaf: leaf.astype(jnp.float64), (ndf, m))
    for evaluate in (density, projected_area):
        single, double = evaluate(ndf, m), evaluate(*wide)
        assert single.dtype == jnp.float32
        assert_allclose(single, double, rtol=2e-4, atol=1e-30)
    normals = sample(ndf, jnp.linspace(0, 0.9, 10, dtype=jnp.float32).reshape(5, 2))
    assert normals.dtype == jnp.float32
    assert np.all(np.isfinite(normals))


@every_ndf
def test_single_precision_is_finite_at_the_seams(case):
    ndf, m = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), (case.ndf, SEAMS))
    for leaf in jax.tree.leaves(values_and_gradients(ndf, m)):
        assert np.all(np.isfinite(leaf))
