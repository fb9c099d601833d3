"""A distribution of normals for each place of a surface: images of parameters, measured or synthesised."""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbrdf.arrays import Range, declared
from jaxbrdf.fit_result import FitResult, FitStatus
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.ellipsoid import Ellipsoid, aligned
from jaxbrdf.surface.patches import PatchNDFs
from jaxbrdf.surface.texture import synthesize_texture, texture_like


class NDFMap(eqx.Module):
    """Distributions side by side: `ndf` has leaves (H, W), row 0 at y = 0, `step` (x, y) µm apart.

    What was fitted to patches also has, of each, a FitStatus, the `cost` that the fit ended with, and how
    many normals were known in it, all (H, W); and the `size` of the patches, (x, y) µm, which overlap where
    it is more than the step. The parameters of a patch that could not be fitted are NaN. Raises ValueError
    where the images differ in shape.

    `Microfacet(map.ndf, fresnel, shadowing)` is what `SpatiallyVaryingBRDF` evaluates.
    """

    ndf: AbstractNDF
    step: tuple[float, float] = eqx.field(static=True)
    name: str = eqx.field(static=True, default="")
    size: tuple[float, float] = eqx.field(static=True, default=(0.0, 0.0))
    status: Int[Array | np.ndarray, "H W"] | None = None
    cost: Float[Array | np.ndarray, "H W"] | None = None
    counts: Int[Array | np.ndarray, "H W"] | None = None

    def __check_init__(self):
        images = [*jax.tree.leaves(self.ndf), self.status, self.cost, self.counts]
        shapes = {np.shape(image) for image in images if image is not None}
        if len(shapes) != 1 or len(next(iter(shapes))) != 2:
            raise ValueError(
                f"NDFMap: parameters must be images (H, W) of one shape; found {sorted(shapes)}: of a fit to "
                "patches `ndf_map` makes one"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        height, width = np.shape(jax.tree.leaves(self.ndf)[0])
        return height, width

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters."""
        paths, _ = jax.tree_util.tree_flatten_with_path(self.ndf)
        return tuple(jax.tree_util.keystr(path).lstrip(".") for path, _ in paths)

    @property
    def success(self) -> np.ndarray:
        """Whether each was fitted, or synthesised."""
        if self.status is None:
            return np.ones(self.shape, bool)
        return np.asarray(np.asarray(self.status) <= FitStatus.AT_BOUND)


def ndf_map(patches: PatchNDFs, result: FitResult, name: str = "") -> NDFMap:
    """What `fit_ndf_patches` found, as images."""
    images = [patches.image(np.asarray(part)) for part in (result.status, result.cost, patches.counts)]
    ndf = jax.tree.map(patches.image, result.model)
    return NDFMap(ndf, patches.stride, name, patches.size, *images)


def aligned_maps(maps: Sequence[NDFMap]) -> list[NDFMap]:
    """Maps of ellipsoids by those of their names whose θ_z is nearest to the orientation of all: `aligned`.

    Maps of other distributions are what they were.
    """
    if not all(isinstance(item.ndf, Ellipsoid) for item in maps):
        return list(maps)
    flat = [jax.tree.map(jnp.ravel, item.ndf) for item in maps]
    together = aligned(jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *flat))
    ends = np.cumsum([item.shape[0] * item.shape[1] for item in maps]).tolist()
    return [
        replace(item, ndf=_images(together, slice(start, end), item.shape))
        for item, start, end in zip(maps, [0, *ends], ends, strict=False)
    ]


def _images(ndf: Ellipsoid, at: slice, shape: tuple[int, int]) -> Ellipsoid:
    return jax.tree.map(lambda leaf: leaf[at].reshape(shape), ndf)


def ndf_texture(key: Array, exemplar: NDFMap, shape: tuple[int, int], **options: bool) -> NDFMap:
    """A map of `shape` (H, W), of any size, that varies as an exemplar does.

    See `texture_like` for `key` and `options` (separable, correlated, marginals). Parameters that are sought
    evenly in their logarithms, such as α, are synthesised as logarithms: they stay positive. Patches that
    were not fitted do not count.
    """
    texture = texture_like(key, _channels(exemplar), shape, **options)
    return NDFMap(_from_channels(exemplar.ndf, texture), exemplar.step)


def ndf_texture_of_strips(
    key: Array, along: Sequence[NDFMap], across: Sequence[NDFMap], shape: tuple[int, int]
) -> NDFMap:
    """The same from two strips of a surface, one along x and one along y, by `synthesize_texture`.

    Dong et al. 2015, section 9. Each is one map, or several in a row, whose patches are taken in order.
    """
    x, y = (jnp.concatenate([_row(part) for part in strip]) for strip in (along, across))
    step = along[0].step[0], across[0].step[1]
    return NDFMap(_from_channels(along[0].ndf, synthesize_texture(key, x, y, shape)), step)


def _row(strip: NDFMap) -> Float[Array, "n C"]:
    channels = _channels(strip)
    return channels.reshape(-1, channels.shape[-1])


def _channels(exemplar: NDFMap) -> Float[Array, "H W C"]:
    """The parameters as they are synthesised; NaN where they were not fitted."""
    images = [
        jnp.asarray(image) if pole is None else jnp.log(image - pole)
        for image, pole in zip(jax.tree.leaves(exemplar.ndf), _poles(exemplar.ndf), strict=True)
    ]
    return jnp.where(exemplar.success[..., None], jnp.stack(images, axis=-1), jnp.nan)


def _from_channels(ndf: AbstractNDF, channels: Float[Array, "H W C"]) -> AbstractNDF:
    images = [
        channels[..., k] if pole is None else pole + jnp.exp(channels[..., k])
        for k, pole in enumerate(_poles(ndf))
    ]
    return jax.tree.unflatten(jax.tree.structure(ndf), images)


def _poles(ndf: AbstractNDF) -> list[float | None]:
    """Of each leaf that is sought in logarithms, what is taken off before."""
    paths, _ = jax.tree_util.tree_flatten_with_path(ndf)
    ranges: list[Range | None] = [declared(ndf, path).get("fitted") for path, _ in paths]
    return [r.pole if isinstance(r, Range) and r.log else None for r in ranges]
