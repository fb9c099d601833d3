"""D_K against the plain sum over the squares, closed forms, and what a rough surface looks like from afar."""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbrdf import (
    Beckmann,
    Conductor,
    Heightfield,
    coherent_patches,
    kirchhoff_brdf,
    kirchhoff_ndf,
    resolved_angle,
    spherical,
)

Heights = Callable[[np.ndarray, np.ndarray], np.ndarray]


def normals(size):
    """(m_x, m_y, m_z) of a table's cells; m_z is NaN outside the disk."""
    centre = (2 * np.arange(size) + 1) / size - 1
    m_x, m_y = np.meshgrid(centre, centre)
    with np.errstate(invalid="ignore"):
        return m_x, m_y, np.sqrt(1 - m_x**2 - m_y**2)


def plain_sum(z, dx, dy, mask, wavelength, size):
    """Σ over squares of four measured corners, one direction after the other."""
    corners = [(slice(i, i - 1 or None), slice(j, j - 1 or None)) for i in (0, 1) for j in (0, 1)]
    a, b, c, d = (z[corner] for corner in corners)  # (y, x) = 00, 01, 10, 11
    complete = np.all([mask[corner] for corner in corners], axis=0)
    y, x = ((np.arange(n) + 0.5) * step for n, step in zip(a.shape, (dy, dx), strict=True))
    q_x, q_y, q_z = (4 * np.pi / wavelength * m for m in normals(size))
    D = np.zeros((size, size))
    for index in np.argwhere(~np.isnan(q_z)):
        u, v, w = (q[tuple(index)] for q in (q_x, q_y, q_z))
        flux = w - u * (b + d - a - c) / (2 * dx) - v * (c + d - a - b) / (2 * dy)
        phase = u * x[None, :] + v * y[:, None] + w * (a + b + c + d) / 4
        D[tuple(index)] = abs(np.sum((flux * np.exp(-1j * phase))[complete])) ** 2
    return D * dx * dy / (4 * np.pi**2 * complete.sum())


def gaussian_surface(shape, dx, rms, correlation, seed=0):
    """A periodic surface of Gaussian heights with the autocorrelation rms² exp(−(r / correlation)²)."""
    f_y, f_x = (np.fft.fftfreq(n, dx) for n in shape)
    noise = np.fft.fft2(np.random.default_rng(seed).normal(size=shape))
    spectrum = np.exp(-((np.pi * correlation) ** 2) * (f_y[:, None] ** 2 + f_x[None, :] ** 2) / 2)
    z = np.fft.ifft2(noise * spectrum).real
    return rms * z / z.std()


RNG = np.random.default_rng(7)
BUMPS = gaussian_surface((24, 35), 0.1, 0.5, 0.6)
NOISE = 1.5 * RNG.random((9, 14))
HOLES = RNG.random(BUMPS.shape) > 0.05


@pytest.mark.parametrize(
    ("z", "mask", "size"),
    [
        (BUMPS, HOLES, 33),
        (BUMPS.T + 40, HOLES.T, 32),
        (NOISE, np.full(NOISE.shape, True), 33),
    ],
    ids=["bumps", "bumps, even table", "noise"],
)
def test_every_cell_is_the_plain_sum(z, mask, size):
    dx, dy, wavelength = 0.1, 0.12, 0.55
    table = kirchhoff_ndf(Heightfield(np.where(mask, z, np.nan), dx, dy, mask), wavelength, size=size)
    expected = plain_sum(z, dx, dy, mask, wavelength, size)
    np.testing.assert_allclose(table.values, expected, rtol=1e-6, atol=1e-15 * expected.max())


def test_beyond_the_angle_nothing_and_within_it_the_same():
    h = Heightfield(BUMPS, 0.1, 0.12, HOLES)
    whole, narrow = (kirchhoff_ndf(h, 0.55, size=33, max_angle=angle).values for angle in (None, 0.5))
    m_x, m_y, _ = normals(33)
    within = np.hypot(m_x, m_y) <= np.sin(0.5)
    np.testing.assert_allclose(narrow, np.where(within, whole, 0), rtol=1e-9)


@pytest.mark.parametrize(("a", "b"), [(0.0, 0.0), (0.3, -0.2)])
def test_a_plane_shines_with_the_sinc_of_its_aperture(a, b):
    dx, dy, wavelength, size = 0.01, 0.012, 0.5, 65
    x, y = np.arange(161) * dx, np.arange(101)[:, None] * dy
    D = kirchhoff_ndf(Heightfield(a * x[None, :] + b * y, dx, dy), wavelength, size=size).values
    q_x, q_y, q_z = (4 * np.pi / wavelength * m for m in normals(size))
    width, height = x[-1], y[-1, 0]
    spread = np.sinc((q_x + a * q_z) * width / (2 * np.pi)) * np.sinc((q_y + b * q_z) * height / (2 * np.pi))
    expected = np.nan_to_num((q_z - a * q_x - b * q_y) ** 2 * width * height / (4 * np.pi**2) * spread**2)
    np.testing.assert_allclose(D, expected, atol=1e-3 * expected.max())
    assert np.abs(D - expected)[expected > 0.3 * expected.max()].max() < 1e-3 * expected.max()


def test_facets_that_rise_with_x_look_towards_negative_x():
    x = np.arange(41) * 0.1
    D = kirchhoff_ndf(Heightfield(np.tile(0.3 * x, (31, 1)), 0.1, 0.1), 0.5, size=65).values
    row, column = np.unravel_index(np.argmax(D), D.shape)
    assert row == 32
    assert (2 * column + 1) / 65 - 1 == pytest.approx(-0.3 / math.hypot(1, 0.3), abs=1 / 65)


@pytest.fixture(scope="module")
def rough():
    """Pixels of λ/4, σ = 0.3 and τ = 2 µm: q_z σ ≈ 7.5 waves high, and a slope α = 2 σ/τ of 0.3."""
    return Heightfield(gaussian_surface((513, 513), 0.125, 0.3, 2.0), 0.125, 0.125)


@pytest.fixture(scope="module")
def rough_values(rough):
    return np.asarray(kirchhoff_ndf(rough, 0.5, size=257).values)


def test_a_rough_surface_has_all_its_energy_in_the_table(rough_values):
    assert rough_values.sum() * (2 / 257) ** 2 == pytest.approx(1, abs=0.03)


def rings(values, edges):
    """The mean of a table between polar angles."""
    m_x, m_y, _ = normals(len(values))
    ring = np.digitize(np.arcsin(np.minimum(np.hypot(m_x, m_y), 1)), edges)
    return np.array([values[ring == k].mean() for k in range(1, len(edges))])


EDGES = np.radians([0, 5, 10, 15, 20, 25, 30])


def test_a_gaussian_surface_tends_to_beckmann(rough_values):
    m = np.nan_to_num(np.stack(normals(257), axis=-1))
    m[m[..., 2] == 0] = [1, 0, 0]
    expected = rings(np.asarray(Beckmann(0.3, 0.3)(m)), EDGES)
    np.testing.assert_allclose(rings(rough_values, EDGES), expected, rtol=0.2)


def test_d_hardly_depends_on_the_wavelength(rough, rough_values):
    """Dong et al. 2015, figure 6: on a rough surface, once the speckle is blurred."""
    longer = kirchhoff_ndf(rough, 0.7, size=257).values
    np.testing.assert_allclose(rings(np.asarray(longer), EDGES), rings(rough_values, EDGES), rtol=0.12)


def test_single_precision_stays_and_reaches_its_own(rough, rough_values):
    single = kirchhoff_ndf(Heightfield(rough.z.astype(np.float32), 0.125, 0.125), 0.5, size=257).values
    assert single.dtype == np.float32
    amplitude, expected = np.sqrt(single), np.sqrt(rough_values)
    np.testing.assert_allclose(amplitude, expected, atol=5e-6 * expected.max())


def test_patches_cover_the_map_and_are_averaged_by_area():
    z = gaussian_surface((31, 52), 0.1, 0.2, 0.5)
    mask = np.ones(z.shape, bool)
    mask[:20, :19], mask[25, 30] = False, False
    h = Heightfield(z, 0.1, 0.12, mask)
    pieces = coherent_patches(h, 1.8)
    assert [p.z.shape for p in pieces] == [(16, 19)] * 5
    calls = []
    D = kirchhoff_ndf(h, 0.55, 1.8, size=17, progress=lambda done, of: calls.append((done, of))).values
    assert calls == [(k, 5) for k in range(1, 6)]
    areas = [
        np.sum(m[1:, 1:] & m[1:, :-1] & m[:-1, 1:] & m[:-1, :-1]) for m in (np.array(p.mask) for p in pieces)
    ]
    each = [kirchhoff_ndf(p, 0.55, math.inf, size=17).values for p in pieces]
    np.testing.assert_allclose(D, np.average(each, axis=0, weights=areas), rtol=1e-9)


def test_the_gradient_is_that_of_differences_inside_jit_and_outside():
    z, mask, step = jnp.asarray(BUMPS[:12, :15]), jnp.asarray(HOLES[:12, :15]), 1e-5
    weight, direction = (np.random.default_rng(3).random(shape) for shape in ((17, 17), z.shape))

    def total(z, relief=None):
        h = Heightfield(z, 0.1, 0.12, mask)
        return jnp.sum(weight * kirchhoff_ndf(h, 0.55, size=17, relief=relief).values)

    value, gradient = jax.value_and_grad(total)(z)
    inside = jax.jit(jax.value_and_grad(lambda z: total(z, relief=2.0)))(z)
    ahead, behind = (total(z + sign * step * direction) for sign in (1, -1))
    assert float(jnp.sum(gradient * direction)) == pytest.approx(float(ahead - behind) / (2 * step), rel=1e-6)
    assert float(inside[0]) == pytest.approx(float(value), rel=1e-9)
    np.testing.assert_allclose(inside[1], gradient, rtol=1e-7, atol=1e-9 * np.abs(gradient).max())


def test_a_reflectance_from_a_map():
    h = Heightfield(BUMPS, 0.1, 0.12)
    brdf = kirchhoff_brdf(h, [0.5, 0.6], Conductor(1.0, 5.0), tables=2, size=33, max_angle=1.0)
    np.testing.assert_allclose(brdf.wavelengths_q, [0.5, 1.2])
    np.testing.assert_allclose(brdf.values[0], kirchhoff_ndf(h, 0.5, size=33, max_angle=1.0).values)
    np.testing.assert_allclose(brdf.values[1], kirchhoff_ndf(h, 1.2, size=33, max_angle=1.0).values)
    wi, wo = spherical(jnp.array(0.3), jnp.array(0.0)), spherical(jnp.array(0.4), jnp.array(2.0))
    assert brdf(wi, wo).shape == (2,)


def test_the_angle_that_pixels_resolve():
    coarse = Heightfield(np.zeros((4, 4)), 0.1, 0.3)
    assert resolved_angle(coarse, 0.6) == pytest.approx(math.pi / 6)
    assert resolved_angle(coarse, 1.3) == math.pi / 2
    m_x, m_y, _ = normals(33)
    D = kirchhoff_ndf(coarse, 0.6, size=33).values
    np.testing.assert_array_equal(D > 0, np.hypot(m_x, m_y) <= 0.5)


ISLANDS = np.indices((6, 6)).sum(axis=0) % 2 == 0


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((0.0,), {}, "greater than 0; found 0"),
        ((-0.5,), {}, "greater than 0; found -0.5"),
        ((math.nan,), {}, "greater than 0; found nan"),
        ((0.25,), {}, "below the pixel size: .* need at least 0.3 µm, and 1.2 µm for the whole disk"),
        ((0.6,), {"max_angle": 0.6}, "to 0.524 radians .* max_angle is 0.6. .* at least 0.677"),
        ((1.3,), {"max_angle": 0.0}, "max_angle must lie in"),
        ((1.3, 0.2), {}, "patch must be at least one pixel, 0.3 µm; found 0.2"),
        ((1.3,), {"size": 0}, "size must be at least 1; found 0"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        kirchhoff_ndf(Heightfield(np.zeros((6, 6)), 0.1, 0.3), *arguments, **options)


def test_a_map_without_squares_and_unknown_heights_are_refused():
    with pytest.raises(ValueError, match="nowhere were four neighbouring points measured"):
        kirchhoff_ndf(Heightfield(np.zeros((6, 6)), 0.1, 0.1, ISLANDS), 0.5)
    with pytest.raises(ValueError, match="give relief"):
        jax.jit(lambda z: kirchhoff_ndf(Heightfield(z, 0.1, 0.1), 0.5).values)(np.zeros((6, 6)))
    with pytest.raises(ValueError, match=r"greater than 0; found -0\.5"):
        kirchhoff_brdf(Heightfield(np.zeros((6, 6)), 0.1, 0.1), np.array([0.5, -0.5]), Conductor(1.0, 5.0))
