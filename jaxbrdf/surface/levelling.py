"""What is taken off a height map before its normals mean anything: its tilt or form, and wrong heights."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.ndimage import distance_transform_edt, percentile_filter

from jaxbrdf.surface.heightfield import Heightfield

_POWERS = {1: ((0, 0), (0, 1), (1, 0)), 2: ((0, 0), (0, 1), (1, 0), (0, 2), (1, 1), (2, 0))}


def levelled(heightfield: Heightfield, degree: int = 1) -> Heightfield:
    """The map less its least-squares plane (`degree` 1) or quadratic (2) through the measured heights.

    Differentiable by the heights. Raises ValueError for another degree.
    """
    if degree not in _POWERS:
        raise ValueError(f"levelled takes off a plane (degree 1) or a quadratic (2); found degree {degree}")
    y, x = (np.linspace(-1, 1, n) for n in heightfield.z.shape)
    basis = np.stack([np.outer(y**i, x**j) for i, j in _POWERS[degree]])
    surface = _nearest(jnp.asarray(basis, heightfield.z.dtype), heightfield)
    return dataclasses.replace(heightfield, z=heightfield.heights - surface)


def _nearest(basis: Float[Array, "k ny nx"], heightfield: Heightfield) -> Float[Array, "ny nx"]:
    """The combination of some surfaces that is nearest to the measured heights."""
    known = basis * heightfield.valid[None]
    gram = jnp.einsum("aij,bij->ab", known, known)
    coefficients = jnp.linalg.pinv(gram) @ jnp.einsum("aij,ij->a", known, heightfield.heights)
    return jnp.einsum("a,aij->ij", coefficients, basis)


def without_outliers(heightfield: Heightfield, threshold: float = 6.0, window: int = 5) -> Heightfield:
    """The map with single wrong heights masked out: spikes that stand out from their neighbourhood.

    Left out are heights that, a plane being taken off, are farther from the median of the `window` × `window`
    pixels around than `threshold` times the spread there, missing pixels being filled from next to them. The
    spread is 0.741 times the distance between the quartiles in the window (of a normal distribution the
    standard deviation), or its mean over the map where that is more: it holds the relief as well as the
    noise, so that a smooth map, or one in steps, stays whole. Dong et al. 2015 leave all heights in.
    Raises ValueError unless threshold > 0 and window is odd and at least 3.
    """
    if not threshold > 0 or window < 3 or window % 2 == 0:
        raise ValueError(
            "without_outliers: expected a threshold greater than 0 and an odd window of at least 3; found "
            f"{threshold} and {window}"
        )
    valid, z = np.asarray(heightfield.valid), np.asarray(levelled(heightfield).heights)
    nearest = distance_transform_edt(~valid, return_distances=False, return_indices=True)
    filled = z[tuple(nearest)]
    low, median, high = (percentile_filter(filled, p, window, mode="nearest") for p in (25, 50, 75))
    spread = 0.741 * (high - low)
    largest = threshold * np.maximum(spread, np.mean(spread[valid]))
    return dataclasses.replace(heightfield, mask=valid & (np.abs(filled - median) <= largest))
