"""Effective distributions against those they were made of, blur against sums over the sphere, plans."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial import cKDTree

from jaxbrdf import (
    Beckmann,
    Conductor,
    GaussianSignature,
    HalfDifferenceGrid,
    Lambertian,
    MeasuredBRDF,
    MeasuredSignature,
    Microfacet,
    Schlick,
    TabulatedNDF,
    Unshadowed,
    blurred,
    effective_density,
    effective_ndf,
    half_directions,
    scattering_wavelength,
    spherical,
)
from jaxbrdf.ndf.tabulated import disk_cells

GOLD = Conductor(np.array([0.2, 0.4, 1.5]), np.array([3.3, 2.6, 1.9]))
WIDE = GaussianSignature(np.radians(8))
N = 51


def cells(n):
    """Normals (n, n, 3), (0, 0, 1) outside the disk, solid angles there 0."""
    m = disk_cells(n)
    inside = m[2] > 0
    m = np.where(inside, m, np.array([0.0, 0.0, 1.0])[:, None, None])
    return np.moveaxis(m, 0, -1), np.where(inside, (2 / n) ** 2 / m[2], 0)


def truth(values, kernel, n=N):
    """The blur by the angle between every two cells."""
    m, solid_angle = cells(n)
    m, weight = m.reshape(-1, 3), solid_angle.ravel()
    angle = np.arccos(np.clip(m @ m.T, -1, 1))
    return ((kernel(angle) @ (values.ravel() * weight)) * (weight > 0)).reshape(n, n)


def gaussian(width):
    """exp(κ cos γ), normalised by quadrature, with half its maximum at width / 2."""
    kappa = np.log(2) / (1 - np.cos(width / 2))
    norm = quad(lambda g: np.exp(kappa * (np.cos(g) - 1)) * 2 * np.pi * np.sin(g), 0, np.pi, points=[0.1])[0]
    return lambda angle: np.exp(kappa * (np.cos(angle) - 1)) / norm


@pytest.mark.parametrize("phi_d", [np.pi / 2, 0.0, 2.3])
def test_mirrors_without_shadows_are_found_again(phi_d):
    ndf = Beckmann(0.2, np.array([0.3, 0.4, 0.5]))
    h = spherical(np.array([0.0, 0.3, 1.2]), np.array([0.0, 2.0, -1.0]))
    D = effective_density(Microfacet(ndf, GOLD, Unshadowed()), GOLD, h, phi_d=phi_d)
    np.testing.assert_allclose(D, ndf(h), rtol=1e-10)


def test_channels_of_one_factor():
    """Of the reflectance alone, of the Fresnel term alone, of neither."""
    grey, h = Schlick(0.5), spherical(np.array([0.1, 0.7]), 0.5)
    mirror = Microfacet(Beckmann(0.4, 0.4), grey, Unshadowed())
    D = np.asarray(Beckmann(0.4, 0.4)(h))
    cos_d = np.cos(np.radians(7.07))
    ratio = np.asarray(GOLD(cos_d) / grey(cos_d))
    np.testing.assert_allclose(effective_density(mirror, grey, h), D, rtol=1e-10)
    np.testing.assert_allclose(effective_density(mirror, GOLD, h), D[:, None] / ratio, rtol=1e-10)
    coloured = Microfacet(Beckmann(0.4, 0.4), GOLD, Unshadowed())
    np.testing.assert_allclose(effective_density(coloured, grey, h), D[:, None] * ratio, rtol=1e-10)


def test_the_plane_of_light_and_detector():
    """Across that of h and n both may follow h to the horizon, inclined alike; along it they may not."""
    theta, half = 1.5, np.radians(7.07)
    h, diffuse, white = spherical(theta, 0.7), Lambertian(np.pi), Schlick(1.0)
    across = effective_density(diffuse, white, h)
    np.testing.assert_allclose(across, 4 * (np.cos(theta) * np.cos(half)) ** 2, rtol=1e-10)
    assert np.isnan(effective_density(diffuse, white, h, phi_d=0.0))
    lower = effective_density(diffuse, white, spherical(1.2, 0.7), phi_d=0.0)
    np.testing.assert_allclose(lower, 4 * np.cos(1.2 + half) * np.cos(1.2 - half), rtol=1e-10)


def test_a_table_of_effective_densities():
    ndf = Beckmann(0.3, 0.5)
    table = effective_ndf(Microfacet(ndf, GOLD, Unshadowed()), GOLD, size=33).values
    m, solid_angle = cells(33)
    expected = np.where(solid_angle > 0, ndf(m), 0)
    np.testing.assert_allclose(table, np.repeat(expected[..., None], 3, axis=-1), rtol=1e-9, atol=1e-15)


def test_of_a_measurement():
    """Where it has no valid sample around a half angle, NaN; in single precision all the same."""
    edges = [np.linspace(0, end, n + 1) for end, n in ((np.pi / 2, 30), (np.pi / 2, 12), (np.pi, 4))]
    grid = HalfDifferenceGrid(*((e[1:] + e[:-1]) / 2 for e in edges), *edges)
    raw = np.full((*grid.shape, 1), 2.0)
    raw[10:15] = -1
    brdf, white = MeasuredBRDF(raw, np.ones(1), grid), Schlick(np.float32(1.0))
    table = np.asarray(effective_ndf(brdf, white, size=41).values)[..., 0]
    m, solid_angle = cells(41)
    theta = np.degrees(np.arccos(m[..., 2]))
    missing = (theta > 33) & (theta < 42)
    np.testing.assert_array_equal(np.isnan(table[missing]), True)
    sure = ((theta < 28) | ((theta > 47) & (theta < 70))) & (solid_angle > 0)
    np.testing.assert_allclose(table[sure], 8 * (m[..., 2] * np.cos(np.radians(7.07)))[sure] ** 2, rtol=1e-6)
    assert np.sum(missing) > 50 < np.sum(sure)
    single = effective_density(Lambertian(np.float32(1.0)), white, np.float32([[0.6, 0.0, 0.8]]))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, 4 / np.pi * (0.8 * np.cos(np.radians(7.07))) ** 2, rtol=1e-5)


def test_wavelength_of_the_scattering_vector():
    """λ_q of λ = 550 nm is 554.2 nm, by the half angle of 7.07°."""
    np.testing.assert_allclose(scattering_wavelength(0.55), 0.55 / np.cos(np.radians(7.07)), rtol=1e-12)
    np.testing.assert_allclose(scattering_wavelength(0.55), 0.555, atol=0.001)


def test_blur_is_the_sum_over_the_sphere():
    """Of noise, in two channels at once."""
    values = np.random.default_rng(0).random((N, N, 2))
    expected = np.stack([truth(values[..., c], gaussian(WIDE.width)) for c in (0, 1)], axis=-1)
    np.testing.assert_allclose(blurred(TabulatedNDF(values), WIDE).values, expected, rtol=1e-3, atol=1e-4)


def test_blur_by_a_measured_signature():
    """∫ K = 1 whatever the unit of its values."""
    angle, value = np.radians([0, 3, 6, 10]), 7 * np.array([1.0, 0.9, 0.2, 0.1])
    signature = MeasuredSignature(angle, value)
    values = np.random.default_rng(1).random((N, N))

    def kernel(g):
        return np.interp(2 * np.sin(g / 2), 2 * np.sin(angle / 2), value, right=0)

    norm = quad(lambda g: kernel(g) * 2 * np.pi * np.sin(g), 0, angle[-1], points=angle[1:-1])[0]
    expected = truth(values, lambda g: kernel(g) / norm)
    np.testing.assert_allclose(blurred(TabulatedNDF(values), signature).values, expected, rtol=1e-6)
    np.testing.assert_allclose(np.degrees(signature.width), 2 * (3 + 3 * 0.4 / 0.7), rtol=1e-12)
    assert kernel(signature.width / 2) == pytest.approx(3.5, rel=1e-3)


def test_blur_of_a_window():
    """That of the disk where nothing is left out; of cells of two lengths, a plain sum."""
    spots = np.zeros((N, N))
    spots[13:38, 13:38] = np.random.default_rng(2).random((25, 25))
    small = blurred(TabulatedNDF(spots[13:38, 13:38], (25 / N, 25 / N)), WIDE)
    assert small.extent == (25 / N, 25 / N)
    whole = np.asarray(blurred(TabulatedNDF(spots), WIDE).values)
    np.testing.assert_allclose(small.values, whole[13:38, 13:38], rtol=1e-12)

    values, extent = np.random.default_rng(3).random((25, 25)), (0.8, 0.3)
    m = disk_cells(25, extent).reshape(3, -1)
    share = values.ravel() * (1.6 / 25) * (0.6 / 25) / m[2]
    expected = gaussian(WIDE.width)(np.arccos(np.minimum(m.T @ m, 1))) @ share
    found = np.ravel(blurred(TabulatedNDF(values, extent), WIDE).values)
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_what_blur_keeps():
    """A constant far from the horizon; the area of a spot, and its width in degrees wherever it is."""
    m, solid_angle = cells(161)
    constant = np.where(solid_angle > 0, 1.0, 0)
    spots = np.zeros((161, 161, 2))
    at_60 = round((1 + np.sin(np.radians(60))) * 161 / 2 - 0.5)
    spots[80, 80, 0] = 1 / solid_angle[80, 80]
    spots[80, at_60, 1] = 1 / solid_angle[80, at_60]
    table = blurred(TabulatedNDF(np.concatenate([constant[..., None], spots], axis=-1)), WIDE).values
    table = np.asarray(table)
    high = m[..., 2] > np.sin(np.radians(20))
    np.testing.assert_allclose(table[..., 0][high & (solid_angle > 0)], 1, atol=3e-5)
    np.testing.assert_allclose(np.einsum("ijk,ij->k", table[..., 1:], solid_angle), 1, atol=3e-5)
    kernel = gaussian(WIDE.width)
    for k, column in ((1, 80), (2, at_60)):
        angle = np.arccos(np.clip(m @ m[80, column], -1, 1))
        core = (angle < WIDE.width) & (solid_angle > 0)
        np.testing.assert_allclose(table[..., k][core], kernel(angle)[core], rtol=1e-10)
    kappa = np.log(2) / (1 - np.cos(WIDE.width / 2))
    mean_cosine = 1 / np.tanh(kappa) - 1 / kappa
    projected = np.einsum("ij,ij->", table[..., 2], solid_angle * m[..., 2])
    np.testing.assert_allclose(projected, mean_cosine * m[80, at_60, 2], rtol=1e-4)


def test_blur_near_the_rim():
    """Within some 1 % to where a cell spans 0.8 widths: 64° in this table."""
    m, solid_angle = cells(N)
    i = (N - 1) // 2
    theta = np.arcsin(m[i, :, 0])
    at = np.max(np.flatnonzero((2 / N) / np.cos(theta) < 0.8 * WIDE.width))
    spot = np.zeros((N, N))
    spot[i, at] = 1 / solid_angle[i, at]
    total = np.sum(np.asarray(blurred(TabulatedNDF(spot), WIDE).values) * solid_angle)
    assert theta[at] > np.radians(64)
    np.testing.assert_allclose(total, 1, atol=0.015)


def test_blur_has_derivatives_and_keeps_the_precision():
    """It is linear in the table; single precision stays."""
    values = np.random.default_rng(2).random((N, N))
    blur = lambda v: blurred(TabulatedNDF(v), WIDE).values  # noqa: E731
    tangent = jax.jvp(blur, (jnp.ones((N, N)),), (jnp.asarray(values),))[1]
    np.testing.assert_allclose(tangent, blur(values), rtol=1e-12)
    single = blur(values.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, blur(values), rtol=1e-4)


def test_a_plan_covers_its_cap():
    """Every point has neighbours at the stated step, and no gap is wider than two steps."""
    h = np.asarray(half_directions())
    assert h.shape == (4000, 3)
    theta = np.degrees(np.arccos(h[:, 2]))
    assert theta.max() < 60
    np.testing.assert_allclose(np.linalg.norm(h, axis=-1), 1, rtol=1e-12)
    tree = cKDTree(h)
    step = 0.0533 * np.hypot(theta, 10)
    nearest = np.degrees(tree.query(h, 2)[0][:, 1])
    assert np.all((nearest > 0.6 * step) & (nearest < 1.3 * step))
    rng = np.random.default_rng(3)
    probe_theta = np.degrees(np.arccos(rng.uniform(np.cos(np.radians(58)), 1, 5000)))
    probes = np.asarray(spherical(np.radians(probe_theta), rng.uniform(0, 2 * np.pi, 5000)))
    assert np.all(np.degrees(tree.query(probes)[0]) < 0.0533 * np.hypot(probe_theta, 10))


def test_misuse():
    with pytest.raises(ValueError, match="a table of at least 153 cells a side; found 51"):
        blurred(TabulatedNDF(np.ones((N, N))))
    with pytest.raises(ValueError, match="one table at a time"):
        blurred(TabulatedNDF(np.ones((2, N, N))), WIDE)
    with pytest.raises(ValueError, match="width must be in"):
        GaussianSignature(0.0)
    for angle, value, message in (
        ([0, 1], [1, 1, 1], "as many values as angles"),
        ([0.1, 1], [1, 0], "grow from 0"),
        ([0, 0], [1, 0], "grow from 0"),
        ([0, 1], [1, 2], "largest at the angle 0"),
        ([0, 1], [1, np.nan], "largest at the angle 0"),
    ):
        with pytest.raises(ValueError, match=message):
            MeasuredSignature(angle, value)
    with pytest.raises(ValueError, match="half_directions: count and core"):
        half_directions(theta_max=2.0)
