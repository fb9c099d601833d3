"""Albedo against closed forms, the trapezoid rule and brute force over the facets."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import erf

import jaxbrdf as jb
from jaxbrdf.energy import albedo_by_quadrature, lattice
from tests import references

ANGLES = np.array([0.0, 0.5, 1.2, 1.5, np.pi / 2 - 1e-3])


def test_albedo_of_a_diffuse_surface_is_its_albedo():
    assert_allclose(jb.albedo(jb.Lambertian(0.37), jb.spherical(jnp.asarray(ANGLES), 0.4)), 0.37, rtol=1e-6)


def test_albedo_of_channels_and_of_one_direction():
    rho = np.array([0.1, 0.5, 0.9])
    assert_allclose(jb.albedo(jb.Lambertian(rho), jb.spherical(0.3, 0.0)), rho, rtol=1e-9)
    assert jb.albedo(jb.Lambertian(rho), jb.spherical(jnp.zeros((2, 4)), 0.0)).shape == (2, 4, 3)


def test_albedo_in_single_precision():
    value = jb.albedo(jb.Lambertian(jnp.array(0.3, jnp.float32)), jnp.array([0.6, 0.0, 0.8], jnp.float32))
    assert value.dtype == jnp.float32
    assert_allclose(value, 0.3, rtol=1e-5)


@pytest.mark.parametrize(("alpha", "p"), [(0.05, 0.5), (0.4, 1.2)])
def test_albedo_of_a_lobe_is_the_trapezoid_rules(alpha, p):
    """Over (θ_o, φ_o), the plainest way; the reflectance itself is tested against numpy elsewhere."""
    brdf = jb.ShiftedGammaBRDF(0.1, 0.8, alpha, p, 0.7, 0.2)
    quick = brdf.tabulated()
    theta = np.array([0.0, 0.7, 1.3])
    expected = [references.albedo(jax.jit(lambda i, o: quick(i, o)), t) for t in theta]
    assert_allclose(jb.albedo(quick, jb.spherical(jnp.asarray(theta), 0.2)), expected, rtol=2e-5)


def test_albedo_of_a_sharp_lobe_is_its_reflectance_times_masking():
    """A nearly perfect mirror: f → ρ_s F/π · 4 δ, the albedo is 4 ρ_s F(θ_i) / π where nothing is masked."""
    brdf = jb.ShiftedGammaBRDF(0.0, 0.5, 1e-5, 0.5, 0.6, 0.0)
    theta = np.array([0.0, 0.5, 1.0])
    F = 0.6 + 0.4 * (1 - np.cos(theta)) ** 5
    assert_allclose(jb.albedo(brdf, jb.spherical(jnp.asarray(theta), 0.0)), 4 * 0.5 * F / np.pi, rtol=1e-3)


def test_largest_albedo():
    assert_allclose(jb.largest_albedo(jb.Lambertian(jnp.array([0.2, 0.7]))), [0.2, 0.7], rtol=1e-6)
    brdf = jb.ShiftedGammaBRDF(0.05, 0.8, 0.2, 0.5, 0.7, 0.2)
    angles = jnp.linspace(0, np.deg2rad(80), 17)
    assert_allclose(jb.largest_albedo(brdf), jnp.max(jb.albedo(brdf, jb.spherical(angles, 0.0))), rtol=1e-12)


def beckmann_albedo(alpha_x, alpha_y, w, n=1200, reach=5.0):
    """∫ D G1 G1 / (4 cos cos) cos θ_o dω_o over an even grid of slopes in units of α; in plain numpy."""
    x = (np.arange(n) + 0.5) / n * 2 * reach - reach
    t_x, t_y = alpha_x * x[:, None], alpha_y * x[None, :]
    length2 = 1 + t_x**2 + t_y**2
    m = np.stack(np.broadcast_arrays(t_x, t_y, np.ones((n, n))), axis=-1) / np.sqrt(length2)[..., None]
    cos = m @ w
    wo = 2 * cos[..., None] * m - w
    seen = (cos > 0) & (wo[..., 2] > 0)

    def masking(v):
        r = np.hypot(alpha_x * v[..., 0], alpha_y * v[..., 1]) + 1e-100  # whose square is a number
        a = v[..., 2] / r
        return v[..., 2] / (v[..., 2] * (1 + erf(a)) / 2 + r * np.exp(-(a**2)) / (2 * np.sqrt(np.pi)))

    P22 = np.exp(-(x[:, None] ** 2) - x[None, :] ** 2) / np.pi  # per unit of slope / α
    share = P22 * np.sqrt(length2) * masking(w) * masking(np.where(seen[..., None], wo, w)) * cos / w[2]
    return np.sum(share[seen]) * (2 * reach / n) ** 2


VIEWS = [references.direction(np.radians(theta), 0.4) for theta in (0, 60, 80, 89)]


@pytest.fixture(scope="module")
def beckmann():
    """A function to the albedos at VIEWS, whether quadrature alone resolves them, and brute force."""

    @jax.jit
    def found(alpha_x, alpha_y):
        brdf = jb.Microfacet(jb.Beckmann(alpha_x, alpha_y), jb.Constant(1.0))
        w = jnp.array(VIEWS)
        return jb.albedo(brdf, w), albedo_by_quadrature(brdf, w)[1]

    def all_three(alpha_x, alpha_y):
        return *found(alpha_x, alpha_y), [beckmann_albedo(alpha_x, alpha_y, w) for w in VIEWS]

    return all_three


@pytest.mark.parametrize(("alpha_x", "alpha_y"), [(0.01, 0.3), (0.5, 0.05), (0.002, 0.1)])
def test_albedo_of_brushed_metal_is_brute_forces(beckmann, alpha_x, alpha_y):
    found, resolved, expected = beckmann(alpha_x, alpha_y)
    assert not np.any(resolved)
    assert_allclose(found, expected, rtol=1e-3)


@pytest.mark.parametrize("alpha", [0.5, 0.1, 1e-3, 1e-5])
def test_albedo_of_isotropic_facets_is_brute_forces(beckmann, alpha):
    found, resolved, expected = beckmann(alpha, alpha)
    assert np.all(resolved)
    assert_allclose(found, expected, rtol=1.5e-4)


class Retro(jb.AbstractBRDF):
    """A lobe e^{κ (wi·wo − 1)} of area 1 about wi: the light goes back to where it came from."""

    kappa: jax.Array

    def _reflectance(self, wi, wo):
        return jnp.where((wi[..., 2] > 0) & (wo[..., 2] > 0), self._pdf(wi, wo), 0)

    def _sample(self, u, wo):
        cos = 1 + jnp.log(u[..., 0] + (1 - u[..., 0]) * jnp.exp(-2 * self.kappa)) / self.kappa
        x = jnp.cross(wo, jnp.array([0.6, 0.8, 0.0])[None, :])
        x = x / jnp.linalg.norm(x, axis=-1, keepdims=True)
        phi = 2 * jnp.pi * u[..., 1]
        around = jnp.cos(phi)[..., None] * x + jnp.sin(phi)[..., None] * jnp.cross(wo, x)
        return cos[..., None] * wo + jnp.sqrt(1 - cos**2)[..., None] * around

    def _pdf(self, wi, wo):
        scale = self.kappa / (2 * jnp.pi * (1 - jnp.exp(-2 * self.kappa)))
        return scale * jnp.exp(self.kappa * (jnp.sum(wi * wo, axis=-1) - 1))


@pytest.mark.parametrize("kappa", [1e4, 1e6, 1e8])
def test_a_peak_between_the_nodes_is_found(kappa):
    """∫ f cos θ_o dω_o = (coth κ − 1/κ) cos θ_i if the lobe ends above the horizon (Mardia & Jupp 2000)."""
    theta = np.radians([50.0, 70.0])
    w = jb.spherical(jnp.asarray(theta), 1.0)
    assert not np.any(albedo_by_quadrature(Retro(jnp.array(kappa)), w)[1])
    expected = (1 - 1 / kappa) * np.cos(theta)
    assert_allclose(jb.albedo(Retro(jnp.array(kappa)), w), expected, rtol=1e-3)


def test_gradient_of_albedo_where_samples_help():
    """By roughness and by direction; nodes and samples stand still."""
    w = VIEWS[1]

    def f(alpha_x, theta):
        brdf = jb.Microfacet(jb.Beckmann(alpha_x, jnp.array(0.3)), jb.Schlick(jnp.array(0.1)))
        return jb.albedo(brdf, jb.spherical(theta, 0.4))

    alpha_x, theta, step = 0.02, np.arccos(w[2]), 0.02
    by_alpha, by_theta = jax.jit(jax.grad(f, argnums=(0, 1)))(jnp.array(alpha_x), jnp.array(theta))
    value = jax.jit(f)
    assert_allclose(
        by_theta, (value(alpha_x, theta + step) - value(alpha_x, theta - step)) / (2 * step), rtol=0.02
    )
    change = (value(alpha_x * 2, theta) - value(alpha_x / 2, theta)) / (1.5 * alpha_x)
    assert abs(by_alpha - change) < 0.1


def test_albedo_of_brushed_metal_in_single_precision():
    ndf = jb.Beckmann(jnp.array(0.01, jnp.float32), jnp.array(0.3, jnp.float32))
    brdf = jb.Microfacet(ndf, jb.Constant(jnp.array(1.0, jnp.float32)))
    found = jb.albedo(brdf, jnp.array(VIEWS[1], jnp.float32))
    assert found.dtype == jnp.float32
    assert_allclose(found, beckmann_albedo(0.01, 0.3, VIEWS[1]), rtol=1e-3)


def test_a_lattice_is_even_in_both_coordinates():
    u = lattice(233)
    for k in range(2):
        assert_allclose(np.sort(u[:, k]), (np.arange(233) + 0.5) / 233, rtol=1e-12)
    with pytest.raises(ValueError, match="233 or 377"):
        lattice(300)
