"""Tilt, form and spikes are taken off, and nothing else."""

import jax
import numpy as np
import pytest

from jaxbrdf import Heightfield, gaussian_surface, levelled, without_outliers

Y, X = np.mgrid[:30, :40] * 0.5


@pytest.mark.parametrize(
    ("degree", "form"), [(1, 3 + 0.2 * X - 0.5 * Y), (2, 1 - X + 0.3 * Y + 0.02 * X**2 - 0.01 * X * Y)]
)
def test_form_is_taken_off_whatever_is_missing(degree, form):
    rng = np.random.default_rng(0)
    mask = rng.random(X.shape) > 0.3
    flat = levelled(Heightfield(np.where(mask, form, np.nan), 0.5, 0.5, mask), degree)
    np.testing.assert_allclose(np.asarray(flat.heights), 0, atol=1e-11)
    np.testing.assert_array_equal(flat.mask, mask)


def test_levelling_is_least_squares_and_differentiable():
    z = np.random.default_rng(1).standard_normal(X.shape)
    design = np.stack([np.ones_like(X), X, Y], axis=-1).reshape(-1, 3)
    truth = z.ravel() - design @ np.linalg.lstsq(design, z.ravel())[0]
    np.testing.assert_allclose(np.ravel(levelled(Heightfield(z, 0.5, 0.5)).z), truth, atol=1e-12)
    gradient = jax.grad(lambda z: levelled(Heightfield(z, 0.5, 0.5)).z[3, 4])(z)
    np.testing.assert_allclose(np.sum(gradient * X), 0, atol=1e-12)  # a plane changes nothing


def test_spikes_are_masked_and_slopes_are_not():
    z = 2 * X + 0.01 * np.random.default_rng(2).standard_normal(X.shape)
    z[7, 9] += 20
    mask = np.ones(X.shape, bool)
    mask[20:, 30:] = False
    kept = without_outliers(Heightfield(z, 0.5, 0.5, mask))
    expected = mask.copy()
    expected[7, 9] = False
    assert not kept.mask[7, 9]
    assert np.mean(np.asarray(kept.mask) != expected) < 0.01


@pytest.mark.parametrize("step", [0.0, 0.05, 0.2])
def test_surfaces_without_noise_lose_their_spike_alone(step):
    """Half the pixels of a smooth surface, or of one in steps, are the median of those around them."""
    z = np.asarray(gaussian_surface(jax.random.key(0), (120, 160), 0.25, 0.5, 6.0).z)
    z = np.round(z / step) * step if step else z.copy()
    z[7, 9] += 20
    expected = np.ones(z.shape, bool)
    expected[7, 9] = False
    np.testing.assert_array_equal(without_outliers(Heightfield(z, 0.25, 0.25)).mask, expected)


def test_misuse_is_explained():
    with pytest.raises(ValueError, match="degree 3"):
        levelled(Heightfield(X, 1, 1), 3)
    with pytest.raises(ValueError, match="odd window"):
        without_outliers(Heightfield(X, 1, 1), window=4)
