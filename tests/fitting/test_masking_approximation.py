"""The fitted closed form of masking: against the published fits, scipy from many starts, and its limits."""

from functools import cache
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares
from scipy.special import erfc

import jaxbrdf as jb
from fitting import fit_masking
from tests import references

PUBLISHED = {  # (alpha, p, λ, c, k) of Bagher et al. 2012, supplement
    "specular-orange-phenolic B": (1.62017e-05, 3.55583e-12, 8722070.0, 23012400.0, 855.811),
    "silicon-nitrade R": (6.40406e-05, 0.159422, 31.0579, 1.02439e76, 176.231),
    "chrome-steel G": (3.13288e-05, 0.152758, 28628.9, 1.63655e109, 257.536),
    "brass B": (0.00096108, 0.776606, 0.529487, 5.48819e-08, 183.091),
    "two-layer-silver G": (0.0201665, 0.35975, 3.77545, 1.02036e-07, 40.8229),
    "pink-fabric2 G": (0.148623, 3.24286e-13, 3.05804, 0.079067, 9.23588),
    "white-paint B": (0.538225, 0.888627, 2.23051, 0.0280623, 7.41492),
}
CORNERS = [(1e-5, 0.0), (1e-5, 2.0), (1.0, 0.0), (1.0, 2.0)]
LOG_C = 690.0


@cache
def unit_nodes(count):
    """Gauss–Legendre nodes and weights on [0, 1]."""
    x, weight = np.polynomial.legendre.leggauss(count)
    return (1 + x) / 2, weight / 2


def angles():
    """θ and weights of ∫_0^{π/2} dθ, crowded at grazing angles; not the fit's own."""
    r, weight = unit_nodes(300)
    return np.pi / 2 * (1 - r**4), 2 * np.pi * r**3 * weight


THETA, WEIGHT = angles()


def sgd_masking(alpha, p, theta):
    """1 / (1 + Λ), Λ = ∫ P22(x) (s − arctan s) dx from x = cot²θ, with the published normalisation of P22."""
    u, weight = unit_nodes(300)
    y, dy = 50 * u**8, 400 * u**7 * weight
    x = 1 / np.tan(theta)[:, None] ** 2 + alpha * y
    a = alpha + x / alpha
    s = np.sqrt(alpha * y) * np.tan(theta)[:, None]
    P22 = references.sgd_factor(alpha, p) * np.exp(-a) / (np.pi * a**p)
    return 1 / (1 + alpha * np.sum(dy * P22 * (s - np.arctan(s)), axis=1))


def closed_form(lam, log_c, k, theta=THETA):
    """Eq. 9."""
    theta_0 = np.pi / 2 - np.exp((np.log(np.log1p(1 / lam)) - log_c) / k)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        growth = np.exp(log_c + k * np.log(theta - theta_0))
    return np.where(theta > theta_0, 1 - lam * np.expm1(growth), 1)


def l2_error(G1, exact):
    return np.sqrt(np.sum(WEIGHT * (G1 - exact) ** 2))


def scipy_error(exact, starts):
    """The least error that a bounded trust-region search finds in (log λ, log c, log k)."""
    unit = 1e3 * np.sqrt(WEIGHT / np.sum(WEIGHT * (1 - exact) ** 2))

    def residual(t):
        return unit * (closed_form(np.exp(t[0]), t[1], np.exp(t[2])) - exact)

    bounds = ([-60, -LOG_C, -5], [20, LOG_C, 12])
    fits = [least_squares(residual, t, bounds=bounds, x_scale="jac", max_nfev=200) for t in starts]
    return min(l2_error(closed_form(np.exp(f.x[0]), f.x[1], np.exp(f.x[2])), exact) for f in fits)


def scipy_starts(exact):
    """λ and θ_0 on a grid, k from the angle at which half is masked."""
    half = np.interp(0.5, exact, np.pi / 2 - THETA)
    for lam, reach in product((0.005, 3.0), (8 * half, 40 * half, 1.0)):
        L = np.log1p(1 / lam)
        k = np.log(np.log1p(0.5 / lam) / L) / np.log1p(-half / max(reach, 1.5 * half))
        yield np.log(lam), np.log(L) - k * np.log(max(reach, 1.5 * half)), np.log(k)


def curves(shadowing):
    """Eq. 9 at THETA for each of L lanes, (L, K)."""
    rows = zip(shadowing.lam, np.log(shadowing.c), shadowing.k, strict=True)
    return [closed_form(*(float(value) for value in row)) for row in rows]


@pytest.fixture(scope="module")
def fitted():
    """The published rows, fitted in one call: their parameters, and G1 at THETA."""
    alpha, p = np.array(list(PUBLISHED.values()))[:, :2].T
    shadowing = fit_masking(jb.ShiftedGamma(alpha, p))
    return shadowing, dict(zip(PUBLISHED, curves(shadowing), strict=True))


@pytest.mark.parametrize("alpha", [1e-4, 0.5])
def test_the_truth_is_the_double_integral(alpha):
    theta = np.array([1.2, 1.5, 1.57])
    density = references.sgd(alpha, 0.7)
    area = [references.projected_area(density, references.direction(angle, 0.0)) for angle in theta]
    assert_allclose(sgd_masking(alpha, 0.7, theta), np.cos(theta) / area, rtol=1e-7)


@pytest.mark.parametrize("name", PUBLISHED)
def test_it_is_no_worse_than_published_nor_than_scipy(fitted, name):
    alpha, p, lam, c, k = PUBLISHED[name]
    exact = sgd_masking(alpha, p, THETA)
    error = l2_error(fitted[1][name], exact)
    assert error <= l2_error(closed_form(lam, np.log(c), k), exact) * (1 + 1e-4)
    published = (np.log(lam), np.log(c), np.log(k))
    assert error <= 1.01 * scipy_error(exact, [published, *scipy_starts(exact)])
    assert error**2 < 1e-6


def test_it_masks_all_at_the_horizon_and_nothing_at_the_normal(fitted):
    shadowing, by_name = fitted
    assert isinstance(shadowing, jb.ShiftedGammaShadowing)
    theta = np.concatenate([THETA, [np.pi / 2 - 1e-13, 0]])
    G1 = np.asarray(jax.vmap(lambda s: s.G1(jnp.cos(theta)))(shadowing))
    assert_allclose(G1[:, :-2], list(by_name.values()), atol=1e-9)
    assert_allclose(G1[:, -2], 0, atol=1e-7)
    errors = [l2_error(g, sgd_masking(*PUBLISHED[name][:2], THETA)) for name, g in by_name.items()]
    assert np.all(np.abs(1 - G1[:, -1]) <= errors)


def test_the_whole_range_is_finite_and_near():
    random = np.random.default_rng(7).uniform(size=(28, 2)) * [5, 2] - [5, 0]
    alpha, p = np.concatenate([CORNERS, np.stack([10 ** random[:, 0], random[:, 1]], axis=1)]).T
    shadowing = fit_masking(jb.ShiftedGamma(alpha, p))
    for value in (shadowing.lam, shadowing.c, shadowing.k, 1 / shadowing.c):
        assert np.all(np.isfinite(value) & (value > 0))
    exact = [sgd_masking(*shape, THETA) for shape in zip(alpha, p, strict=True)]
    errors = [l2_error(g, e) for g, e in zip(curves(shadowing), exact, strict=True)]
    assert max(errors) < 1e-3


def test_channels_and_batches_keep_their_shape_and_their_fits():
    alpha = np.array([[0.01, 0.02, 0.1], [0.3, 0.003, 0.5]])
    batch = fit_masking(jb.ShiftedGamma(alpha, 0.4))
    channels = fit_masking(jb.ShiftedGamma(alpha[1], np.full(3, 0.4)))
    alone = fit_masking(jb.ShiftedGamma(alpha[1, 2], 0.4))
    assert [getattr(batch, name).shape for name in ("lam", "c", "k")] == [(2, 3)] * 3
    assert channels.k.shape == (3,)
    assert alone.k.shape == ()
    for name in ("lam", "c", "k"):
        assert_allclose(getattr(batch, name)[1], getattr(channels, name), rtol=1e-6)
        assert_allclose(getattr(batch, name)[1, 2], getattr(alone, name), rtol=1e-6)


def test_any_isotropic_distribution_can_be_approximated(beckmann):
    """Λ = (exp(−a²)/(a√π) − erfc(a)) / 2, a = 1/(α tan θ); Beckmann of roughness √α is p = 0."""
    a = 1 / (0.3 * np.tan(THETA))
    exact = 1 / (1 + (np.exp(-(a**2)) / (a * np.sqrt(np.pi)) - erfc(a)) / 2)
    shadowing = fit_masking(beckmann(0.3))
    assert l2_error(np.asarray(shadowing.G1(jnp.cos(THETA))), exact) < 2e-4
    same = fit_masking(jb.ShiftedGamma(0.09, 0.0))
    assert_allclose([shadowing.lam, shadowing.k], [same.lam, same.k], rtol=1e-3)


def test_what_could_not_be_fitted_before_stays_nan():
    shadowing = fit_masking(jb.ShiftedGamma(np.array([0.1, np.nan]), 0.4))
    for value in (shadowing.lam, shadowing.c, shadowing.k):
        assert_array_equal(np.isnan(value), [False, True])


def test_another_kind_of_distribution_is_refused():
    tabulated = jb.tabulate_projected_area(jb.ShiftedGamma(0.1, 0.4))
    with pytest.raises(
        ValueError, match=r"isotropic.*not this TabulatedArea: give the one that a table was made from"
    ):
        fit_masking(tabulated)
