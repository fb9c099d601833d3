"""Textures vary as their exemplars do: mean, variance, correlation along both axes and between channels."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import ks_2samp, norm

from jaxbrdf import gaussian_surface, synthesize_texture, texture_like
from jaxbrdf.surface.texture import _normal_scores

SIZE = (120, 150)
LAGS = np.array([1, 3, 6, 12])
KEYS = jax.random.split(jax.random.key(5), 400)


def normal(seed, *shape):
    return np.random.default_rng(seed).normal(size=shape)


def processes(seed, count, n, length):
    """Normal sequences of correlation exp(−x / length), (count, n): x_t = a x_{t−1} + √(1 − a²) noise."""
    noise, a = normal(seed, count, n), np.exp(-1 / length)
    x = noise.copy()
    for t in range(1, n):
        x[:, t] = a * x[:, t - 1] + np.sqrt(1 - a * a) * noise[:, t]
    return x


def correlated_channels(n=96):
    """An image of two channels whose correlation is 0.8, long along x."""
    first, second = (gaussian_surface(jax.random.key(k), (n, n), 1.0, 1.0, (12.0, 3.0)).z for k in (1, 2))
    return np.stack([first, 0.8 * first + 0.6 * second], axis=-1) * [0.1, 3.0] + [0.5, -2.0]


def correlation(textures, axis):
    """The correlation of values LAGS apart, about the mean of all."""
    z = textures - textures.mean()
    return np.array([np.mean(z * np.roll(z, lag, axis)) for lag in LAGS]) / np.mean(z * z)


@pytest.fixture(scope="module")
def from_strips():
    """Textures of 400 pairs of strips: of correlation exp(−x/5) along x, 120 long, and exp(−y/2) along y."""
    along, across = processes(0, 400, 120, 5.0), processes(1, 400, 120, 2.0)
    make = jax.jit(jax.vmap(lambda key, x, y: synthesize_texture(key, x, y, (121, 150))))
    return along, across, np.asarray(make(KEYS, along, across))


def test_a_separable_field_is_found_again_along_both_axes(from_strips):
    np.testing.assert_allclose(correlation(from_strips[2], 2), np.exp(-LAGS / 5), atol=0.06)
    np.testing.assert_allclose(correlation(from_strips[2], 1), np.exp(-LAGS / 2), atol=0.04)
    assert from_strips[2].var() == pytest.approx(1, abs=0.06)


def test_correlation_is_a_product_of_one_along_each_axis(from_strips):
    """At 16 pairs of lags; exp(−√(x²/25 + y²/4)) would differ by 0.15."""
    z = from_strips[2]
    found = np.fft.ifft2(np.mean(np.abs(np.fft.fft2(z)) ** 2, axis=0)).real / z[0].size / z.var()
    expected = np.exp(-LAGS[:, None] / 2 - LAGS / 5)
    np.testing.assert_allclose(found[np.ix_(LAGS, LAGS)], expected, atol=0.06)


def test_rows_and_columns_keep_means_of_their_own(from_strips):
    """Their variance is σ² Σ C / n, a little less as spectra fall before 1/n; of mean-free strips 0."""
    z = from_strips[2] - from_strips[2].mean(axis=(1, 2), keepdims=True)
    for axis, length in ((2, 5.0), (1, 2.0)):
        n = z.shape[axis]
        correlation = np.exp(-np.minimum(np.arange(n), n - np.arange(n)) / length)
        assert 0.65 < z.mean(axis=axis).var() / (z.var() * correlation.sum() / n) < 1.05


def test_mean_and_variance_are_those_of_the_strips(from_strips):
    along, across, textures = from_strips
    variances = np.stack([along.var(1), across.var(1)])
    means = np.stack([along.mean(1), across.mean(1)])
    for found, of_strips in ((textures.var(axis=(1, 2)), variances), (textures.mean(axis=(1, 2)), means)):
        np.testing.assert_allclose(found, np.average(of_strips, axis=0, weights=variances), atol=1e-10)


def test_strips_as_long_as_the_texture_give_the_product_of_their_spectra():
    """And 0 has its neighbour's power. The fading at the edges is written anew."""
    x, y = normal(2, 32), normal(3, 48)
    texture = synthesize_texture(jax.random.key(0), x, y, (48, 32))

    def amplitude(strip):
        n = len(strip)
        inside = np.clip(8 * np.minimum(np.arange(1, n + 1), np.arange(n, 0, -1)) / (n + 1), 0, 1)
        fade = np.sin(np.pi / 2 * inside) ** 2
        return np.abs(np.fft.fft(fade * (strip - np.average(strip, weights=fade))))

    found, amplitudes = np.abs(np.fft.fft2(texture)), [amplitude(y), amplitude(x)]
    for a in amplitudes:
        a[0] = a[1]
    expected = np.outer(*amplitudes)
    expected[0, 0] = 0
    found[0, 0] = 0
    np.testing.assert_allclose(found / found[1, 1], expected / expected[1, 1], rtol=1e-9)


def test_edges_do_not_roughen_smooth_textures():
    """Neighbours in a smooth field, correlation exp(−(r/16)²), of which the exemplar is 64 wide."""
    z = np.asarray(gaussian_surface(jax.random.key(7), (256, 256), 1.0, 1.0, 16.0).z)
    exemplars = z.reshape(4, 64, 4, 64).swapaxes(1, 2).reshape(16, 64, 64)
    like = jax.jit(jax.vmap(lambda key, e: texture_like(key, e, (100, 100))))
    textures = np.asarray(like(KEYS[:16], exemplars))
    rough, true = (np.mean(np.diff(a, axis=2) ** 2) for a in (textures, exemplars))
    assert 0.9 < rough / true < 2


@pytest.mark.parametrize("separable", [False, True])
def test_an_image_keeps_mean_variance_and_correlation(separable):
    exemplar = correlated_channels()
    texture = np.asarray(texture_like(jax.random.key(1), exemplar, SIZE, separable=separable))
    assert texture.shape == (*SIZE, 2)
    for channel in (0, 1):
        a, b = texture[..., channel], exemplar[..., channel]
        assert a.mean() == pytest.approx(b.mean(), rel=1e-10)
        assert a.std() == pytest.approx(b.std(), rel=1e-10)
        for axis, length in ((1, 12.0), (0, 3.0)):
            np.testing.assert_allclose(correlation(a, axis), np.exp(-((LAGS / length) ** 2)), atol=0.15)


@pytest.mark.parametrize(
    ("options", "low", "high"),
    [
        ({}, 0.78, 0.82),
        ({"separable": True}, 0.65, 0.82),
        ({"marginals": True}, 0.77, 0.82),
        ({"correlated": False}, -0.2, 0.2),
    ],
    ids=["plain", "separable", "marginals", "independent"],
)
def test_channels_go_together_as_in_the_exemplar(options, low, high):
    exemplar = correlated_channels()
    texture = np.asarray(texture_like(jax.random.key(3), exemplar, SIZE, **options))
    found, true = (np.corrcoef(image.reshape(-1, 2).T)[0, 1] for image in (texture, exemplar))
    assert true == pytest.approx(0.8, abs=0.05)
    assert low < found - true + 0.8 < high


def test_a_separable_image_has_a_product_for_its_spectrum():
    texture = texture_like(jax.random.key(4), correlated_channels()[..., 0], (97, 100), separable=True)
    amplitude = np.abs(np.fft.fft2(texture))
    amplitude[0, 0] = amplitude[0, 1] * amplitude[1, 0] / amplitude[1, 1]
    singular = np.linalg.svd(amplitude, compute_uv=False)
    assert singular[1] < 1e-10 * singular[0]


def test_values_are_distributed_as_in_the_exemplar():
    """A skewed exemplar of positive values; without `marginals` a tenth would be negative."""
    z = np.asarray(gaussian_surface(jax.random.key(9), (128, 128), 1.0, 1.0, (6.0, 4.0)).z)
    exemplar = np.exp(z)
    plain, kept = (
        np.asarray(texture_like(jax.random.key(2), exemplar, (256, 200), marginals=marginals))
        for marginals in (False, True)
    )
    assert np.mean(plain < 0) > 0.05
    assert exemplar.min() <= kept.min()
    assert kept.max() <= exemplar.max()
    assert ks_2samp(kept.reshape(-1), exemplar.reshape(-1)).statistic < 0.02
    neighbours = [np.corrcoef(a[:, 3:].reshape(-1), a[:, :-3].reshape(-1))[0, 1] for a in (kept, exemplar)]
    assert neighbours[0] == pytest.approx(neighbours[1], abs=0.05)


def test_normal_scores_share_the_ranks_of_equal_values():
    values = jnp.array([3.0, 1.0, jnp.nan, 1.0, 7.0]).reshape(1, 1, 5)
    expected = norm.ppf(np.array([2.5, 1.0, np.nan, 1.0, 3.5]) / 4)
    np.testing.assert_allclose(_normal_scores(values)[0, 0], expected, rtol=1e-12)


@pytest.mark.parametrize("options", [{}, {"separable": True}, {"marginals": True}])
def test_unknown_values_are_left_out(options):
    exemplar = correlated_channels()
    exemplar[normal(4, 96, 96) > 1] = np.nan
    texture = np.asarray(texture_like(jax.random.key(6), exemplar, SIZE, **options))
    known = exemplar[~np.isnan(exemplar[..., 0])]
    error = 0.02 if "marginals" in options else 1e-9
    np.testing.assert_allclose(texture.mean(axis=(0, 1)), known.mean(0), rtol=error)
    np.testing.assert_allclose(texture.std(axis=(0, 1)), known.std(0), rtol=error)
    correlation = np.corrcoef(texture[:, 8:, 0].reshape(-1), texture[:, :-8, 0].reshape(-1))[0, 1]
    assert correlation > 0.4  # exp(−(8/12)²) = 0.64, less the noise that gaps add
    strips = exemplar[50], exemplar[:, 50]
    assert np.all(np.isfinite(synthesize_texture(jax.random.key(6), *strips, (20, 200))))


def test_what_does_not_vary_stays_as_it_is():
    """To the last digit, of a number that binary fractions only come near."""
    image = np.full((9, 11, 2), 0.1)
    image[..., 1] = normal(5, 9, 11)
    for options in ({}, {"separable": True}, {"marginals": True}):
        texture = texture_like(jax.random.key(0), image, (20, 5), **options)
        assert np.all(np.asarray(texture)[..., 0] == 0.1)
        assert np.asarray(texture)[..., 1].std() > 0.1
    assert np.all(
        np.asarray(synthesize_texture(jax.random.key(0), image[0, :, 0], image[:, 0, 0], (4, 4))) == 0.1
    )


@pytest.mark.parametrize(("dtype", "error"), [(np.float32, 1e-4), (np.float64, 1e-12)])
def test_shape_precision_and_key(dtype, error):
    image = normal(6, 6, 9, 3).astype(dtype)
    key, other = jax.random.split(jax.random.key(8))
    for make in (
        lambda key: synthesize_texture(key, image[0], image[:, 0], (7, 8)),
        lambda key: texture_like(key, image, (7, 8), marginals=True),
    ):
        texture = make(key)
        assert (texture.shape, texture.dtype) == ((7, 8, 3), dtype)
        np.testing.assert_array_equal(texture, make(key))
        assert np.any(np.asarray(texture) != make(other))
        np.testing.assert_allclose(jax.jit(make)(key), texture, rtol=error, atol=error)


def test_a_single_channel_needs_no_axis_and_is_that_of_several():
    image, key = normal(7, 6, 9), jax.random.key(8)
    for make in (
        lambda image: synthesize_texture(key, image[0], image[:, 0], (1, 1)),
        lambda image: texture_like(key, image, (1, 1)),
    ):
        assert make(image).shape == (1, 1)
        np.testing.assert_allclose(make(image), make(image[..., None])[..., 0], rtol=1e-12)


def test_a_smaller_texture_is_a_part_of_one_that_repeats_itself():
    exemplar = correlated_channels()
    whole = texture_like(jax.random.key(1), exemplar, (96, 96))
    np.testing.assert_array_equal(texture_like(jax.random.key(1), exemplar, (20, 50)), whole[:20, :50])
    step_x = np.diff(np.asarray(whole), axis=1, append=np.asarray(whole)[:, :1])
    assert np.std(step_x[:, -1, 0]) < 2 * np.std(step_x[:, :-1, 0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda key: texture_like(key, np.ones(4), (4, 4)), r"the exemplar, .* found shape \(4,\)"),
        (lambda key: texture_like(key, np.ones((0, 4)), (4, 4)), r"found shape \(0, 4\)"),
        (lambda key: texture_like(key, np.ones((4, 4)), (4,)), "two positive whole numbers"),
        (lambda key: texture_like(key, np.ones((4, 4)), (4, 0)), r"found \(4, 0\)"),
        (lambda key: texture_like(key, np.array([[1.0, np.inf]]), (4, 4)), "finite"),
        (lambda key: texture_like(key, np.array([[1.0, np.nan]]), (4, 4)), "two known values .* found 1"),
        (lambda key: synthesize_texture(key, np.ones((4, 4, 4)), np.ones(4), (4, 4)), r"along, \(n,\)"),
        (
            lambda key: synthesize_texture(key, np.ones(4), np.array([np.nan, 1]), (4, 4)),
            r"across, .* found 1",
        ),
        (
            lambda key: synthesize_texture(key, np.ones((4, 2)), np.ones((4, 3)), (4, 4)),
            r"\(4, 2\) and \(4, 3\)",
        ),
        (lambda key: synthesize_texture(key, np.ones((4, 1)), np.ones(4), (4, 4)), "the same channels"),
        (lambda key: synthesize_texture(key, np.ones(4), np.ones(4), (-4, 4)), r"found \(-4, 4\)"),
    ],
)
def test_what_is_no_exemplar_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call(jax.random.key(0))
