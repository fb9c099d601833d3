"""Slices alone, without a table: a mirror slice that is missing, a genuine measured slice, and misuse."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxbrdf as jb
from fitting import fit_shifted_gamma, fit_two_slice
from tests.fitting import truths

LIMIT = np.deg2rad(80)


def only_back(theta_h, m_h):
    return jb.Slices(theta_h, m_h, np.zeros(0), np.zeros((0, m_h.shape[1])))


def backscattering(theta, rho_d, F_r, alpha, p):
    """m(θ_h) at θ_d = 0, in numpy."""
    area = np.exp(truths.log_area(np.cos(theta), alpha, p))
    return (rho_d + F_r * truths.density(theta, alpha, p) / area**2) / np.pi


@pytest.fixture(scope="module")
def pink_felt(shared_data):
    """The MERL slice of pink-felt as published: lines of cos θ_h and RGB."""
    rows = np.loadtxt(shared_data / "retro" / "pink-felt-1d.alta", comments="#")
    order = np.argsort(-rows[:, 0])
    return only_back(np.arccos(rows[order, 0]), rows[order, 1:])


def synthetic(n):
    theta = np.linspace(0.01, 1.4, n)
    channels = [(0.1, 0.3, 0.02, 0.8), (0.3, 0.05, 0.2, 0.3), (0.02, 0.2, 0.001, 1.2)]
    return channels, only_back(theta, np.stack([backscattering(theta, *c) for c in channels], axis=1))


@pytest.fixture(scope="module")
def without_mirror():
    channels, slices = synthetic(90)
    return np.array(channels), fit_shifted_gamma(slices, "slices")


def test_without_a_mirror_slice_the_fresnel_term_is_one(without_mirror):
    model = without_mirror[1].model
    for f0, f1 in zip(np.asarray(model.f0), np.asarray(model.f1), strict=True):
        assert_allclose(truths.fresnel(np.linspace(0, np.pi / 2, 50), f0, f1), 1, rtol=1e-9)


def test_without_a_mirror_slice_the_lobe_is_found_again(without_mirror):
    truth, fit = without_mirror
    m = fit.model
    found = np.stack([m.rho_d, m.rho_s, m.alpha, m.p], axis=1)
    assert np.all(fit.success)
    assert_allclose(found, truth, rtol=1e-3)


def test_without_a_mirror_slice_fresnel_has_no_standard_error(without_mirror):
    fit = without_mirror[1]
    errors = np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2))
    known = [name not in ("f0", "f1", "rho_s") for name in fit.parameters]
    assert np.all(np.isfinite(errors[:, known]))


def test_a_genuine_measured_slice(pink_felt):
    """Below 80° the fit keeps to 8 % rms; most of that is pink felt's steep rise in the last ten degrees."""
    fit = fit_shifted_gamma(pink_felt, "slices")
    assert np.all(fit.success)
    below = pink_felt.theta_h < LIMIT
    m = fit.model
    for c in range(3):
        row = (float(m.rho_d[c]), float(m.rho_s[c]), float(m.alpha[c]), float(m.p[c]))
        model = backscattering(pink_felt.theta_h[below], *row)
        relative = model / pink_felt.m_h[below, c] - 1
        assert np.sqrt(np.mean(relative**2)) < 0.08
        assert_allclose(fit.residuals[c, : len(below)][below], model - pink_felt.m_h[below, c], atol=1e-6)


def test_unknown_recipes_are_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=r"unknown recipe 'best'.*slices, slices\+linear, full"):
        fit_two_slice(jb.ShiftedGamma, synthetic(20)[1], "best")


def test_an_empty_list_is_refused():
    with pytest.raises(ValueError, match="no material"):
        fit_shifted_gamma([], "slices")


@pytest.mark.parametrize("recipe", ["slices+linear", "full"])
def test_slices_cannot_be_fitted_by_the_table(recipe):
    with pytest.raises(ValueError, match=r"needs the whole table.*recipe='slices'"):
        fit_shifted_gamma(synthetic(20)[1], recipe)


def test_mixed_grids_are_refused():
    with pytest.raises(ValueError, match="share their grid"):
        fit_shifted_gamma([synthetic(20)[1], synthetic(21)[1]], "slices")


def test_mixed_numbers_of_channels_are_refused():
    s = synthetic(20)[1]
    with pytest.raises(ValueError, match="share their grid and channels"):
        fit_shifted_gamma([s, only_back(s.theta_h, s.m_h[:, :2])], "slices")
