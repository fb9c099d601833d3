"""The Fresnel terms against mpmath, Snell's law and Mitsuba, at the seams, with channels and gradients."""

import itertools

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import curve_fit

import jaxbrdf as jb
from jaxbrdf.fresnel import Conductor, Constant, Dielectric, Lazanyi, Schlick, kappa_from_reflectance

COS = np.linspace(0, 1, 11)
ETA = [0.04, 0.2, 0.999, 1.0, 1.5, 3.1]
KAPPA = [0.0, 1e-6, 0.5, 4.0, 9.0]
SEAMS = [0.0, 1e-9, 0.01, 0.3, 0.7, 1 - 1e-9, 1.0]
METALS = [p for p in itertools.product(ETA, KAPPA, SEAMS) if p != (1.0, 0.0, 0.0)]


def reflectance(eta, kappa, c):
    """Fresnel's two amplitudes in complex arithmetic, squared and averaged, to 40 digits."""
    N = mpmath.mpc(eta, kappa)
    u = mpmath.sqrt(N**2 - 1 + mpmath.mpf(c) ** 2)
    perpendicular = abs((c - u) / (c + u)) ** 2
    parallel = abs((N**2 * c - u) / (N**2 * c + u)) ** 2
    return (perpendicular + parallel) / 2


@pytest.fixture(scope="module")
def truth():
    """F and its derivatives by η, κ (from above) and c of METALS, (points, 4)."""
    with mpmath.workdps(40):
        rows = []
        for eta, kappa, c in METALS:
            slopes = (
                mpmath.diff(lambda x: reflectance(x, kappa, c), eta),  # noqa: B023
                mpmath.diff(lambda x: reflectance(eta, x, c), kappa, direction=1),  # noqa: B023
                mpmath.diff(lambda x: reflectance(eta, kappa, x), c),  # noqa: B023
            )
            rows.append([float(x) for x in (reflectance(eta, kappa, c), *slopes)])
    return np.array(rows)


@jax.jit
@jax.vmap
def conductor_and_slopes(eta, kappa, c):
    value, slopes = jax.value_and_grad(lambda *p: Conductor(*p[:2])(p[2]), (0, 1, 2))(eta, kappa, c)
    return jnp.stack([value, *slopes])


def test_a_conductor_is_mpmaths(truth):
    rows = conductor_and_slopes(*jnp.array(METALS).T)
    assert_allclose(rows[:, 0], truth[:, 0], atol=1e-15, rtol=1e-14)


def test_its_derivatives_are_mpmaths(truth):
    """At κ = 0 and under total reflection too, where the derivative by κ is one-sided and not 0."""
    rows = conductor_and_slopes(*jnp.array(METALS).T)
    assert_allclose(rows[:, 1:], truth[:, 1:], rtol=1e-8, atol=1e-8)
    totally = (truth[:, 0] == 1) & (np.array(METALS)[:, 1] == 0) & (np.array(METALS)[:, 2] > 0)
    assert np.any(truth[totally, 2] < -0.1)


def test_single_precision_is_kept(truth):
    rows = conductor_and_slopes(*jnp.array(METALS, jnp.float32).T)
    assert rows.dtype == jnp.float32
    assert np.all(np.isfinite(rows))
    assert_allclose(rows[:, 0], truth[:, 0], atol=2e-5)


@pytest.mark.parametrize(
    ("eta", "kappa", "c", "value"),
    [
        (0.5, 0.0, np.sqrt(0.75), 1.0),  # the critical angle
        (np.sqrt(0.5), 0.0, np.sqrt(0.5), 1.0),
        (1.0, 0.0, 0.0, 0.0),  # no boundary, seen at grazing
    ],
)
def test_where_no_slope_exists_it_is_finite(eta, kappa, c, value):
    row = conductor_and_slopes(*(jnp.array([x]) for x in (eta, kappa, c)))[0]
    assert_allclose(row[0], value, atol=1e-7)
    assert np.all(np.isfinite(row))


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_reflectance_is_a_share_with_a_finite_gradient(dtype):
    key = jax.random.key(0)
    log_eta, log_kappa, c = jax.random.uniform(key, (3, 5000), dtype)
    eta, kappa = 10 ** (4 * log_eta - 2), 10 ** (6 * log_kappa - 4)
    rows = np.asarray(conductor_and_slopes(eta, kappa.at[::5].set(0), c))
    assert np.all(np.isfinite(rows))
    assert rows[:, 0].min() >= 0
    assert rows[:, 0].max() <= 1 + 4 * np.finfo(dtype).eps


def test_at_normal_incidence_it_is_the_textbooks():
    eta, kappa = np.array([0.2, 1.5, 3.1]), np.array([3.9, 0.0, 3.3])
    F = ((eta - 1) ** 2 + kappa**2) / ((eta + 1) ** 2 + kappa**2)
    assert_allclose(Conductor(eta, kappa)(1.0), F, rtol=1e-14)


def test_mitsuba_agrees():
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    for eta, kappa in [(0.2, 3.9), (1.48, 7.65), (3.25, 3.29), (0.06, 4.4)]:
        theirs = [mitsuba.fresnel_conductor(c, mitsuba.Complex2f(eta, kappa)) for c in COS]
        assert_allclose(Conductor(eta, kappa)(COS), theirs, atol=2e-6)
    for eta in (1.5, 1 / 1.5):
        assert_allclose(Dielectric(eta)(COS), [mitsuba.fresnel(c, eta)[0] for c in COS], atol=2e-6)


@pytest.mark.parametrize("eta", [0.7, 1.33, 1.5, 2.4])
def test_a_dielectric_obeys_snells_law(eta):
    theta = np.linspace(0.01, min(np.pi / 2, np.arcsin(min(eta, 1))) - 0.01, 9)
    t = np.arcsin(np.sin(theta) / eta)
    R_s = (np.sin(theta - t) / np.sin(theta + t)) ** 2
    R_p = (np.tan(theta - t) / np.tan(theta + t)) ** 2
    assert_allclose(Dielectric(eta)(np.cos(theta)), (R_s + R_p) / 2, rtol=1e-11)


def test_at_brewsters_angle_only_one_polarisation_is_left():
    eta = 1.5
    cos_brewster = 1 / np.sqrt(1 + eta**2)
    assert_allclose(Dielectric(eta)(cos_brewster), ((1 - eta**2) / (1 + eta**2)) ** 2 / 2, rtol=1e-13)


def test_beyond_the_critical_angle_all_is_reflected():
    critical = np.sqrt(1 - (1 / 1.5) ** 2)
    F = Dielectric(1 / 1.5)(np.array([0, 0.3, critical - 1e-9, critical + 1e-3, 1.0]))
    assert_array_equal(F[:3], 1)
    assert F[3] < 0.9
    assert_allclose(F[4], 0.04, rtol=1e-13)


def test_without_a_boundary_nothing_is_reflected():
    assert_array_equal(Dielectric(1.0)(COS), 0)


@pytest.mark.parametrize("correction", [(), (0.6, 5.5)])
def test_lazanyis_formula(correction):
    eta, kappa = 0.2, 3.9
    a, b = correction or (0, 1)
    printed = [
        ((eta - 1) ** 2 + 4 * eta * (1 - c) ** 5 + kappa**2) / ((eta + 1) ** 2 + kappa**2)
        - a * c * (1 - c) ** b
        for c in COS
    ]
    assert_allclose(Lazanyi(eta, kappa, *correction)(COS), printed, rtol=1e-14)


@pytest.mark.parametrize(
    ("eta", "kappa", "plain", "corrected"), [(0.2, 3.9, 0.025, 0.004), (2.9, 3.0, 0.2, 0.03)]
)
def test_lazanyi_approximates_the_exact_reflectance(eta, kappa, plain, corrected):
    """a and b come from a fit to the exact reflectance, as the docstring says."""
    c = np.linspace(0, 1, 101)
    exact = np.array([float(reflectance(eta, kappa, x)) for x in c])
    F = np.asarray(Lazanyi(eta, kappa)(c))
    assert_allclose(F[[0, -1]], exact[[0, -1]], rtol=1e-14)
    assert plain / 2 < np.abs(F - exact).max() < plain
    (a, b), _ = curve_fit(lambda c, a, b: a * c * (1 - c) ** b, c, F - exact, p0=(1.0, 6.0))
    assert np.abs(Lazanyi(eta, kappa, a, b)(c) - exact).max() < corrected


@pytest.mark.parametrize("c", [0.0, 1.0, 1.0 + 2e-16])
def test_lazanyis_correction_has_a_finite_gradient_at_the_ends(c):
    slopes = jax.grad(lambda a, b, c: Lazanyi(0.2, 3.9, a, b)(c), (0, 1, 2))(0.6, 5.5, c)
    expected = -4 * 0.2 * 5 / (1.2**2 + 3.9**2) - 0.6 if c == 0 else 0
    assert_allclose(slopes, [0, 0, expected], atol=1e-14)


def test_schlicks_formula():
    r = 0.04
    assert_allclose(Schlick(r)(COS), [r + (1 - r) * (1 - c) ** 5 for c in COS], rtol=1e-14)


def test_a_constant_is_the_same_everywhere():
    assert_array_equal(Constant(1)(COS), np.ones(11))
    assert Constant([0.1, 0.2])(COS).shape == (11, 2)
    assert np.issubdtype(Constant(1)(COS).dtype, np.floating)


def test_at_grazing_everything_is_reflected():
    """F(π/2) = 1 whatever the parameters, published negative F(0) included."""
    f0, f1 = jnp.array([0.04, 0.9, 6.05524, 0.1]), jnp.array([0.0, -0.3, 5.05524, 0.4])
    assert_allclose(jb.LinearSchlick(f0, f1)(jnp.array(0.0)), 1, atol=1e-15)


def test_at_normal_incidence_it_is_f0_less_f1():
    assert_allclose(jb.LinearSchlick(0.1, 0.4)(jnp.array(1.0)), -0.3, atol=1e-15)


def test_linear_schlicks_formula_and_its_derivatives():
    f0, f1 = 0.7, 0.25
    assert_allclose(
        jb.LinearSchlick(f0, f1)(jnp.asarray(COS)),
        [f0 + (1 - f0) * (1 - np.cos(t)) ** 5 - f1 * np.cos(t) for t in np.arccos(COS)],
        atol=1e-14,
    )
    by_f0, by_f1 = jax.jacfwd(lambda a, b: jb.LinearSchlick(a, b)(jnp.asarray(COS)), (0, 1))(f0, f1)
    assert_allclose(by_f0, 1 - (1 - COS) ** 5, atol=1e-14)
    assert_allclose(by_f1, -COS, atol=1e-14)


@pytest.mark.parametrize(
    ("term", "channels"),
    [
        (jb.LinearSchlick, ([0.1, 0.2, 0.3], 0.05)),
        (Conductor, ([0.2, 0.9, 1.1], 2.5)),
        (Dielectric, ([1.3, 1.5, 0.8],)),
        (Lazanyi, (1.2, [3.9, 2.4, 2.1], 0.4, [5.0, 6.0, 7.0])),
        (Schlick, ([0.04, 0.5, 0.9],)),
    ],
    ids=lambda x: x.__name__ if isinstance(x, type) else "",
)
def test_channels_trail_and_precision_is_kept(term, channels):
    channels = [jnp.asarray(p, jnp.float32) for p in channels]
    value = term(*channels)(jnp.asarray(COS, jnp.float32))
    assert value.shape == (11, 3)
    assert value.dtype == jnp.float32
    for k, row in enumerate(value.T):
        one = term(*(p[k] if p.ndim else p for p in channels))
        assert_allclose(row, one(jnp.asarray(COS, jnp.float32)), rtol=1e-5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Conductor(0.0, 1.0), "eta must be greater than 0"),
        (lambda: Conductor(1.0, [1.0, -0.1]), "kappa must be at least 0"),
        (lambda: Dielectric(-1.5), "eta must be greater than 0"),
        (lambda: Schlick(1.2), "f0 must be at least 0 and at most 1"),
        (lambda: Constant(-0.1), "f0 must be at least 0 and at most 1"),
        (lambda: Lazanyi(0.2, 3.0, a=0.4), "a and b belong together"),
        (lambda: Lazanyi(0.2, 3.0, 0.4, 0.0), "b must be greater than 0"),
        (lambda: Conductor([1.0, 2.0], [1.0, 2.0, 3.0])(0.5), "different numbers of channels"),
    ],
)
def test_misuse_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_kappa_of_a_reflectance_gives_that_reflectance():
    f0, eta = np.array([0.3, 0.56, 0.92, 0.999]), np.array([2.0, 0.2, 1.4, 1.0])
    kappa = kappa_from_reflectance(f0, eta)
    assert_allclose(
        [float(reflectance(*p, 1)) for p in zip(eta, np.asarray(kappa), strict=True)], f0, rtol=1e-13
    )
    assert_allclose(kappa_from_reflectance(f0), np.sqrt(4 * f0 / (1 - f0)), rtol=1e-14)
    assert kappa_from_reflectance(f0, 1.2).shape == (4,)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("eta", [0.3, 1.0, 1.5, 4.0])
def test_kappa_is_0_where_eta_alone_reflects_that_much(eta, dtype):
    """However the reflectance of the dielectric was rounded."""
    f0 = Dielectric(jnp.asarray(eta, dtype))(jnp.asarray(1, dtype))
    assert_allclose(kappa_from_reflectance(f0, jnp.asarray(eta, dtype)), 0, atol=2e-3)


def test_slope_of_kappa():
    """2 / (κ (1 − F_0)²) by F_0 for η = 1; 0 at the lower end, where it is infinite; no error under jit."""
    slope = jax.jit(jax.vmap(jax.grad(kappa_from_reflectance)))(jnp.array([0.0, 0.2, 0.9]))
    kappa = np.sqrt(4 * np.array([0.2, 0.9]) / (1 - np.array([0.2, 0.9])))
    assert_allclose(slope, [0, *(2 / (kappa * (1 - np.array([0.2, 0.9])) ** 2))], rtol=1e-13)
    assert np.isinf(jax.jit(kappa_from_reflectance)(1.0))


@pytest.mark.parametrize(
    ("f0", "eta", "message"),
    [
        (1.0, 1.0, "scale the reflectance below 1"),
        (np.array([0.5, -0.1]), 1.0, r"f0 must lie in \[0, 1\)"),
        (np.nan, 1.0, r"f0 must lie in \[0, 1\)"),
        (0.03, 1.5, "take an η nearer to 1"),
        (0.5, -2.0, "no real κ"),
    ],
)
def test_a_reflectance_without_kappa_is_refused(f0, eta, message):
    with pytest.raises(ValueError, match=message):
        kappa_from_reflectance(f0, eta)
