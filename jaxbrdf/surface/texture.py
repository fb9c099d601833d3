r"""Textures of parameters that vary over a surface as those of an exemplar do: its spectrum, other phases.

A texture is (H, W, C), or (H, W) for a single channel without an axis of its own: x runs along the columns, y
along the rows, channels are parameters, each in its own unit. It is a random field that is stationary and
about normally distributed. So parameters that are positive, as α, are best given by their logarithms; or with
`marginals`, which keep within the values of the exemplar. It repeats itself seamlessly unless it is smaller
than the exemplar.

NaN in an exemplar stands for what is unknown, and is left out.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr, ndtri
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Complex, Float

from jaxbrdf.arrays import floats
from jaxbrdf.special import safe_divide, safe_sqrt

_TAPERED = 1 / 8  # of an exemplar's length, at either end


def synthesize_texture(
    key: Array, along: ArrayLike, across: ArrayLike, shape: tuple[int, ...]
) -> Float[Array, "..."]:
    r"""A texture of `shape` (H, W) from two strips of it, one along x and one along y.

        T(f_x, f_y) ∝ |X(f_x)| |Y(f_y)| e^{iφ},   φ random

    Dong et al. 2015, section 9: the covariance is taken for a product of one along x and one along y, and
    channels for independent of each other. `along` is (n, C), its rows running along x, and `across` (k, C)
    along y, both in the texture's steps; the result is (H, W, C). Strips (n,) and (k,) give (H, W). `key` is
    a `jax.random.key`.

    Mean and variance are the strips' means and variances, each weighted by the variance of its strip. For a
    strip along which a field hardly varies, as along scratches, knows neither: it falls short of the field's
    variance by the variance of its own mean. Of strips of 100 values, correlated over 1000 along and over 3
    across, these err by 0.25 σ² and 0.24 σ, where plain means err by 0.53 σ² and 0.50 σ. The texture has both
    exactly; one smaller than a strip is a part of a larger one that has them.

    Raises ValueError for a shape that is not two positive whole numbers, strips of other shapes or of
    different channels, infinite values, and a channel of fewer than two known ones.
    """
    x, y = _channels(along, 1, "along, (n,) or (n, C),"), _channels(across, 1, "across, (k,) or (k, C),")
    if len(x) != len(y) or jnp.ndim(along) != jnp.ndim(across):
        raise ValueError(
            "synthesize_texture: along and across must have the same channels; found shapes "
            f"{jnp.shape(along)} and {jnp.shape(across)}"
        )
    texture = _from_strips(key, x, y, _whole(shape, (y.shape[1], x.shape[1])))
    return _cut(texture, shape, jnp.ndim(along) == 2)


def texture_like(
    key: Array,
    exemplar: ArrayLike,
    shape: tuple[int, ...],
    *,
    separable: bool = False,
    correlated: bool = True,
    marginals: bool = False,
) -> Float[Array, "..."]:
    r"""A texture of `shape` (H, W) that varies as an image of parameters does, (h, w, C) or (h, w).

        T_c(f) ∝ X_c(f) e^{iφ(f)},   φ random

    X_c is the exemplar's spectrum. With `correlated` channels one φ serves all of them, which keeps their
    cross-spectra X_a X_b*, and with these how channels go together (Galerne, Gousseau & Morel 2011, "Random
    phase textures"); otherwise each has its own and they are independent. The texture has each channel's mean
    and variance exactly; one smaller than the exemplar is a part of a larger one that has them. `key` is a
    `jax.random.key`.

    A `separable` one has |T(f)|² ∝ P_x(f_x) P_y(f_y), from the mean spectra of the exemplar's rows and of its
    columns: less noisy, if the covariance is such a product (Dong et al. 2015, section 9). Channels go
    together a little less in it: a correlation of 0.77 came out as 0.71.

    With `marginals` each channel also has the exemplar's distribution of values: what is synthesised are
    normal scores, Φ^{−1} of their ranks, which go back through the exemplar's quantiles.

    Raises ValueError for a shape that is not two positive whole numbers, an exemplar of another shape,
    infinite values, and a channel of fewer than two known ones.
    """
    image = _channels(exemplar, 2, "the exemplar, (h, w) or (h, w, C),")
    size = _whole(shape, image.shape[1:])
    if marginals:
        scores = _from_image(key, _normal_scores(image), size, separable, correlated, standard=True)
        texture = _from_scores(scores, image)
    else:
        texture = _from_image(key, image, size, separable, correlated)
    return _cut(texture, shape, jnp.ndim(exemplar) == 3)


@partial(jax.jit, static_argnames="size")
def _from_strips(
    key: Array, x: Float[Array, "C n"], y: Float[Array, "C k"], size: tuple[int, int]
) -> Float[Array, "C H W"]:
    amplitude = _outer(_strip_power(x, size[1]), _strip_power(y, size[0]), size[0])
    means, variances = (jnp.stack(of_both) for of_both in zip(_moments(x), _moments(y), strict=True))
    total = jnp.sum(variances, axis=0)
    share = jnp.where(total > 0, safe_divide(variances[0], total), 0.5)
    mean, variance = (b + share * (a - b) for a, b in (means, variances))
    return _field(amplitude * _random_phases(key, (len(x), *size), x.dtype), size[1], mean, variance)


@partial(jax.jit, static_argnames=("size", "separable", "correlated", "standard"))
def _from_image(
    key: Array,
    image: Float[Array, "C h w"],
    size: tuple[int, int],
    separable: bool,
    correlated: bool,
    standard: bool = False,
) -> Float[Array, "C H W"]:
    """The texture, of the image's mean and variance, or of the `standard` ones 0 and 1."""
    spectrum = jnp.fft.rfft2(_deviations(image), size)
    if separable:
        amplitude = _outer(_power(image, size[1]), _power(jnp.swapaxes(image, 1, 2), size[0]), size[0])
        spectrum = amplitude * jnp.exp(1j * jnp.angle(spectrum))
    mean, variance = _moments(image)
    if standard:
        mean, variance = jnp.zeros_like(mean), jnp.ones_like(variance)
    phases = _random_phases(key, (1 if correlated else len(image), *size), image.dtype)
    return _field(spectrum * phases, size[1], mean, variance)


def _channels(exemplar: ArrayLike, rank: int, name: str) -> Float[Array, "C ..."]:
    """An exemplar with its channels first, checked: its shape always, values where they are at hand."""
    array = floats(exemplar)
    if array.ndim not in (rank, rank + 1) or array.size == 0:
        raise ValueError(f"texture: {name} must not be empty or of another rank; found shape {array.shape}")
    array = jnp.moveaxis(array, -1, 0) if array.ndim > rank else array[None]
    if isinstance(array, jax.core.Tracer):
        return array
    values = np.asarray(array)
    if np.any(np.isinf(values)):
        raise ValueError(f"texture: {name} must hold finite values, or NaN where they are unknown")
    fewest = np.min(np.sum(~np.isnan(values), axis=_positions(array)))
    if fewest < 2:
        raise ValueError(
            f"texture: {name} must have two known values or more in each channel; found {fewest}"
        )
    return array


def _whole(shape: tuple[int, ...], exemplar: tuple[int, ...]) -> tuple[int, int]:
    """The size to synthesise at: what is asked for, but no smaller than the exemplar."""
    if len(shape) != 2 or not all(isinstance(n, int | np.integer) and n > 0 for n in shape):
        raise ValueError(f"texture: the shape must be two positive whole numbers (H, W); found {shape}")
    return max(shape[0], exemplar[0]), max(shape[1], exemplar[1])


def _cut(texture: Float[Array, "C H W"], shape: tuple[int, ...], channels: bool) -> Float[Array, "..."]:
    """The part that was asked for, its channels last, or without that axis."""
    part = texture[:, : shape[0], : shape[1]]
    return jnp.moveaxis(part, 0, -1) if channels else part[0]


def _field(
    spectrum: Complex[Array, "C H f"], columns: int, mean: Float[Array, " C"], variance: Float[Array, " C"]
) -> Float[Array, "C H W"]:
    """The field of a spectrum that is known up to a factor: of this mean and variance."""
    z = jnp.fft.irfft2(spectrum.at[:, 0, 0].set(0), (spectrum.shape[1], columns))
    scale = safe_sqrt(safe_divide(variance, jnp.mean(z * z, axis=(1, 2))))
    return mean[:, None, None] + scale[:, None, None] * z


def _random_phases(key: Array, shape: tuple[int, int, int], dtype) -> Complex[Array, "C H f"]:
    """e^{iφ}, independent and evenly distributed, as a real field has them: those of white noise."""
    noise = jnp.fft.rfft2(jax.random.normal(key, shape, dtype))
    return noise / jnp.abs(noise)


def _outer(
    power_x: Float[Array, "C f"], power_y: Float[Array, "C g"], rows: int
) -> Float[Array, "C {rows} f"]:
    """√(P_x P_y), the amplitude of a separable spectrum; along y at negative frequencies too."""
    folded = np.minimum(np.arange(rows), rows - np.arange(rows))
    return safe_sqrt(power_y)[:, folded, None] * safe_sqrt(power_x)[:, None, :]


def _power(values: Float[Array, "C ... n"], size: int) -> Float[Array, "C f"]:
    """The mean power spectrum along the last axis, at the frequencies of a row of `size` values.

    Zeros are added to it, which interpolates the spectrum exactly.
    """
    power = jnp.abs(jnp.fft.rfft(_deviations(values), size)) ** 2
    return jnp.mean(power, axis=tuple(range(1, power.ndim - 1)))


def _strip_power(strip: Float[Array, "C n"], size: int) -> Float[Array, "C f"]:
    r"""The power spectrum of a single strip, without the gap that its mean leaves around frequency 0.

    Taking off the mean takes all power at 0, and much of it up to 1/n, where a brushed surface has most along
    the scratches: a product of two spectra would be 0 on both axes, so that all rows of the texture had one
    mean, and all columns. So up to 1/n the spectrum is what it is there.
    """
    power, frequencies = _power(strip, size), np.arange(size // 2 + 1)
    first_resolved = min(-(-size // strip.shape[1]), size // 2)
    return power[:, np.maximum(frequencies, first_resolved)]


def _deviations(values: Float[Array, "C ..."]) -> Float[Array, "C ..."]:
    """Values less their mean, fading out towards the edges; 0 where they are unknown.

    An edge is a step to what lies beyond, as large as the values differ, and steps have a spectrum of their
    own, ∝ 1 / f², which would roughen smooth textures. Of strips of 100 values of the correlation
    exp(−(x/20)²) squared differences between neighbours became eight times too large; of strips that fade,
    twice.
    """
    above, _ = _above_lowest(values)
    weight, positions = _taper(values) * _known(values), _positions(values)
    total = jnp.sum(weight, positions, keepdims=True)
    return weight * (above - jnp.sum(weight * above, positions, keepdims=True) / total)


def _taper(values: Float[Array, "C ..."]) -> Float[Array, "C ..."]:
    """sin² from 0 just outside to 1 at an eighth of the length, along each axis of positions (Tukey 1967)."""
    weight = jnp.ones(values.shape, values.dtype)
    for axis in _positions(values):
        x = np.arange(1, values.shape[axis] + 1) / (values.shape[axis] + 1)
        fade = np.sin(np.pi / 2 * np.minimum(np.minimum(x, 1 - x) / _TAPERED, 1)) ** 2
        others = [k for k in range(values.ndim) if k != axis]
        weight = weight * jnp.asarray(np.expand_dims(fade, others), values.dtype)
    return weight


def _moments(values: Float[Array, "C ..."]) -> tuple[Float[Array, " C"], Float[Array, " C"]]:
    """Mean and variance of each channel's known values."""
    above, lowest = _above_lowest(values)
    known, count = _known(values), jnp.sum(_known(values), _positions(values), keepdims=True)
    mean = jnp.sum(above, _positions(values), keepdims=True) / count
    variance = jnp.sum(jnp.where(known, above - mean, 0) ** 2, _positions(values)) / count.reshape(-1)
    return (lowest + mean).reshape(-1), variance


def _above_lowest(values: Float[Array, "C ..."]) -> tuple[Float[Array, "C ..."], Float[Array, "C ..."]]:
    """Values less the lowest of their channel, 0 where unknown, and that one: equal ones are then all 0."""
    lowest = jnp.nanmin(values, _positions(values), keepdims=True)
    return jnp.where(_known(values), values - lowest, 0), lowest


@jax.jit
def _normal_scores(values: Float[Array, "C h w"]) -> Float[Array, "C h w"]:
    """Φ^{−1}(rank − ½ of the number of known ones); equal values share the mean of their ranks."""

    def of_channel(v):
        ordered, known = jnp.sort(v), _known(v)
        below, up_to = (jnp.searchsorted(ordered, v, side) for side in ("left", "right"))
        share = (below + up_to) / (2 * jnp.sum(known))
        return jnp.where(known, ndtri(share.astype(v.dtype)), jnp.nan)

    return jax.vmap(of_channel)(values.reshape(len(values), -1)).reshape(values.shape)


@jax.jit
def _from_scores(scores: Float[Array, "C H W"], values: Float[Array, "C h w"]) -> Float[Array, "C H W"]:
    """The quantiles Φ(score) of each channel's known values, linear between them."""

    def of_channel(z, v):
        last = jnp.sum(_known(v)) - 1
        position = jnp.clip(ndtr(z) * (last + 1) - 0.5, 0, last)
        lower = position.astype(int)
        ordered = jnp.sort(v)
        low, high = ordered[lower], ordered[jnp.minimum(lower + 1, last)]
        return low + (position - lower) * (high - low)

    return jax.vmap(of_channel)(scores, values.reshape(len(values), -1))


def _known(values: Float[Array, "..."]) -> Bool[Array, "..."]:
    return ~jnp.isnan(values)


def _positions(values: Float[Array, "C ..."]) -> tuple[int, ...]:
    """The axes but the first, that of channels."""
    return tuple(range(1, values.ndim))
