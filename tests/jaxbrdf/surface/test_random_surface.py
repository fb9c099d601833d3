"""Random surfaces have the heights, slopes and correlation that were asked for."""

import jax
import numpy as np
import pytest

from jaxbrdf import gaussian_surface

SHAPE = (1024, 1024)


@pytest.mark.parametrize(
    ("decay", "correlation"), [("gaussian", lambda r: np.exp(-(r**2))), ("exponential", lambda r: np.exp(-r))]
)
def test_correlation_is_as_asked_along_both_axes(decay, correlation):
    surface = gaussian_surface(jax.random.key(0), SHAPE, (0.5, 1.0), 0.3, (4.0, 12.0), decay)
    z = np.asarray(surface.z)
    power = np.abs(np.fft.fft2(z)) ** 2
    found = np.fft.ifft2(power).real / z.size
    lags = np.arange(0, 30, 3)
    assert z.std() == pytest.approx(0.3, rel=0.03)
    np.testing.assert_allclose(found[0, lags], 0.09 * correlation(0.5 * lags / 4), atol=0.09 * 0.06)
    np.testing.assert_allclose(found[lags, 0], 0.09 * correlation(1.0 * lags / 12), atol=0.09 * 0.06)
    assert (surface.dx, surface.dy) == (0.5, 1.0)


def test_slopes_of_a_gaussian_correlation():
    z = np.asarray(gaussian_surface(jax.random.key(1), SHAPE, 1.0, 0.5, 12.0).z)
    slope = (np.roll(z, -1, axis=1) - np.roll(z, 1, axis=1)) / 2
    assert slope.std() == pytest.approx(np.sqrt(2) * 0.5 / 12, rel=0.03)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.0, 0.0, 9.0), "greater than 0"),
        ((-1.0, 1.0, 9.0), "greater than 0"),
        ((1.0, 1.0, 1.5), "between two pixels, 2 µm, and a quarter of the map, 16 µm; found 1.5"),
        ((1.0, 1.0, (9.0, 17.0)), "along y"),
        ((1.0, 1.0, 9.0, "linear"), "gaussian, exponential"),
    ],
)
def test_what_the_grid_cannot_hold_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        gaussian_surface(jax.random.key(0), (64, 64), *arguments)
