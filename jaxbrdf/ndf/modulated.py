"""A distribution modulated by an image: highlights of any shape."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.arrays import NON_NEGATIVE, parameter
from jaxbrdf.directions import Direction
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.tabulated import TabulatedNDF, disk_cells

_SIDE = 257  # of the table by which integrals are done
_CELL = (2 / _SIDE) ** 2


class Modulated(AbstractNDF):
    r"""Another distribution times an image of the disk of normals: Ashikhmin's unusual highlights.

        D(m) = D_0(m) I(m_x, m_y) / ⟨I⟩,   ⟨I⟩ = ∫ D_0 I (m·n) dm

    Ashikhmin et al. 2000, section 6.5 and Fig. 1. `image` (N, N), or (N, N, C), ≥ 0 and not all 0, lies on
    the disk as a tabulated distribution does: image[i, j] at m_x = (2j+1)/N − 1, m_y = (2i+1)/N − 1, linear
    in between. What is not symmetric shifts the mean normal; energy is then not guaranteed.

    ⟨I⟩, σ and the samples are those of a `TabulatedNDF` with N = 257: for Gaussians of width 0.1 or more and
    a smooth image to 2e-6, of width 0.05 to 1e-4, 0.02 to 3e-3; for `Velvet`, steepest at the horizon, to
    3e-2. Only what D_0 has above the horizon counts. Raises ValueError for an image of another shape,
    negative or black.
    """

    ndf: AbstractNDF
    image: Float[Array, "N N *channels"] = parameter(rank=2, domain=NON_NEGATIVE)

    def __check_init__(self):
        if self.image.ndim < 2 or self.image.shape[0] != self.image.shape[1]:
            raise ValueError(
                f"Modulated: image must have shape (N, N) or (N, N, C); found {self.image.shape}"
            )
        if not isinstance(self.image, jax.core.Tracer) and not np.any(self.image):
            raise ValueError("Modulated: image must not be black; found no value greater than 0")

    @property
    def is_isotropic(self) -> bool:
        return False

    def _density(self, m: Direction) -> Float[Array, "..."]:
        return self.ndf(m) * self._brightness(m) / self._mean_brightness()

    def _projected_area(self, w: Direction) -> Float[Array, "..."]:
        return self._table().projected_area(w)

    def _sample(self, u: Float[Array, "... 2"]) -> Direction:
        return self._table().sample(u)

    def _table(self) -> TabulatedNDF:
        """The distribution as a table, normalised."""
        product = self._product()
        return TabulatedNDF(product / (jnp.sum(product) * _CELL))

    def _mean_brightness(self) -> Float[Array, ""]:
        return jnp.sum(self._product()) * _CELL

    def _product(self) -> Float[Array, "M M"]:
        """D_0 I at the centres of a table's cells, 0 outside the disk."""
        m = disk_cells(_SIDE)
        normals = jnp.asarray(np.moveaxis(np.where(m[2] > 0, m, 0), 0, -1), self.image.dtype)
        return self.ndf._density(normals) * self._brightness(normals)

    def _brightness(self, m: Direction) -> Float[Array, "..."]:
        """The image at a normal; beyond the outermost pixels' centres, the nearest pixel."""
        n = self.image.shape[0]
        column, row = ((m[..., k] + 1) * (n / 2) - 0.5 for k in (0, 1))
        return jax.scipy.ndimage.map_coordinates(self.image, [row, column], order=1, mode="nearest")
