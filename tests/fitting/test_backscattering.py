"""The distribution read off the backscattering slice, against the distributions that made the slice."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from fitting import backscattering_ndf

THETA = jb.merl_grid().theta_h
LIMIT = np.deg2rad(80)
TRUSTED = THETA < LIMIT


def beckmann(theta, alpha):
    return np.exp(-(np.tan(theta) ** 2) / alpha**2) / (np.pi * alpha**2 * np.cos(theta) ** 4)


def ggx(theta, alpha):
    return alpha**2 / (np.pi * np.cos(theta) ** 4 * (alpha**2 + np.tan(theta) ** 2) ** 2)


def ggx_masking(theta, alpha):
    return 2 / (1 + np.sqrt(1 + (alpha * np.tan(theta)) ** 2))


def slices(values, theta=THETA):
    """(H, C) backscattering; of the mirror slice nothing is asked."""
    return jb.Slices(theta, values, np.array([0.1]), np.full((1, values.shape[1]), np.nan))


def of_ggx(alpha, f0=0.7, rho_d=0.05):
    lobe = f0 * ggx(THETA, alpha) * ggx_masking(THETA, alpha) / (4 * np.cos(THETA) ** 2)
    return rho_d / np.pi + lobe


@pytest.mark.parametrize(("alpha", "error"), [(0.02, 2e-5), (0.1, 3e-4), (0.3, 2e-3), (0.6, 3e-3)])
def test_ggx_is_read_off_exactly(alpha, error):
    """But for what lies beyond 80°, which is guessed: the more, the rougher."""
    read = backscattering_ndf(slices(of_ggx(alpha)[:, None]), 0.05)
    D, G1 = ggx(THETA, alpha), ggx_masking(THETA, alpha)
    assert_allclose(read.D[TRUSTED, 0], D[TRUSTED], rtol=error)
    assert_allclose(read.G1[TRUSTED, 0], G1[TRUSTED], rtol=2 * error)
    assert_allclose(read.f0, 0.7, rtol=error)
    assert_array_equal(read.rho_d, 0.05)


@pytest.mark.parametrize("alpha", [0.02, 0.1, 0.3, 0.6])
def test_beckmann_is_read_off_exactly_with_the_diffuse_part_unknown(alpha):
    """Its tail is nothing at 80°: the least of the slice is what is diffuse."""
    sigma = np.asarray(jb.Beckmann(alpha, alpha).projected_area(jb.spherical(THETA, 0.0)))
    D = beckmann(THETA, alpha)
    values = 0.1 / np.pi + 0.04 * D / (4 * np.cos(THETA) * sigma)
    read = backscattering_ndf(slices(values[:, None]))
    seen = TRUSTED & (D / D[0] > 1e-5)
    assert_allclose(read.rho_d, 0.1, rtol=1e-5)
    assert_allclose(read.D[seen, 0], D[seen], rtol=1e-3)
    assert_allclose(read.sigma[seen, 0], sigma[seen], rtol=1e-4)
    assert_allclose(read.f0, 0.04, rtol=1e-4)


@pytest.mark.parametrize(("alpha", "p"), [(0.003, 0.9), (0.1, 0.6)])
def test_a_shifted_gamma_is_read_off_exactly(alpha, p):
    ndf, w = jb.ShiftedGamma(alpha, p), jb.spherical(THETA, 0.0)
    D, sigma = np.asarray(ndf(w)), np.asarray(ndf.projected_area(w))
    read = backscattering_ndf(slices((0.9 * D / (4 * np.cos(THETA) * sigma))[:, None]), 0.0)
    seen = TRUSTED & (D / D[0] > 1e-6)
    assert_allclose(read.D[seen, 0], D[seen], rtol=1e-4)
    assert_allclose(read.sigma[seen, 0], sigma[seen], rtol=1e-5)


def test_a_diffuse_part_does_not_make_the_lobe_broad():
    """k_d = 0.05 and α = 0.1, which a peer reads as 0.15."""
    values = slices(of_ggx(0.1, f0=0.25)[:, None])
    found, naive = ((np.pi * backscattering_ndf(values, rho_d).D[0, 0]) ** -0.5 for rho_d in (None, 0.0))
    assert 0.097 < found < 0.1
    assert naive > 0.115


def test_channels_are_apart_and_unknown_angles_interpolated():
    values = np.stack([of_ggx(0.1), of_ggx(0.3), np.full(90, 0.2), np.full(90, np.nan)], axis=-1)
    values[30:33, 0] = np.nan
    read = backscattering_ndf(slices(values), np.array([0.05, 0.05, 0.2 * np.pi, 0.0]))
    assert_allclose(read.D[TRUSTED, 0], ggx(THETA, 0.1)[TRUSTED], rtol=0.1)
    assert_allclose(read.D[TRUSTED, 1], ggx(THETA, 0.3)[TRUSTED], rtol=2e-3)
    assert np.all(np.isnan(read.D[:, 2:]))
    assert np.all(np.isnan(read.f0[2:]))
    assert np.all(np.isfinite(read.sigma[:, :2]))


def test_d_and_sigma_belong_together():
    """∫ D cos θ dω = 1, and σ is the integral that it says, by brute force."""
    read = backscattering_ndf(slices(of_ggx(0.3)[:, None]), 0.05)
    theta = (np.arange(2000) + 0.5) / 2000 * np.pi / 2
    phi = (np.arange(200) + 0.5) / 200 * 2 * np.pi
    D = np.interp(theta, THETA, read.D[:, 0])[:, None]
    m = np.stack([np.sin(theta), np.cos(theta)])
    d_omega = np.sin(theta)[:, None] * (np.pi / 2 / 2000) * (2 * np.pi / 200)
    assert_allclose(np.sum(D * m[1][:, None] * d_omega * np.ones(200)), 1, rtol=2e-3)
    for k in (5, 40, 80):
        facing = np.sin(THETA[k]) * m[0][:, None] * np.cos(phi) + np.cos(THETA[k]) * m[1][:, None]
        assert_allclose(np.sum(D * np.maximum(facing, 0) * d_omega), read.sigma[k, 0], rtol=2e-3)


def test_a_measured_metal_has_the_peak_and_the_tail_of_fig_3(merl_material):
    """brass: sharper than a Beckmann distribution as wide, with a tail far above it."""
    read = backscattering_ndf(merl_material("brass").slices())
    D = read.D[:, 0] / read.D[0, 0]
    half = np.interp(0.5, D[::-1], THETA[::-1])
    alpha = np.tan(half) / np.sqrt(np.log(2))
    assert alpha < 0.07
    tail = np.interp(np.deg2rad(20), THETA, D)
    assert tail > 100 * beckmann(np.deg2rad(20), alpha) / beckmann(0.0, alpha)
    assert np.all(np.isfinite(read.f0))
