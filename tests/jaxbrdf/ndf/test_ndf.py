"""Every distribution × every value that a distribution knows; cases.py has the table of them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose

from tests import references
from tests.jaxbrdf.ndf.cases import ABOVE, BELOW, CASES, SEAMS, Case, evaluated, every_ndf, every_visible

MANY = 2000
UP = np.array([0.0, 0.0, 1.0])
# oblique, nearly grazing, below the horizon; normal incidence and grazing exactly
VIEWS = np.concatenate(
    [references.direction(np.array([0.9, np.pi / 2 - 1e-4, 2.2]), np.array([0.5, 2.0, -1.0])), SEAMS[:2]]
)
ENDS = np.stack(np.meshgrid([0.0, 1e-300, 0.5, 1 - 2**-53], [0.0, 0.5, 1 - 2**-53]), axis=-1).reshape(-1, 2)
U = np.concatenate([np.random.default_rng(20120).uniform(size=(20_000, 2)), ENDS])


@eqx.filter_jit
def densities(make, parameters, m):
    return make(*parameters)(m)


@eqx.filter_jit
def samples(make, parameters, u):
    return make(*parameters).sample(u)


@eqx.filter_jit
def visible_samples(make, parameters, u, w):
    return make(*parameters).sample_visible(u, w)


@every_ndf
def test_density_is_the_reference(case):
    """At the nodes of a quadrature (test_truths: the reference is normalised) and at the seams."""
    nodes = references.sphere_nodes(case.density)[0].reshape(-1, 3)
    nodes = nodes[np.linspace(0, len(nodes) - 1, MANY).astype(int)]
    m = np.concatenate([nodes, SEAMS, -SEAMS, references.direction(np.geomspace(1e-7, 1.5, 60), 0.3)])
    expected = case.density(m)
    found = densities(case.make, case.array, jnp.asarray(m))
    assert_allclose(found, expected, rtol=case.density_error, atol=1e-200)
    assert np.sum(expected > 0) > MANY / 5


@every_ndf
def test_projected_area_is_brute_force(case):
    """σ(w) and ∂σ/∂w = ∫_{w·m > 0} m D dm along the sphere, above the horizon, at it and below."""
    at = evaluated(case)
    for k in [*range(ABOVE.stop), BELOW.start + 4, BELOW.start + 6]:
        w = at.m[k]
        mean = references.facing_normal(case.density, w)
        assert_allclose(at.value[1, k], w @ mean, rtol=case.area_error, atol=1e-3 * case.area_error)
        tangents = np.linalg.svd(w[None])[2][1:]
        assert_allclose(tangents @ at.by_direction[1, :, k], tangents @ mean, atol=30 * case.area_error)


@every_ndf
def test_projected_area_below_the_horizon(case):
    """σ(w) − σ(−w) = w · ⟨m⟩, the mean normal by brute force; and neither is ever below 0."""
    at = evaluated(case)
    above, below = at.value[1, ABOVE], at.value[1, BELOW]
    mean = references.facing_normal(case.density)
    assert_allclose(above - below, at.m[ABOVE] @ mean, atol=case.area_error)
    assert np.all(at.value[1] >= -1e-14)


def difference(function, parameters, i):
    """∂f/∂parameter i by five points."""
    step = 3e-4 * (abs(parameters[i]) or 1)
    shifted = [
        function(tuple(p + k * step * (i == j) for j, p in enumerate(parameters))) for k in (-2, -1, 1, 2)
    ]
    return (shifted[0] - 8 * shifted[1] + 8 * shifted[2] - shifted[3]) / (12 * step)


@every_ndf
def test_derivatives_by_the_parameters(case):
    """Of D at typical normals and of σ at two directions, in relation to what they are."""
    at = evaluated(case)
    m, w = at.m[-4:], at.m[[5, BELOW.start + 5]]

    def truth(parameters):
        density = case.reference(*parameters)
        return np.concatenate([density(m), [references.projected_area(density, x) for x in w]])

    value = np.concatenate([at.value[0, -4:], at.value[1, [5, BELOW.start + 5]]])
    assert np.all(value[:4] > 0)
    scale = np.concatenate([value[:4], [1, 1]])
    found = np.concatenate([at.by_parameter[0, :, -4:], at.by_parameter[1][:, [5, BELOW.start + 5]]], axis=1)
    for i, p in enumerate(case.parameters):
        one_sided = p == 0  # the end of the domain
        if one_sided:
            continue
        expected = difference(truth, case.parameters, i)
        assert_allclose(found[i] * p / scale, expected * p / scale, rtol=1e-6, atol=1e-7 + case.area_error)


def seen_from(w):
    return lambda m: np.maximum(m @ w, 0)


@every_ndf
def test_samples_follow_the_density(case):
    """D (m·n)+ / σ(n), by χ²; and the ends of the unit square give normals as well."""
    m = np.asarray(samples(case.make, case.array, U))
    assert_allclose(np.linalg.norm(m, axis=-1), 1, atol=1e-14)
    assert np.all(m[:, 2] >= 0)
    assert np.all(m[: -len(ENDS), 2] > 0)
    assert references.bins(case.density, seen_from(UP)).chi_squared(m[: -len(ENDS)]) > 1e-3


@every_visible
def test_visible_samples_follow_what_a_direction_sees(case):
    """(w·m)+ D / σ(w), by χ², wherever w sees anything at all; and the ends of the unit square."""
    normals = np.asarray(visible_samples(case.make, case.array, U[:, None], VIEWS))
    assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-14)
    for w, m in zip(VIEWS, np.moveaxis(normals, 1, 0), strict=True):
        if references.projected_area(case.density, w) > 1e-200:
            assert np.all(m @ w > -1e-12)
            assert np.all(m[:, 2] > -1e-12)
            assert references.bins(case.density, seen_from(w)).chi_squared(m[: -len(ENDS)]) > 1e-3


def test_the_chi_squared_test_can_fail():
    """A parameter that is 7 % wrong, and visible normals taken for all of them, are found out."""
    case = next(c for c in CASES if str(c) == "Beckmann 0.05 0.5")
    m = np.asarray(samples(case.make, case.array, U))
    wrong = Case(case.make, (0.05, 0.535), case.reference)
    assert references.bins(wrong.density, seen_from(UP)).chi_squared(m) < 1e-5
    assert references.bins(case.density, seen_from(VIEWS[0])).chi_squared(m) < 1e-5
