"""Random surfaces whose heights are normally distributed, for truths and for trying things out."""

from collections.abc import Mapping
from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxbrdf.surface.heightfield import Heightfield, Lengths, pair

# Correlation against r² = (x/τ_x)² + (y/τ_y)².
_DECAYS: Mapping = MappingProxyType(
    {"gaussian": lambda r2: np.exp(-r2), "exponential": lambda r2: np.exp(-np.sqrt(r2))}
)


def gaussian_surface(
    key: Array, shape: tuple[int, int], dx: Lengths, rms: float, correlation: Lengths, decay: str = "gaussian"
) -> Heightfield:
    r"""A surface of normally distributed heights of correlation ⟨z z'⟩ = rms² C(r), periodic in both axes.

        C = exp(−r²)  ('gaussian')  or  exp(−r)  ('exponential'),   r² = (x/τ_x)² + (y/τ_y)²

    `shape` (ny, nx); `dx` is the pixel size, or (dx, dy), `rms` σ the standard deviation of heights and
    `correlation` τ, or (τ_x, τ_y) for a brushed surface; all in µm. With a Gaussian correlation the slopes
    along x have the standard deviation √2 σ/τ_x, and the normals are those of Beckmann(2σ/τ_x, 2σ/τ_y); Sun's
    smoothness is s = τ/σ (Sun et al. 2002). With an exponential one the slopes grow as pixels shrink. `key`
    is a `jax.random.key`.

    Raises ValueError for lengths that are not positive, another decay, a τ below two pixels, which the map
    does not resolve, and one above a quarter of the map, which it does not hold.
    """
    pixels, lengths = pair(dx), pair(correlation)
    _check(shape, pixels, lengths, rms, decay)
    x, y = (
        size * np.minimum(np.arange(n), n - np.arange(n)) / tau
        for size, n, tau in zip(pixels, shape[::-1], lengths, strict=True)
    )
    # What two points of a periodic surface share goes around both ways; the nearer one is all that counts.
    correlated = rms**2 * _DECAYS[decay](x[None, :] ** 2 + y[:, None] ** 2)
    power = np.maximum(np.fft.rfft2(correlated).real, 0)
    noise = jax.random.normal(key, shape, jnp.result_type(float))
    z = jnp.fft.irfft2(jnp.fft.rfft2(noise) * jnp.sqrt(jnp.asarray(power, noise.dtype)), shape)
    return Heightfield(z, *pixels)


def _check(shape, pixels, lengths, rms, decay) -> None:
    if decay not in _DECAYS:
        raise ValueError(f"gaussian_surface: decay is one of {', '.join(_DECAYS)}; found {decay!r}")
    if not min(*pixels, *lengths, rms) > 0:
        raise ValueError(
            "gaussian_surface: dx, rms and correlation must be lengths in µm greater than 0; found "
            f"{pixels}, {rms} and {lengths}"
        )
    for name, n, size, tau in zip("xy", shape[::-1], pixels, lengths, strict=True):
        if not 2 * size <= tau <= n * size / 4:
            raise ValueError(
                f"gaussian_surface: the correlation length along {name} must be between two pixels, "
                f"{2 * size:g} µm, and a quarter of the map, {n * size / 4:g} µm; found {tau:g}"
            )
