"""A distribution whose projected area is looked up in a table instead of integrated."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.arrays import parameter, per_channel
from jaxbrdf.directions import Direction, cos_theta
from jaxbrdf.ndf.base import AbstractIsotropicNDF, AbstractNDF
from jaxbrdf.special import safe_sqrt

_SMALLEST = 1e-5  # cosine below which the nodes are evenly spaced; above it, evenly in its logarithm


class TabulatedArea(AbstractNDF):
    """An isotropic distribution with its projected area tabulated; made by `tabulate_projected_area`."""

    ndf: AbstractNDF
    area: Float[Array, "N *channels"] = parameter(rank=1)
    slope: Float[Array, "N *channels"] = parameter(rank=1)

    @per_channel
    def __call__(self, m: Direction) -> Float[Array, "..."]:
        return self.ndf(m)

    @per_channel
    def projected_area(self, w: Direction) -> Float[Array, "..."]:
        """σ(w) by cubic Hermite interpolation in arsinh(|cos θ| / 1e-5); σ(−w) = σ(w) − w·n below the horizon."""
        cos_w = cos_theta(w)
        c = jnp.abs(cos_w)
        n = self.area.shape[0]
        position = jnp.arcsinh(c / _SMALLEST) / jnp.arcsinh(1 / _SMALLEST) * (n - 1)
        j = jnp.clip(position.astype(int), 0, n - 2)
        nodes = jnp.asarray(_nodes(n), self.area.dtype)
        step = nodes[j + 1] - nodes[j]
        t = (c - nodes[j]) / step
        rise = self.area[j + 1] - self.area[j]
        bend_0, bend_1 = step * self.slope[j] - rise, rise - step * self.slope[j + 1]
        sigma = self.area[j] + t * rise + t * (1 - t) * ((1 - t) * bend_0 + t * bend_1)
        return sigma + jnp.minimum(cos_w, 0)

    @per_channel
    def sample(self, u: Float[Array, "... 2"]) -> Float[Array, "..."]:
        return self.ndf.sample(u)


def tabulate_projected_area(ndf: AbstractIsotropicNDF, nodes: int = 256) -> TabulatedArea:
    """The same distribution with σ(w) tabulated at `nodes` polar angles, for evaluation at many directions.

    The nodes crowd at grazing angles, where σ bends. Measured for the shifted gamma distribution over
    alpha in [1e-5, 1] and p in [0, 2]: relative error of σ below 1e-7 with 256 nodes. Raises ValueError
    for a distribution that is not isotropic.
    """
    if not isinstance(ndf, AbstractIsotropicNDF):
        raise ValueError(
            f"tabulate_projected_area takes an isotropic distribution, not {type(ndf).__name__}: its projected "
            "area depends on the azimuth; evaluate ndf.projected_area itself"
        )
    area, slope = _area_and_slope(ndf, _nodes(nodes))
    return TabulatedArea(ndf, area, slope)


def _area_and_slope(ndf: AbstractIsotropicNDF, cos_w: np.ndarray) -> tuple[Array, Array]:
    """σ and dσ/dcos θ at each cosine, (N,) or (N, C)."""

    def area(c):
        return ndf.projected_area(jnp.stack([safe_sqrt(1 - c**2), jnp.zeros_like(c), c], axis=-1))

    c = jnp.asarray(cos_w)
    return jax.jvp(area, (c,), (jnp.ones_like(c),))


def _nodes(n: int) -> np.ndarray:
    return _SMALLEST * np.sinh(np.linspace(0, np.arcsinh(1 / _SMALLEST), n))
