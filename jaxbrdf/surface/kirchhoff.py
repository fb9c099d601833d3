r"""The Kirchhoff distribution D_K of a height map: its normals as light of one wavelength sees them.

    D_K(q) = |F(q)|² / (4π² A),   F(q) = ∫ (q·m) e^{−i q·s} ds,   q = 4π h / λ_q

Dong, Walter, Marschner & Greenberg 2015, eq. 6, with λ_q = λ / cos θ_d. A map is made of the squares between
neighbouring points, each of which counts by its midpoint: the mean z of its corners and the slopes z_x, z_y
of the plane through them, so that (q·m) ds = (q_z − q_x z_x − q_y z_y) dx dy. Every measured point counts and
none is invented at the border; where a facet mirrors the light, which is where F comes from, its phase is the
same all over, and the midpoint exact.

The sum over squares is a separable Fourier transform in (x, y), but for the term q_z z of the phase. As a
function of q_z alone F is smooth: it is interpolated between a few Chebyshev nodes, at each of which it is
two matrix products.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Complex, Float
from scipy.special import jv

from jaxbrdf.brdf.kirchhoff import KirchhoffBRDF
from jaxbrdf.fresnel import AbstractFresnel
from jaxbrdf.ndf.tabulated import TabulatedNDF
from jaxbrdf.shadowing import AbstractShadowing, Uncorrelated
from jaxbrdf.surface.facets import facets
from jaxbrdf.surface.heightfield import Heightfield

COHERENT_PATCH = 70.0  # µm: Dong et al. 2015, appendix A, near the coherence area of sunlight

Progress = Callable[[int, int], None]  # called with how many patches are done, and of how many


def kirchhoff_ndf(
    heightfield: Heightfield,
    wavelength: float,
    patch: float | None = None,
    size: int = 1025,
    max_angle: float | None = None,
    relief: float | None = None,
    progress: Progress | None = None,
) -> TabulatedNDF:
    r"""D_K of a height map at the effective wavelength λ_q, a table of size × size cells, 1/sr.

    The values are those of the formula at the cells' centres, in the precision of the heights: float32 gives
    |F| to 1e-6 of its largest value. Nothing is levelled and nothing renormalised: Σ D dA is near 1 for a
    rough surface whose facets lie in the table. That reaches to `max_angle` (radians) from the normal and is
    0 beyond: by default over the whole disk, or as far as the pixels resolve it, `resolved_angle`.

    Light is coherent within a `patch`: a larger map is cut, see `coherent_patches`, and D_K is the mean of
    its patches', weighted by area; 70 µm unless said otherwise, math.inf for one patch. The speckle of a
    patch L wide is λ_q / (2L) wide on the disk: finer than a cell where L > size · λ_q / 4. Squares with a
    missing corner are left out.

    Differentiable in the heights. Inside jit, where heights are not known, give `relief`: those of one patch
    differ by no more. `progress` is called after each patch, outside jit. Lengths are in micrometres. Raises
    ValueError for a wavelength that is not positive, is below the pixel size or does not resolve `max_angle`,
    and for a map without four measured neighbours. Dong et al. 2015, eq. 6 and appendix A.
    """
    if size < 1:
        raise ValueError(f"size must be at least 1; found {size}")
    angle = _reach(heightfield, wavelength, max_angle)
    parts = coherent_patches(heightfield, COHERENT_PATCH if patch is None else patch)
    depth = max(map(_depth, parts)) if relief is None else relief / 2
    plan = _plan(parts[0], wavelength, size, angle, depth)
    power, area = jnp.zeros_like(plan.t), jnp.zeros((), plan.t.dtype)
    for done, part in enumerate(parts, 1):
        squares = _squares(part)
        power, area = power + _power(squares, plan), area + jnp.sum(squares.area)
        if progress is not None:
            jax.block_until_ready(power)
            progress(done, len(parts))
    if not isinstance(area, jax.core.Tracer) and area == 0:
        raise ValueError("kirchhoff_ndf: nowhere were four neighbouring points measured; fill some holes")
    D = jnp.where(plan.inside, power / (4 * math.pi**2 * area), 0)
    return TabulatedNDF(jnp.pad(D.T, (size - len(D)) // 2))


def kirchhoff_brdf(
    heightfield: Heightfield,
    wavelengths: ArrayLike | Sequence[float],
    fresnel: AbstractFresnel,
    tables: int = 3,
    max_difference: float = math.pi / 3,
    shadowing: AbstractShadowing = Uncorrelated(),  # noqa: B008
    **options: Any,
) -> KirchhoffBRDF:
    r"""The reflectance of a height map by Kirchhoff's theory, at `wavelengths` (µm), () or one a channel.

    D_K is tabulated at `tables` effective wavelengths λ_q = λ / cos θ_d, evenly in 1/λ_q, from that of the
    shortest wavelength at θ_d = 0 to that of the longest at `max_difference`; beyond, the last table counts.
    It hardly changes with λ_q (Dong et al. 2015, figure 6), so few will do. `options` are those of
    `kirchhoff_ndf`. Raises ValueError as that does.
    """
    λ = np.asarray(wavelengths, float)
    resolved_angle(heightfield, float(λ.min()))  # refuses what is not positive
    wavenumbers = np.linspace(1 / λ.min(), math.cos(max_difference) / λ.max(), tables)
    values = [kirchhoff_ndf(heightfield, float(1 / k), **options).values for k in wavenumbers]
    dtype = heightfield.z.dtype
    λ_q, channels = (jnp.asarray(a, dtype) for a in (1 / wavenumbers, λ))
    return KirchhoffBRDF(jnp.stack(values), λ_q, channels, fresnel, shadowing)


def resolved_angle(heightfield: Heightfield, wavelength: float) -> float:
    r"""How far from the normal pixels resolve D_K, in radians: sin θ = λ_q / (4 max(dx, dy)), at most π/2.

    There the phase q_x x turns by π from one pixel to the next; a direction beyond looks like one on the
    other side. Raises ValueError for a wavelength that is not positive.
    """
    if not (math.isfinite(wavelength) and wavelength > 0):
        raise ValueError(f"wavelength must be a length in micrometres greater than 0; found {wavelength}")
    return math.asin(min(1.0, wavelength / (4 * max(heightfield.dx, heightfield.dy))))


def coherent_patches(heightfield: Heightfield, size: float) -> list[Heightfield]:
    """A map cut into patches of `size` µm, all of one shape; those without any measured height are left out.

    As few as cover the map, evenly spread: neighbours share the points of their border, and overlap where the
    map is no multiple of them. A side shorter than `size` stays whole. Raises ValueError for a size below one
    pixel.
    """
    pixel = max(heightfield.dx, heightfield.dy)
    if not size >= pixel:
        raise ValueError(f"patch must be at least one pixel, {pixel:g} µm; found {size}")
    ny, nx = heightfield.z.shape
    rows, columns = _windows(ny, size / heightfield.dy), _windows(nx, size / heightfield.dx)
    pieces = [_cut(heightfield, row, column) for row in rows for column in columns]
    return [piece for piece in pieces if piece is not None]


def _windows(points: int, length: float) -> list[slice]:
    """Slices of length + 1 points, the first and the last at the ends: `length` is in pixels."""
    pixels = int(min(length * (1 + 1e-9), points - 1))
    count = math.ceil((points - 1) / pixels)
    starts = np.round(np.linspace(0, points - 1 - pixels, count)).astype(int)
    return [slice(start, start + pixels + 1) for start in starts.tolist()]


def _cut(heightfield: Heightfield, row: slice, column: slice) -> Heightfield | None:
    """A part of the map; None where it is known to hold no measured height."""
    mask: Any = heightfield.mask
    if mask is not None:
        mask = mask[row, column] if isinstance(mask, jax.core.Tracer) else np.asarray(mask)[row, column]
    if isinstance(mask, np.ndarray) and not mask.any():
        return None
    return Heightfield(heightfield.z[row, column], heightfield.dx, heightfield.dy, mask)


def _reach(heightfield: Heightfield, wavelength: float, max_angle: float | None) -> float:
    """The angle to which a table reaches. Raises ValueError where the pixels do not resolve so much."""
    resolved, pixel = resolved_angle(heightfield, wavelength), max(heightfield.dx, heightfield.dy)
    if max_angle is None:
        if wavelength < pixel:
            raise ValueError(
                f"a wavelength of {wavelength:g} µm is below the pixel size: pixels of {pixel:g} µm need at "
                f"least {pixel:g} µm, and {4 * pixel:g} µm for the whole disk. Choose a longer one, or a "
                f"max_angle of at most {resolved:.3g} radians"
            )
        return resolved
    if not 0 < max_angle <= math.pi / 2:
        raise ValueError(f"max_angle must lie in (0, π/2] radians; found {max_angle}")
    if max_angle > resolved * (1 + 1e-9):
        raise ValueError(
            f"pixels of {pixel:g} µm resolve a wavelength of {wavelength:g} µm to {resolved:.3g} radians "
            f"from the normal; max_angle is {max_angle:.3g}. Choose a smaller one, or a wavelength of at "
            f"least {4 * pixel * math.sin(max_angle):g} µm"
        )
    return max_angle


class _Squares(NamedTuple):
    """The squares between neighbouring points; an even number of them along x and along y."""

    area: Float[Array, "ny nx"]  # dx dy, or 0 where a corner is missing
    z: Float[Array, "ny nx"]  # from halfway between the lowest and the highest
    z_x: Float[Array, "ny nx"]
    z_y: Float[Array, "ny nx"]


@jax.jit
def _squares(heightfield: Heightfield) -> _Squares:
    of = facets(heightfield)
    centred = of.height - _halfway(of.height, of.known)
    area = jnp.full_like(centred, heightfield.dx * heightfield.dy)
    even = [(0, n % 2) for n in centred.shape]
    fields = area, centred, of.slope_x, of.slope_y
    return _Squares(*(jnp.pad(jnp.where(of.known, field, 0), even) for field in fields))


def _halfway(z: Float[Array, "ny nx"], valid: Bool[Array, "ny nx"]) -> Float[Array, ""]:
    """A height that changes the phase of F as a whole, and so nothing."""
    lowest, highest = jnp.min(z, initial=jnp.inf, where=valid), jnp.max(z, initial=-jnp.inf, where=valid)
    return jax.lax.stop_gradient(jnp.where(lowest <= highest, (lowest + highest) / 2, 0))


def _depth(heightfield: Heightfield) -> float:
    """The largest |z| of the squares. Raises ValueError where heights are not known."""
    z = jnp.max(jnp.abs(_squares(jax.lax.stop_gradient(heightfield)).z))
    if isinstance(z, jax.core.Tracer):
        raise ValueError(
            "kirchhoff_ndf: inside jit or vmap heights are not known: give relief, the largest difference of "
            "heights within a patch, in micrometres"
        )
    return float(z)


class _Axis(NamedTuple):
    """What the transform along x, or y, needs: all directions q, and half of them by half of the squares."""

    q: Float[Array, " k"]
    cos: Float[Array, "half_n half_k"]
    sin: Float[Array, "half_n half_k"]


class _Plan(NamedTuple):
    """All that does not depend on the heights; t runs over [−1, 1] as q_z does from its least to q."""

    x: _Axis
    y: _Axis
    t: Float[Array, "k k"]
    inside: Bool[Array, "k k"]
    nodes: tuple[Float[Array, " K"], Float[Array, " K"], Float[Array, " K"]]  # t, q_z, weight


def _plan(heightfield: Heightfield, wavelength: float, size: int, angle: float, depth: float) -> _Plan:
    """The square of cells around all within the angle, and Chebyshev nodes of the first kind for q_z."""
    q, dtype, (ny, nx) = 4 * math.pi / wavelength, heightfield.z.dtype, heightfield.z.shape
    centre = (2 * np.arange(size) + 1) / size - 1
    m = centre[np.abs(centre) <= math.sin(angle) + 1e-12]
    sin2 = m[:, None] ** 2 + m[None, :] ** 2
    inside = sin2 <= math.sin(angle) ** 2 + 1e-12
    middle, half = (1 + math.cos(angle)) / 2, (1 - math.cos(angle)) / 2
    t = np.where(inside, (np.sqrt(np.maximum(1 - sin2, 0)) - middle) / half, -1)
    k = np.arange(_node_count(q * half * depth, dtype))
    turn = np.pi * (k + 0.5) / len(k)
    nodes = np.cos(turn), q * (middle + half * np.cos(turn)), np.sin(turn) * (-1.0) ** k
    return _Plan(
        _axis(q * m, nx - 1, heightfield.dx, dtype),
        _axis(q * m, ny - 1, heightfield.dy, dtype),
        jnp.asarray(t, dtype),
        jnp.asarray(inside),
        jax.tree.map(lambda node: jnp.asarray(node, dtype), nodes),
    )


def _node_count(x: float, dtype: np.dtype) -> int:
    """How many nodes e^{−i x t} needs on [−1, 1]: its Chebyshev series has the coefficients 2 (−i)^n J_n(x).

    One more for the factor q_z, and a multiple of four, so that programs are few.
    """
    tolerance = max(float(jnp.finfo(dtype).eps), 1e-13)
    orders = np.arange(math.ceil(x), 2 * math.ceil(x) + 30)
    count = orders[np.argmax(np.abs(jv(orders, x)) < tolerance)] + 1
    return 4 * math.ceil(count / 4)


def _axis(q: np.ndarray, squares: int, step: float, dtype: np.dtype) -> _Axis:
    """For q ≥ 0 and the upper half of the squares, whose midpoints are measured from the middle of all."""
    half = (squares + 1) // 2
    phase = np.outer((np.arange(half) + 0.5) * step, q[len(q) // 2 :])
    return _Axis(*(jnp.asarray(a, dtype) for a in (q, np.cos(phase), np.sin(phase))))


@jax.jit
def _power(squares: _Squares, plan: _Plan) -> Float[Array, "k k"]:
    """|F|² at [x, y]: F = Σ_k s_k F(q_z,k) / Σ_k s_k with s_k = w_k / (t − t_k).

    Berrut & Trefethen 2004, eq. 4.2.
    """

    def shares(t, weight):
        gap = plan.t - t
        return weight / jnp.where(gap == 0, jnp.finfo(gap.dtype).eps ** 2, gap)

    @jax.checkpoint  # keeps nothing of a node for the gradient but the heights
    def term(squares, t, q_z, weight):
        return shares(t, weight) * _transform(squares, plan, q_z)

    def add(sums, node):
        t, q_z, weight = node
        return (sums[0] + term(squares, t, q_z, weight), sums[1] + shares(t, weight)), None

    zero = jnp.zeros_like(plan.t)
    (F, total), _ = jax.lax.scan(add, (jax.lax.complex(zero, zero), zero), plan.nodes)
    F = F / total
    return F.real**2 + F.imag**2


def _transform(squares: _Squares, plan: _Plan, q_z: Float[Array, ""]) -> Complex[Array, "k k"]:
    """F at one q_z and all (q_x, q_y), as if these were independent of it."""
    turn = q_z * squares.z
    wave = squares.area * jax.lax.complex(jnp.cos(turn), -jnp.sin(turn))
    flat, along_x, along_y = _fourier(jnp.stack([wave, wave * squares.z_x, wave * squares.z_y]), plan.x)
    both = jnp.stack([q_z * flat - plan.x.q[None] * along_x, along_y])
    rest, along_y = _fourier(both.swapaxes(1, 2), plan.y)
    return rest - plan.y.q[None] * along_y


def _fourier(c: Complex[Array, "f rows n"], axis: _Axis) -> Complex[Array, "f rows k"]:
    """Σ_j c_j e^{−i q x_j} over the last axis.

    The even part of c meets the cosines and the odd one the sines, and q and −q share both: a quarter of the
    arithmetic of a complex matrix.
    """
    n, k = c.shape[-1] // 2, len(axis.q) // 2
    lower, upper = c[..., n - 1 :: -1], c[..., n:]
    even, odd = _product(upper + lower, axis.cos), -1j * _product(upper - lower, axis.sin)
    return jnp.concatenate([(even - odd)[..., : -k - 1 : -1], even + odd], axis=-1)


def _product(c: Complex[Array, "f rows n"], matrix: Float[Array, "n k"]) -> Complex[Array, "f rows k"]:
    """c @ matrix without making the matrix complex; in full precision on all devices."""
    return jax.lax.complex(*(jnp.matmul(part, matrix, precision="highest") for part in (c.real, c.imag)))
