r"""Measured isotropic reflectance: a table over half and difference angles, and its two slices."""

from itertools import product

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.brdf.base import AbstractBRDF, both_above
from jaxbrdf.directions import Direction, to_half_difference
from jaxbrdf.quadrature import HalfDifferenceGrid, pair_cosines
from jaxbrdf.special import safe_divide


class Slices(eqx.Module):
    r"""The two slices of an isotropic measurement that Bagher et al. 2012 fit (section 5.2).

    `m_h` (H, C) is the backscattering slice m(θ_h) at θ_d ≈ 0 over `theta_h` (H,), `m_d` (D, C) the
    mirror slice m(θ_d) over `theta_d` (D,) at the half angle `theta_h_mirror` ≈ 0; radians and 1/sr.
    Each is the mean over the valid φ_d; NaN where no sample is valid.
    """

    theta_h: Float[np.ndarray, " H"]
    m_h: Float[np.ndarray, "H C"]
    theta_d: Float[np.ndarray, " D"]
    m_d: Float[np.ndarray, "D C"]
    theta_h_mirror: float = 0.0


class MeasuredBRDF(AbstractBRDF):
    r"""A measured isotropic reflectance, tabulated on a half/difference grid.

    `raw` (H, D, P, C) as the file has it, possibly mapped from disk and not yet read, and `scale` (C,):
    the reflectance is raw · scale, in 1/sr. A sample is *valid* where raw is ≥ 0 in that channel and
    both directions at the cell's centre are above the horizon; nothing else is ever used.
    """

    raw: Float[np.ndarray, "H D P C"] = eqx.field(metadata={"rank": 3})
    scale: Float[np.ndarray, " C"]
    grid: HalfDifferenceGrid
    name: str = eqx.field(static=True, default="")

    @property
    def values(self) -> np.ndarray:
        """Reflectance (H, D, P, C) in 1/sr, NaN where the sample is invalid. Reads the whole table."""
        valid = (self.raw >= 0) & self.above_horizon[..., None]
        return np.where(valid, self.raw * self.scale, np.nan)

    @property
    def above_horizon(self) -> np.ndarray:
        """(H, D, P): whether both directions at a cell's centre are above the horizon."""
        grid = self.grid
        return _above(grid.theta_h[:, None, None], grid.theta_d[None, :, None], grid.phi_d[None, None, :])

    def slices(self) -> Slices:
        """The backscattering and the mirror slice; of a mapped file only their pages are read."""
        theta_h, theta_d, phi_d = self.grid.theta_h, self.grid.theta_d, self.grid.phi_d
        return Slices(
            theta_h=theta_h,
            m_h=_mean_over_phi(self.raw[:, 0], _above(theta_h[:, None], theta_d[0], phi_d[None, :]))
            * self.scale,
            theta_d=theta_d,
            m_d=_mean_over_phi(self.raw[0], _above(theta_h[0], theta_d[:, None], phi_d[None, :]))
            * self.scale,
            theta_h_mirror=float(theta_h[0]),
        )

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        """f(wi, wo): trilinear between the valid cells around the pair; NaN where none of them is valid.

        φ_d is periodic with period π; beyond the first and the last θ the border cells are used.
        """
        theta_h, _, theta_d, phi_d = to_half_difference(wi, wo)
        corners = [
            _neighbours(theta_h, self.grid.theta_h),
            _neighbours(theta_d, self.grid.theta_d),
            _periodic_neighbours(phi_d % jnp.pi, self.grid.phi_d, jnp.pi),
        ]
        total = weight = jnp.zeros_like(theta_h)
        for (i, u), (j, v), (k, w) in product(*corners):
            raw, valid = self._sample(i, j, k)
            share = jnp.where(valid, u * v * w, 0)
            total, weight = total + share * jnp.where(valid, raw, 0), weight + share
        f = jnp.where(weight > 0, safe_divide(total, weight) * self.scale, jnp.nan)
        return jnp.where(both_above(wi, wo), f, 0)

    def _sample(self, i, j, k):
        """The raw samples with these indices, and whether each is valid."""
        raw = jnp.asarray(self.raw)[i, j, k]
        axes = (self.grid.theta_h, i), (self.grid.theta_d, j), (self.grid.phi_d, k)
        cos_i, cos_o = pair_cosines(*(jnp.asarray(nodes)[index] for nodes, index in axes))
        return raw, (raw >= 0) & (cos_i > 0) & (cos_o > 0)


def _above(theta_h, theta_d, phi_d) -> np.ndarray:
    cos_i, cos_o = pair_cosines(theta_h, theta_d, phi_d)
    return np.asarray((cos_i > 0) & (cos_o > 0))


def _mean_over_phi(raw: np.ndarray, above: np.ndarray) -> np.ndarray:
    """(N, P, C) and (N, P) to (N, C): the mean of the valid samples, NaN where there are none."""
    valid = (raw >= 0) & above[..., None]
    count = valid.sum(axis=1)
    total = np.where(valid, raw, 0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _neighbours(x, nodes):
    """The two nodes around x as (index, weight) pairs; outside the nodes, the nearest one."""
    position = jnp.interp(x, jnp.asarray(nodes), jnp.arange(len(nodes)))
    lower = jnp.clip(jnp.floor(position).astype(int), 0, len(nodes) - 2)
    return [(lower, 1 - (position - lower)), (lower + 1, position - lower)]


def _periodic_neighbours(x, nodes, period):
    n = len(nodes)
    wrapped = jnp.concatenate([nodes[-1:] - period, nodes, nodes[:1] + period])
    return [((index - 1) % n, weight) for index, weight in _neighbours(x, wrapped)]
