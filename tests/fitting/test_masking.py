"""Tabulated masking of a family: against the integral, mpmath, and Beckmann's closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import erfc

import jaxbrdf as jb
from fitting.masking import masking_table
from fitting.parameters import ShapeSpace
from tests import references

SPACE = ShapeSpace(jb.ShiftedGamma)
FEW = np.cos(np.deg2rad(np.concatenate([np.linspace(0, 80, 61), np.linspace(80.1, 89.9, 40)])))
MANY = np.cos(np.linspace(0, np.pi / 2 - 1e-4, 400))
UP_TO_80 = np.deg2rad(80) + 1e-9


def looked_up(space, cos_w, shapes):
    table = masking_table(space, cos_w)
    return np.asarray(jax.jit(jax.vmap(table.log_area))(shapes))


def integrated(space, cos_w, shapes):
    w = jb.spherical(np.arccos(cos_w), 0.3)
    return np.log(jax.jit(jax.vmap(lambda t: space.ndf(t).projected_area(w)))(shapes))


@pytest.mark.parametrize("cos_w", [FEW, MANY], ids=["few", "many"])
def test_it_is_the_integral(cos_w):
    shapes = np.random.default_rng(3).uniform(0, 1, (400, 2))
    error = np.abs(looked_up(SPACE, cos_w, shapes) - integrated(SPACE, cos_w, shapes))
    below = np.arccos(cos_w) <= UP_TO_80
    assert error[:, below].max() < 3e-6
    assert error[:, ~below].max() < 6e-5


def test_on_the_bounds_and_beyond_it_is_the_integral_of_the_bound():
    corners = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    truth = integrated(SPACE, FEW, corners)
    assert_allclose(looked_up(SPACE, FEW, corners), truth, atol=6e-5)
    assert_allclose(looked_up(SPACE, FEW, corners + 0.5 * (2 * corners - 1)), truth, atol=6e-5)


@pytest.mark.parametrize(("alpha", "p"), [(0.0148, 0.459), (0.3, 0.6), (0.2, 1.8)])
def test_it_is_the_double_integral(alpha, p):
    theta = np.array([0.5, 1.2, 1.5])
    t = np.array([[np.log(alpha / 1e-5) / np.log(2e5), p / 3]])
    expected = [np.log(references.sgd_projected_area(alpha, p, angle)) for angle in theta]
    assert_allclose(looked_up(SPACE, np.cos(theta), t)[0], expected, atol=1e-6)


def test_a_family_of_one_parameter_against_its_closed_form(beckmann):
    """Λ = (exp(−a²)/(a√π) − erfc(a)) / 2, a = 1/(α tan θ)."""
    t = np.random.default_rng(4).uniform(0, 1, (50, 1))
    alpha = 1e-3 * 1000**t
    with np.errstate(divide="ignore", under="ignore"):
        a = FEW / (alpha * np.sqrt(1 - FEW**2))
    Lambda = (np.exp(-(a**2)) / (a * np.sqrt(np.pi)) - erfc(a)) / 2
    error = np.abs(looked_up(ShapeSpace(beckmann), FEW, t) - np.log(FEW * (1 + Lambda)))
    assert error.max() < 3e-5


def test_a_family_whose_area_has_a_pole_in_its_range_beside_it():
    """σ of Student's t grows like 1/(γ − 1.5); a table even in log γ was off by a fifth."""
    shapes = np.random.default_rng(5).uniform(0, 1, (200, 2))
    space = ShapeSpace(jb.StudentT)
    error = np.abs(looked_up(space, FEW, shapes) - integrated(space, FEW, shapes)).max(axis=1)
    assert error.max() < 3e-2
    assert error[np.asarray(space.ndf(jnp.asarray(shapes)).alpha) < 0.5].max() < 3e-3


def test_slopes_by_the_shape_are_those_of_the_integral():
    """Levenberg–Marquardt moves along them."""
    t = jnp.array([0.62, 0.31])
    table, w = masking_table(SPACE, FEW), jb.spherical(np.arccos(FEW), 0.0)
    slopes = jax.jit(jax.jacfwd(table.log_area))(t)
    truth = jax.jit(jax.jacfwd(lambda t: jnp.log(SPACE.ndf(t).projected_area(w))))(t)
    assert_allclose(slopes, truth, atol=1e-4)
