r"""Planes fitted to a height map around each of its points, weighed by a Gaussian of the distance.

    min Σ c w (z − p − q u − r v)²,   w = exp(−(u² + v²) / 2σ²)

over all points, (u, v) away from the one looked at; c is 1 where a height was measured, 0 where not. The
weight is a product of a function of u and one of v, so that every sum is a product with a banded matrix from
the right and one from the left. The bands end with the map: its border needs no care.
"""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbrdf.special import safe_divide
from jaxbrdf.surface.heightfield import Heightfield

REACH = 6.5  # sigmas: what is farther weighs less than 1e-9
_BLOCK = 64  # columns that are multiplied in one product
_SINGULAR = 1e-3  # a determinant of the weights' covariance, in units of σ⁴, that float32 cannot divide by


def default_sigma(heightfield: Heightfield) -> float:
    """1 µm as in Dong et al. 2015, section 5, or 1.5 pixels where these are coarser."""
    return max(1.0, 1.5 * max(heightfield.dx, heightfield.dy))


def checked_sigma(heightfield: Heightfield, sigma: float | None) -> float:
    """`sigma` or the default one. Raises ValueError for less than a pixel: there is nothing to average."""
    if sigma is None:
        return default_sigma(heightfield)
    pixel = max(heightfield.dx, heightfield.dy)
    if not sigma >= pixel:
        raise ValueError(f"sigma must be at least the larger pixel size, {pixel:g} µm; found {sigma:g} µm")
    return float(sigma)


def plane_slopes(
    heightfield: Heightfield, sigma: float
) -> tuple[Float[Array, "ny nx"], Float[Array, "ny nx"]]:
    """(q, r) at every pixel, measured or not; NaN where the weights of the points around do not spread
    enough to hold a plane: too few, or too nearly in a line."""
    # The slopes of one plane through everything are added again: what is left keeps its digits in float32.
    z, (a, b) = _without_plane(heightfield)
    pixels = sigma / heightfield.dx, sigma / heightfield.dy
    if heightfield.mask is None:
        q, r = _complete(z, pixels)
        return q / sigma + a, r / sigma + b
    q, r, known = _partial(z, heightfield.valid, pixels)
    # NaN comes last: added to a and b, it would spread to the gradients of all pixels.
    return jnp.where(known, q / sigma + a, jnp.nan), jnp.where(known, r / sigma + b, jnp.nan)


def _complete(z: Float[Array, "ny nx"], pixels: tuple[float, float]):
    """Where nothing is missing u and v are uncorrelated: q is the mean over v of slopes along u."""
    x, y = pixels
    return _along_y(_along_x(z, "slope", x), "mean", y), _along_y(_along_x(z, "mean", x), "slope", y)


def _partial(z: Float[Array, "ny nx"], valid: Bool[Array, "ny nx"], pixels: tuple[float, float]):
    """The normal equations of each point, solved for the slopes, and where they could be."""
    c_u = {power: _along_x(valid.astype(z.dtype), power, pixels[0]) for power in ("1", "u", "u²")}
    z_u = {power: _along_x(z, power, pixels[0]) for power in ("1", "u")}

    def sums(rows, power):
        return _along_y(rows, power, pixels[1])

    weight = sums(c_u["1"], "1")
    u, v, height = (
        safe_divide(sums(*moment), weight) for moment in ((c_u["u"], "1"), (c_u["1"], "u"), (z_u["1"], "1"))
    )
    uu = safe_divide(sums(c_u["u²"], "1"), weight) - u**2
    uv = safe_divide(sums(c_u["u"], "u"), weight) - u * v
    vv = safe_divide(sums(c_u["1"], "u²"), weight) - v**2
    uz = safe_divide(sums(z_u["u"], "1"), weight) - u * height
    vz = safe_divide(sums(z_u["1"], "u"), weight) - v * height
    det = uu * vv - uv**2
    known = det > _SINGULAR
    q, r = (safe_divide(top, jnp.where(known, det, 0)) for top in (uz * vv - vz * uv, vz * uu - uz * uv))
    return q, r, known


def _without_plane(heightfield: Heightfield):
    """Heights less a plane that most of their slope is in, 0 where they are missing, and its slopes."""
    z, valid = heightfield.heights, heightfield.valid.astype(heightfield.z.dtype)
    x, y = (
        jnp.asarray(size * (np.arange(n) - (n - 1) / 2), z.dtype)
        for size, n in zip((heightfield.dx, heightfield.dy), z.shape[::-1], strict=True)
    )
    level = (z - jnp.sum(z) / jnp.sum(valid)) * valid
    a = safe_divide(jnp.sum(level, axis=0) @ x, jnp.sum(valid, axis=0) @ x**2)
    b = safe_divide(jnp.sum(level, axis=1) @ y, jnp.sum(valid, axis=1) @ y**2)
    return level - (a * x[None, :] + b * y[:, None]) * valid, (a, b)


# Products with banded matrices


def _along_x(a: Float[Array, "ny nx"], kernel: str, pixels: float) -> Float[Array, "ny nx"]:
    """Each row times a banded matrix, as many columns at once as share a block; σ is so many pixels."""
    blocks = _bands(kernel, a.shape[1], pixels)
    products = [a[:, at : at + len(block)] @ jnp.asarray(block, a.dtype) for at, block in blocks]
    return jnp.concatenate(products, axis=1)


def _along_y(a: Float[Array, "ny nx"], kernel: str, pixels: float) -> Float[Array, "ny nx"]:
    """The same for each column, from the left: that is faster than two transpositions."""
    blocks = _bands(kernel, a.shape[0], pixels)
    products = [jnp.asarray(block.T, a.dtype) @ a[at : at + len(block)] for at, block in blocks]
    return jnp.concatenate(products, axis=0)


@lru_cache(maxsize=64)
def _bands(kernel: str, n: int, pixels: float) -> list[tuple[int, np.ndarray]]:
    """A matrix (n, n) whose column j sums over the points k around j, in blocks of columns: of each the first
    row that is not 0, and the rows from there."""
    reach, blocks = int(np.ceil(REACH * pixels)), []
    for first in range(0, n, _BLOCK):
        columns = np.arange(first, min(n, first + _BLOCK))
        rows = np.arange(max(0, first - reach), min(n, columns[-1] + 1 + reach))
        u = (rows[:, None] - columns[None, :]) / pixels
        w = np.exp(-(u**2) / 2) * (np.abs(u) <= REACH)
        blocks.append((int(rows[0]), _KERNELS[kernel](w, u)))
    return blocks


def _slope(w: np.ndarray, u: np.ndarray) -> np.ndarray:
    """What makes of heights the slope of the line through them, u in units of σ."""
    offset = u - np.sum(w * u, axis=0) / np.sum(w, axis=0)
    return w * offset / np.sum(w * offset**2, axis=0)


_KERNELS = {
    "1": lambda w, u: w,
    "u": lambda w, u: w * u,
    "u²": lambda w, u: w * u**2,
    "mean": lambda w, u: w / np.sum(w, axis=0),
    "slope": _slope,
}
