"""D_K against the plain sum over the squares, closed forms, and what a rough surface looks like from afar."""

import math

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
HOLES = RNG.random(BUMPS.shape) > 0.05


@pytest.mark.parametrize(
    ("z", "mask", "size"),
    [
        (BUMPS, HOLES, 33),
        (BUMPS.T + 40, HOLES.T, 32),
        (1.5 * RNG.random((9, 14)), np.full((9, 14), True), 33),
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
    return np.asarray(kirchhoff_ndf(rough, 0.5, size=129).values)


def test_a_rough_surface_has_all_its_energy_in_the_table(rough_values):
    assert rough_values.sum() * (2 / 129) ** 2 == pytest.approx(1, abs=0.03)


def rings(values, edges):
    """The mean of a table between polar angles."""
    m_x, m_y, _ = normals(len(values))
    ring = np.digitize(np.arcsin(np.minimum(np.hypot(m_x, m_y), 1)), edges)
    return np.array([values[ring == k].mean() for k in range(1, len(edges))])


EDGES = np.radians([0, 5, 10, 15, 20, 25, 30])


def test_a_gaussian_surface_tends_to_beckmann(rough_values):
    m = np.nan_to_num(np.stack(normals(129), axis=-1))
    m[m[..., 2] == 0] = [1, 0, 0]
    expected = rings(np.asarray(Beckmann(0.3, 0.3)(m)), EDGES)
    np.testing.assert_allclose(rings(rough_values, EDGES), expected, rtol=0.2)


def test_d_hardly_depends_on_the_wavelength(rough, rough_values):
    """Dong et al. 2015, figure 6: on a rough surface, once the speckle is blurred; the innermost ring has too
    few cells for that."""
    longer = kirchhoff_ndf(rough, 0.7, size=129).values
    np.testing.assert_allclose(
        rings(np.asarray(longer), EDGES[1:]), rings(rough_values, EDGES[1:]), rtol=0.15
    )


def test_single_precision_stays_and_reaches_its_own(rough, rough_values):
    single = kirchhoff_ndf(Heightfield(rough.z.astype(np.float32), 0.125, 0.125), 0.5, size=129).values
    assert single.dtype == np.float32
    scale = np.sqrt(rough_values * rough_values.max())
    assert np.max(np.abs(single - rough_values) / np.maximum(scale, 1e-3)) < 1e-4


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


def test_gradients_by_the_heights_are_those_of_finite_differences():
    z = jnp.asarray(BUMPS[:10, :12])
    weight = jnp.asarray(RNG.normal(size=(17, 17)))

    @jax.jit
    def total(z):
        return jnp.sum(weight * kirchhoff_ndf(Heightfield(z, 0.1, 0.12), 0.55, size=17, relief=3.0).values)

    gradient = jax.jit(jax.grad(total))(z)
    for i, j in [(0, 0), (5, 6), (9, 11)]:
        step = jnp.zeros_like(z).at[i, j].set(1e-5)
        difference = (total(z + step) - total(z - step)) / 2e-5
        assert float(gradient[i, j]) == pytest.approx(float(difference), rel=1e-5)


def test_a_reflectance_holds_tables_over_its_wavelengths():
    h = Heightfield(BUMPS, 0.1, 0.12, HOLES)
    brdf = kirchhoff_brdf(h, [0.65, 0.55, 0.45], Conductor(1.0, 5.0), tables=2, size=17)
    np.testing.assert_allclose(brdf.wavelengths_q, [0.45, 1.3])
    np.testing.assert_allclose(brdf.values[0], kirchhoff_ndf(h, 0.45, size=17).values)
    f = brdf(spherical(0.1, 0.0), spherical(0.1, 3.0))
    assert f.shape == (3,)
    assert np.all(np.isfinite(f))


def test_what_pixels_resolve():
    h = Heightfield(BUMPS, 0.1, 0.2)
    assert resolved_angle(h, 0.4) == pytest.approx(np.pi / 6)
    assert resolved_angle(h, 2.0) == np.pi / 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1.0,), "greater than 0; found -1"),
        ((0.1,), "below the pixel size: with pixels of 0.2 µm it must be at least 0.2 µm"),
        ((0.4, None, 9, 1.0), "resolve a wavelength of 0.4 µm to 0.524 radians"),
        ((0.4, None, 9, 2.0), r"must lie in \(0, π/2\]"),
        ((0.4, 0.01), "patch must be at least one pixel, 0.2 µm"),
    ],
)
def test_what_cannot_be_computed_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        kirchhoff_ndf(Heightfield(BUMPS, 0.1, 0.2), *arguments)


def test_a_map_without_a_whole_square_is_refused():
    mask = np.indices((6, 6)).sum(axis=0) % 2 == 0
    with pytest.raises(ValueError, match="four neighbouring points"):
        kirchhoff_ndf(Heightfield(np.zeros((6, 6)), 0.1, 0.1, mask), 0.5, size=9)
