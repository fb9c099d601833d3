r"""Measured isotropic reflectance: a table over half and difference angles, and its two slices."""

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.brdf.base import AbstractBRDF, both_above, pick_by_first, sample_cosine
from jaxbrdf.directions import Direction, cos_theta, dot, half_vector, reflect, to_half_difference
from jaxbrdf.quadrature import HalfDifferenceGrid, pair_cosines
from jaxbrdf.special import safe_divide, safe_sqrt


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
    both directions at the cell's centre are above the horizon; nothing else is ever used. `wavelengths` (C,)
    are in micrometres, None for RGB and where nobody knows; `origin` holds what the file says of itself.

    Sampled like a diffuse surface and by half vectors whose density is read off the table, in shares of the
    light that each seems to reflect.
    """

    raw: Float[np.ndarray, "H D P C"] = eqx.field(metadata={"rank": 3})
    scale: Float[np.ndarray, " C"]
    grid: HalfDifferenceGrid
    name: str = eqx.field(static=True, default="")
    wavelengths: Float[np.ndarray, " C"] | None = None
    origin: tuple[str, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        expected, found = (*self.grid.shape, *self.scale.shape), self.raw.shape
        if found != expected:
            raise ValueError(
                f"MeasuredBRDF: raw must have the shape {expected} of grid and scale; found {found}"
            )

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

    @property
    def missing_share(self) -> np.ndarray:
        """The share of the cells above the horizon that hold no valid sample, (C,)."""
        return np.mean(~(self.raw[self.above_horizon] >= 0), axis=0)

    @property
    def anonymous(self) -> "MeasuredBRDF":
        """The same without name and origin; see `AbstractBRDF.anonymous`."""
        return replace(self, name="", origin=())

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
            raw, valid = self._cell(i, j, k)
            share = jnp.where(valid, u * v * w, 0)
            total, weight = total + share * jnp.where(valid, raw, 0), weight + share
        f = jnp.where(weight > 0, safe_divide(total, weight) * self.scale, jnp.nan)
        return jnp.where(both_above(wi, wo), f, 0)

    def _cell(self, i, j, k):
        """The raw samples with these indices, and whether each is valid."""
        raw = jnp.asarray(self.raw)[i, j, k]
        axes = (self.grid.theta_h, i), (self.grid.theta_d, j), (self.grid.phi_d, k)
        cos_i, cos_o = pair_cosines(*(jnp.asarray(nodes)[index] for nodes, index in axes))
        return raw, (raw >= 0) & (cos_i > 0) & (cos_o > 0)

    def _sample(self, u: Float[Array, "... 2"], wo: Direction) -> Direction:
        proposal = self._proposal()
        shares = jnp.stack([1 - proposal.share, proposal.share])
        by_half, u = pick_by_first(jnp.broadcast_to(shares, (*u.shape[:-1], 2)), u)
        mirrored = reflect(wo, proposal.sample_half(u))
        return jnp.where(by_half[..., None] == 1, mirrored, sample_cosine(u))

    def _pdf(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        proposal, h = self._proposal(), half_vector(wi, wo)
        mirrored = safe_divide(proposal.half_density(h), 4 * dot(wo, h))
        return (1 - proposal.share) * cos_theta(wi) / jnp.pi + proposal.share * mirrored

    def _weight(self, wo: Direction) -> Float[Array, "..."]:
        return jnp.broadcast_to(self._proposal().albedo, wo.shape[:-1])

    def _proposal(self) -> "_Proposal":
        """What to sample by, of one channel: a pass over its table.

        Of the samples half vectors have the lobe's share of the albedo, but at most 9 in 10: the rest bounds
        f / pdf.
        """
        D, diffuse = self._lobe()
        sin2 = jnp.sin(jnp.asarray(self.grid.theta_h_edges)) ** 2
        lobe = jnp.pi * jnp.concatenate([jnp.zeros(1, D.dtype), jnp.cumsum(D * jnp.diff(sin2))])
        albedo = lobe[-1] + jnp.pi * diffuse
        return _Proposal(sin2, safe_divide(lobe, lobe[-1:]), 0.9 * safe_divide(lobe[-1], albedo), albedo)

    def _lobe(self) -> tuple[Float[Array, " H"], Float[Array, ""]]:
        r"""D(θ_h) of facets that would reflect about as the table does, Fresnel and shadowing included, and
        the diffuse reflectance min m beneath them, 1/sr.

            D = 4 ⟨cos θ_i cos θ_o⟩ (m − min m),   m = ⟨f cos θ_i cos θ_o⟩ / ⟨cos θ_i cos θ_o⟩

        ⟨ ⟩ is the mean over the cells of one θ_h by dω_d cos θ_d; invalid ones count as 0.
        """
        cos_i, cos_o = self.grid.cosines()
        valid = (self.raw >= 0) & (cos_i > 0) & (cos_o > 0)
        d_theta, d_phi = jnp.diff(jnp.sin(self.grid.theta_d_edges) ** 2), jnp.diff(self.grid.phi_d_edges)
        share = (d_theta[:, None] * d_phi[None, :] / (jnp.sum(d_theta) * jnp.sum(d_phi)))[None]
        weight = jnp.where(valid, cos_i * cos_o * share, 0)
        cosines = jnp.sum(weight, axis=(1, 2))
        f_cosines = jnp.sum(weight * jnp.where(valid, self.raw, 0), axis=(1, 2)) * self.scale
        m = safe_divide(f_cosines, cosines)
        diffuse = jnp.min(m, initial=jnp.max(m), where=cosines > 0)
        return 4 * cosines * (m - diffuse), diffuse


class _Proposal(NamedTuple):
    """Half vectors drawn with probability `share`; the other samples are cosine-weighted.

    `sin2` (H + 1,) are the borders of bins in sin²θ_h, `cumulative` (H + 1,) the probability up to each:
    within a bin a half vector is evenly distributed in projected solid angle. `albedo` is about that of the
    table.
    """

    sin2: Float[Array, " H+1"]
    cumulative: Float[Array, " H+1"]
    share: Float[Array, ""]
    albedo: Float[Array, ""]

    def sample_half(self, u: Float[Array, "... 2"]) -> Direction:
        """A half vector for each u."""
        sin2, phi = jnp.interp(u[..., 0], self.cumulative, self.sin2), 2 * jnp.pi * u[..., 1]
        sin = safe_sqrt(sin2)
        return jnp.stack([sin * jnp.cos(phi), sin * jnp.sin(phi), safe_sqrt(1 - sin2)], axis=-1)

    def half_density(self, h: Direction) -> Float[Array, "..."]:
        """The density of `sample_half`, 1/sr."""
        bins = jnp.searchsorted(self.sin2, h[..., 0] ** 2 + h[..., 1] ** 2, side="right") - 1
        bins = jnp.clip(bins, 0, len(self.sin2) - 2)
        return (jnp.diff(self.cumulative) / jnp.diff(self.sin2))[bins] * cos_theta(h) / jnp.pi


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
    position = jnp.interp(x, jnp.asarray(nodes), jnp.arange(len(nodes), dtype=x.dtype))
    lower = jnp.clip(jnp.floor(position).astype(int), 0, len(nodes) - 2)
    return [(lower, 1 - (position - lower)), (lower + 1, position - lower)]


def _periodic_neighbours(x, nodes, period):
    n = len(nodes)
    wrapped = jnp.concatenate([nodes[-1:] - period, nodes, nodes[:1] + period])
    return [((index - 1) % n, weight) for index, weight in _neighbours(x, wrapped)]
