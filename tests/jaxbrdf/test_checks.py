"""Reciprocity, energy and sampling of reflectances for which the answers are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxbrdf as jb
from jaxbrdf import checks
from jaxbrdf.directions import cos_theta


class OneWay(jb.AbstractBRDF):
    """f = cos θ_i / π: not reciprocal; f(wi, wo) : f(wo, wi) = cos θ_i : cos θ_o."""

    albedo: jnp.ndarray

    def _reflectance(self, wi, wo):
        above = (cos_theta(wi) > 0) & (cos_theta(wo) > 0)
        return jnp.where(above, self.albedo * cos_theta(wi) / jnp.pi, 0)


class WrongDensity(OneWay):
    """Says that its cosine samples are even over the hemisphere."""

    def _pdf(self, wi, wo):
        return jnp.full(wi.shape[:-1], 1 / (2 * jnp.pi))


def test_a_diffuse_surface_obeys():
    rgb = jb.Lambertian(jnp.array([0.2, 0.5, 0.9]))
    assert_allclose(jb.reciprocity_error(rgb), 0, atol=1e-12)
    assert_allclose(jb.energy_excess(rgb), 0, atol=1e-12)
    assert checks.is_isotropic(rgb)
    assert np.all(checks.sampling(rgb).consistent)


@pytest.mark.parametrize("alpha_y", [0.1, 0.12])
def test_azimuths_are_told_in_single_precision_too(alpha_y):
    with jax.enable_x64(False):
        lobe = jb.Microfacet(jb.TrowbridgeReitz(0.1, alpha_y), jb.Schlick(0.04))
        assert bool(checks.is_isotropic(jb.Lambertian(0.1) + lobe)) == (alpha_y == 0.1)


def test_a_surface_that_creates_energy():
    assert_allclose(jb.energy_excess(jb.Lambertian(1.2)), 0.2, rtol=1e-9)


def test_a_surface_that_is_not_reciprocal():
    """2 |c_i − c_o| / (c_i + c_o) tends to 2 where one direction grazes."""
    assert 1.5 < float(jb.reciprocity_error(OneWay(jnp.array(0.5)))) <= 2


def test_samples_of_another_density_are_found():
    assert not np.all(checks.sampling(WrongDensity(jnp.array(0.5))).consistent)


@pytest.mark.slow
def test_slanted_fibres_have_sides():
    """Ashikhmin 2000, section 6.4: their mean normal leans, and light from one side meets more."""
    fibres = jb.Microfacet(
        jb.tabulate_projected_area(jb.SlantedVelvet(np.radians(40), 0.5), (17, 24)), jb.Constant(1.0)
    )
    assert not checks.is_isotropic(fibres)
    found = np.asarray(checks.albedos(fibres))
    assert found.shape == (len(checks.INCIDENCES), len(checks.AZIMUTHS))
    assert np.max(np.ptp(found, axis=1)) > 0.1
