"""Errors of tables against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad

import jaxbrdf as jb
from jaxbrdf import metrics


def uniform_grid(n_h=60, n_d=60, n_phi=40):
    edges = [
        np.linspace(0, upper, n + 1) for n, upper in ((n_h, np.pi / 2), (n_d, np.pi / 2), (n_phi, np.pi))
    ]
    centres = [(e[1:] + e[:-1]) / 2 for e in edges]
    return jb.HalfDifferenceGrid(*centres, *edges)


GRID = uniform_grid()
A = np.array([0.6, 0.3, 0.9])
B = np.array([0.5, 0.4, 0.9])


def table(reflectance, grid=GRID):
    """A measurement of constant reflectance in each channel."""
    raw = np.broadcast_to(np.asarray(reflectance) / np.pi, (*grid.shape, len(reflectance))).copy()
    return jb.MeasuredBRDF(raw, np.ones(len(reflectance)), grid)


@pytest.mark.parametrize("max_angle", [np.pi / 2, 1.2, 0.6])
def test_l2_between_two_diffuse_surfaces(max_angle):
    """m = a/π, ρ = b/π: E² = ((a−b)/π)² (π sin²θ_max)², and the largest albedo of m is a; up to cut cells."""
    error = jb.normalized_l2(jb.Lambertian(B), table(A), max_angle)
    assert_allclose(error, np.abs(A - B) / A * np.sin(max_angle) ** 2, rtol=4e-3, atol=1e-9)


def test_l2_on_the_merl_grid():
    error = jb.normalized_l2(jb.Lambertian(0.5), table([0.6], jb.merl_grid()))
    assert_allclose(error, [0.1 / 0.6], rtol=2e-4)


@pytest.fixture(scope="module")
def compared():
    return jb.compare(jb.Lambertian(B), table(A))


def test_compare_gives_all_errors_for_each_channel(compared):
    assert set(compared) == {"normalized_l2", "log_error", "cube_root_error"}
    for error in compared.values():
        assert error.shape == (3,)
        assert np.all(error[:2] > 0)


def test_log_error_is_the_mean_over_solid_angle(compared):
    """rms of log(1 + m cos θ_i) − log(1 + ρ cos θ_i) over θ_i < 80°: a mean over cos θ_i."""
    lowest = np.cos(np.deg2rad(80))
    for error, a, b in zip(compared["log_error"][:2], A, B, strict=False):
        square = quad(
            lambda c, a=a, b=b: (np.log1p(a / np.pi * c) - np.log1p(b / np.pi * c)) ** 2, lowest, 1
        )[0]
        assert_allclose(error, np.sqrt(square / (1 - lowest)), rtol=5e-3)


def test_cube_root_error(compared):
    assert_allclose(
        compared["cube_root_error"], np.abs(np.cbrt(A / np.pi) - np.cbrt(B / np.pi)), rtol=1e-9, atol=1e-12
    )


def test_a_perfect_model_has_no_error():
    for error in jb.compare(jb.Lambertian(A), table(A)).values():
        assert_allclose(error, 0, atol=1e-12)


def test_channels_do_not_mix():
    alone = [jb.compare(jb.Lambertian(b), table([a])) for a, b in zip(A, B, strict=True)]
    together = jb.compare(jb.Lambertian(B), table(A))
    for name, error in together.items():
        assert_allclose(error, np.concatenate([e[name] for e in alone]), rtol=1e-12, atol=1e-12)


def test_invalid_samples_do_not_count():
    """Half the table is invalid: the means stay, the L2 integral halves (its norm is of what remains)."""
    measured = table([0.6])
    measured.raw[:, ::2] = -1
    spoiled, whole = jb.compare(jb.Lambertian(0.5), measured), jb.compare(jb.Lambertian(0.5), table([0.6]))
    assert_allclose(spoiled["cube_root_error"], whole["cube_root_error"], rtol=1e-12)
    assert_allclose(spoiled["log_error"], whole["log_error"], rtol=2e-2)
    assert_allclose(spoiled["normalized_l2"], whole["normalized_l2"] / np.sqrt(2), rtol=2e-2)


def test_a_channel_without_any_sample_has_no_error_to_speak_of():
    measured = table([0.6, 0.6])
    measured.raw[..., 1] = -1
    for error in jb.compare(jb.Lambertian(0.5), measured).values():
        assert np.isfinite(error[0])
        assert np.isnan(error[1])


def test_negative_models_count_as_black_where_a_root_is_taken():
    errors = [jb.compare(jb.Lambertian(b), table([0.6])) for b in (-0.2, 0.0)]
    for name in ("log_error", "cube_root_error"):
        assert_array_equal(errors[0][name], errors[1][name])
    assert errors[0]["normalized_l2"] > errors[1]["normalized_l2"]


def test_tabulate_is_evaluation_at_the_centres():
    brdf = jb.Lambertian(jnp.array([0.2, 0.3])) + jb.ShiftedGammaBRDF(0.0, 0.5, 0.3, 0.5, 0.6, 0.1)
    grid = uniform_grid(4, 5, 6)
    f = metrics.tabulate(brdf, grid)
    assert f.shape == (4, 5, 6, 2)
    wi, wo = grid.directions()
    assert_allclose(f, jax.jit(lambda i, o: brdf(i, o))(wi, wo), rtol=1e-10)
