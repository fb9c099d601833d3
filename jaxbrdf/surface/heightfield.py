"""A measured height map: heights on a grid of pixels, some of which may be missing."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxbrdf.arrays import floats

Lengths = float | tuple[float, float]  # µm: of both axes, or (x, y)


def pair(lengths: Lengths) -> tuple[float, float]:
    """(x, y), of one number for both as well."""
    x, y = np.broadcast_to(lengths, 2)
    return float(x), float(y)


def _as_mask(mask: ArrayLike | None) -> Array | None:
    return None if mask is None else jnp.asarray(mask, bool)


class Heightfield(eqx.Module):
    r"""Heights z[i, j] at x = j · dx, y = i · dy, all in micrometres.

    `z` (ny, nx); `dx` and `dy` are plain numbers. `mask` (ny, nx) is True where a height was measured, None
    for everywhere; what z holds under a False is never used. A batch of maps is `jax.vmap` over `z`.
    Raises ValueError for a map that is not at least 2 × 2, a mask of another shape or one without any True, a
    pixel size that is not greater than 0, and, outside jit, for heights that are no numbers where the mask
    does not say that they are missing.
    """

    z: Float[Array, "..."] = eqx.field(converter=floats)
    dx: float = eqx.field(static=True, converter=float)
    dy: float = eqx.field(static=True, converter=float)
    mask: Bool[Array, "..."] | None = eqx.field(converter=_as_mask, default=None)

    def __check_init__(self):
        if self.z.ndim != 2 or min(self.z.shape) < 2:
            raise ValueError(
                f"Heightfield: z must have shape (ny, nx), both at least 2; found {self.z.shape}"
            )
        for name, size in (("dx", self.dx), ("dy", self.dy)):
            if not (np.isfinite(size) and size > 0):
                raise ValueError(
                    f"Heightfield: {name} must be a length in micrometres greater than 0; found {size}"
                )
        if self.mask is not None and self.mask.shape != self.z.shape:
            raise ValueError(
                f"Heightfield: the mask must have the shape of z, {self.z.shape}; found {self.mask.shape}"
            )
        if isinstance(self.z, jax.core.Tracer) or isinstance(self.mask, jax.core.Tracer):
            return
        valid = np.asarray(self.valid)
        if not valid.any():
            raise ValueError("Heightfield: no height was measured anywhere; the mask is False throughout")
        bad = int(np.sum(valid & ~np.isfinite(self.z)))
        if bad:
            raise ValueError(
                f"Heightfield: {bad} heights are NaN or infinite: say by the mask that they are missing"
            )

    @property
    def valid(self) -> Bool[Array, "ny nx"]:
        """Where a height was measured."""
        return jnp.ones(self.z.shape, bool) if self.mask is None else self.mask

    @property
    def heights(self) -> Float[Array, "ny nx"]:
        """z, and 0 where it is missing."""
        return self.z if self.mask is None else jnp.where(self.mask, self.z, 0)

    @property
    def size(self) -> tuple[float, float]:
        """The extents (ny · dy, nx · dx)."""
        return self.z.shape[0] * self.dy, self.z.shape[1] * self.dx
