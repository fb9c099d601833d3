"""Reflectances that vary over a surface: any model whose parameters are images."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from jaxbrdf.arrays import floats, in_chunks, parameter_ranks
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.directions import as_directions

Texels = tuple[tuple[Int[Array, "..."], Int[Array, "..."]], Float[Array, "..."]]  # two neighbours, how far


class SpatiallyVaryingBRDF(eqx.Module):
    r"""f(u, v, wi, wo) in 1/sr: a model of the parameters that are found at (u, v).

        p(u, v) = Σ_ij B(W u − j − ½) B(H v − i − ½) p_ij,   B(t) = max(0, 1 − |t|)

    `brdf` is any reflectance, such as `Microfacet(Ellipsoid(*images), Conductor(eta, kappa))`. Parameters
    that vary have two axes of texels before their own: (H, W), or (H, W, C) with channels, or (H, W, N, N)
    of tables, over which their class was vmapped twice; the others are as usual. u runs along x, the columns,
    v along y, the rows, in repetitions of the texture: texel (i, j) is centred at u = (j + ½) / W and
    v = (i + ½) / H, and beyond [0, 1) the texture goes on as it begins. Numbers are interpolated as they
    stand, angles too; NaN makes NaN of all that is less than a texel away.

    Raises ValueError if nothing varies, or if images differ in their texels.
    """

    brdf: AbstractBRDF

    def __check_init__(self):
        sizes = {np.shape(leaf)[:2] for leaf, varies in self._parameters if varies}
        if len(sizes) != 1:
            raise ValueError(
                "SpatiallyVaryingBRDF: the parameters that vary must be images, (H, W) or (H, W, C), of one "
                f"height and width; found {' and '.join(map(str, sorted(sizes))) or 'none that varies'}"
            )

    def __call__(self, u: ArrayLike, v: ArrayLike, wi: ArrayLike, wo: ArrayLike) -> Float[Array, "..."]:
        """The reflectance at u, v (...) for directions (..., 3), which broadcast: (...), or (..., C).

        Differentiable by the images and by u and v. Memory is bounded, however many points there are.
        Raises ValueError for directions that are not unit vectors (outside jit).
        """
        wi, wo = as_directions(wi, "wi"), as_directions(wo, "wo")
        components = [w[..., k] for w in (wi, wo) for k in range(3)]
        # What a gradient needs of each point is computed again: to keep it took twice the time and memory.
        at_point = jax.checkpoint(lambda *point: self._at_point(*point))
        return in_chunks(at_point, floats(u), floats(v), *components)

    def at(self, u: ArrayLike, v: ArrayLike) -> AbstractBRDF:
        """The model at a point; for u, v (...), which broadcast, a batch of models, to be vmapped over.

        Every leaf of a batch has the leading shape of u and v, also those of parameters that do not vary.
        """
        u, v = jnp.broadcast_arrays(floats(u), floats(v))
        height, width = next(np.shape(leaf)[:2] for leaf, varies in self._parameters if varies)
        rows, columns = _neighbours(v, height), _neighbours(u, width)
        leaves = [
            _bilinear(leaf, rows, columns) if varies else jnp.broadcast_to(leaf, u.shape + np.shape(leaf))
            for leaf, varies in self._parameters
        ]
        return jax.tree.unflatten(jax.tree.structure(self.brdf), leaves)

    @property
    def _parameters(self) -> list[tuple[Array | np.ndarray, bool]]:
        """Each leaf of the model, and whether it is an image: has two axes more than was declared of it."""
        leaves = jax.tree.leaves(self.brdf)
        ranks = parameter_ranks(self.brdf)
        return [(leaf, np.ndim(leaf) >= rank + 2) for leaf, rank in zip(leaves, ranks, strict=True)]

    def _at_point(self, u, v, *components: Float[Array, ""]) -> Float[Array, "..."]:
        wi, wo = jnp.stack(components[:3]), jnp.stack(components[3:])
        return self.at(u, v)(wi, wo)


def _neighbours(x: Float[Array, "..."], count: int) -> Texels:
    """The two texels of a row of `count` between whose centres x lies, and how far beyond the first."""
    position = x * count - 0.5
    first = jnp.floor(position)
    index = first.astype(int)
    return (index % count, (index + 1) % count), position - first


def _bilinear(image: Array | np.ndarray, rows: Texels, columns: Texels) -> Float[Array, "..."]:
    """The image between texels, (...) or with the axes of a parameter's own."""
    (upper, lower), y = rows
    (left, right), x = columns
    image = jnp.asarray(image)
    own = (1,) * (image.ndim - 2)
    x, y = x.reshape(x.shape + own), y.reshape(y.shape + own)
    above = (1 - x) * image[upper, left] + x * image[upper, right]
    below = (1 - x) * image[lower, left] + x * image[lower, right]
    return (1 - y) * above + y * below
