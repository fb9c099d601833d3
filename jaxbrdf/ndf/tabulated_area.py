"""A distribution whose projected area is looked up in a table instead of integrated."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.arrays import parameter, per_channel
from jaxbrdf.directions import Direction, cos_theta
from jaxbrdf.ndf.base import AbstractIsotropicNDF, AbstractNDF
from jaxbrdf.special import fold, safe_sqrt

_SMALLEST = 1e-5  # cosine below which the nodes are evenly spaced; above it, evenly in log tan(elevation / 2)


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
        """σ(w) by cubic Hermite interpolation in |cos θ|; σ(−w) = σ(w) − w·n below the horizon."""
        c, below = fold(cos_theta(w))
        n = self.area.shape[0]
        j = jnp.clip(polar_position(c, n).astype(int), 0, n - 2)
        nodes = jnp.asarray(polar_nodes(n), self.area.dtype)
        step = nodes[j + 1] - nodes[j]
        t = (c - nodes[j]) / step
        rise = self.area[j + 1] - self.area[j]
        bend_0, bend_1 = step * self.slope[j] - rise, rise - step * self.slope[j + 1]
        sigma = self.area[j] + t * rise + t * (1 - t) * ((1 - t) * bend_0 + t * bend_1)
        return sigma + below

    @per_channel
    def sample(self, u: Float[Array, "... 2"]) -> Float[Array, "..."]:
        return self.ndf.sample(u)


def tabulate_projected_area(ndf: AbstractNDF, nodes: int = 288) -> TabulatedArea:
    """The same distribution with σ(w) tabulated at `nodes` polar angles, for evaluation at many directions.

    The nodes crowd at grazing angles, where sharp lobes are masked, and are at most 2.6° apart elsewhere.
    Measured for the shifted gamma distribution over alpha in [1e-5, 1] and p in [0, 2] above the horizon with
    288 nodes: relative error of σ below 1e-7, of α ∂σ/∂α below 1e-6 σ. Raises ValueError for a distribution
    that is not isotropic.
    """
    if not isinstance(ndf, AbstractIsotropicNDF):
        raise ValueError(
            f"tabulate_projected_area takes an isotropic distribution, not {type(ndf).__name__}: its "
            "projected area depends on the azimuth; evaluate ndf.projected_area itself"
        )
    dtype = jnp.result_type(float, *jax.tree.leaves(ndf))
    return TabulatedArea(ndf, *_area_and_slope(ndf, jnp.asarray(polar_nodes(nodes), dtype)))


@eqx.filter_jit
def _area_and_slope(ndf: AbstractIsotropicNDF, cos_w: Float[Array, " N"]) -> tuple[Array, Array]:
    """σ and dσ/dcos θ at each cosine, (N,) or (N, C)."""

    def area(c):
        return ndf.projected_area(jnp.stack([safe_sqrt(1 - c**2), jnp.zeros_like(c), c], axis=-1))

    return jax.jvp(area, (cos_w,), (jnp.ones_like(cos_w),))


def polar_nodes(n: int) -> np.ndarray:
    """The cosines at whole positions 0 … n − 1: from the horizon to the normal."""
    t = _SMALLEST / 2 * np.sinh(np.linspace(0, np.arcsinh(2 / _SMALLEST), n))
    return 2 * t / (1 + t**2)


def polar_position(c: Float[Array, "..."], n: int) -> Float[Array, "..."]:
    """Where the cosine c lies among the nodes: evenly in arsinh(2 t / 1e-5), t = tan((π/2 − θ) / 2)."""
    t = c / (1 + safe_sqrt(1 - c**2))
    return jnp.arcsinh(t * (2 / _SMALLEST)) * ((n - 1) / np.arcsinh(2 / _SMALLEST))
