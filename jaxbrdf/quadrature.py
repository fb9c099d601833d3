"""Nodes and weights: the hemisphere, and the half/difference domain of an isotropic BRDF."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.directions import from_half_difference, spherical
from jaxbrdf.special import gauss_legendre


def hemisphere(n_theta: int, n_phi: int) -> tuple[Array, Array]:
    """Directions (n_theta · n_phi, 3) over the upper hemisphere and their weights dω, which sum to 2π.

    Gauss–Legendre in cos θ, equal steps in φ: exact for polynomials of degree 2 n_theta − 1 in cos θ.
    """
    nodes, weights = gauss_legendre(n_theta)
    phi = (jnp.arange(n_phi) + 0.5) * (2 * jnp.pi / n_phi)
    w = spherical(jnp.arccos(jnp.asarray(nodes))[:, None], phi[None, :])
    weight = jnp.broadcast_to(jnp.asarray(weights)[:, None] * (2 * jnp.pi / n_phi), (n_theta, n_phi))
    return w.reshape(-1, 3), weight.reshape(-1)


def pair_cosines(theta_h, theta_d, phi_d) -> tuple[Array, Array]:
    """(cos θ_i, cos θ_o) of the pair with these half and difference angles; they broadcast."""
    along = jnp.cos(theta_h) * jnp.cos(theta_d)
    across = jnp.sin(theta_h) * jnp.sin(theta_d) * jnp.cos(phi_d)
    return along - across, along + across


def _axis():
    return eqx.field(metadata={"rank": 1})


class HalfDifferenceGrid(eqx.Module):
    r"""A grid of cells in (θ_h, θ_d, φ_d), the domain of an isotropic, reciprocal BRDF.

    `theta_h` (H,), `theta_d` (D,), `phi_d` (P,) are the cells' centres and the `*_edges` (one more
    each) their borders, in radians. φ_d runs over [0, π): the other half follows by reciprocity.
    """

    theta_h: Float[np.ndarray, " H"] = _axis()
    theta_d: Float[np.ndarray, " D"] = _axis()
    phi_d: Float[np.ndarray, " P"] = _axis()
    theta_h_edges: Float[np.ndarray, " H+1"] = _axis()
    theta_d_edges: Float[np.ndarray, " D+1"] = _axis()
    phi_d_edges: Float[np.ndarray, " P+1"] = _axis()

    @property
    def shape(self) -> tuple[int, int, int]:
        return len(self.theta_h), len(self.theta_d), len(self.phi_d)

    def directions(self) -> tuple[Array, Array]:
        """(wi, wo) at the cells' centres, each (H, D, P, 3), with φ_h = 0."""
        theta_h, theta_d, phi_d = np.meshgrid(self.theta_h, self.theta_d, self.phi_d, indexing="ij")
        return from_half_difference(theta_h, np.zeros_like(theta_h), theta_d, phi_d)

    def cosines(self) -> tuple[Array, Array]:
        """(cos θ_i, cos θ_o) at the cells' centres, each (H, D, P); without making the directions."""
        return pair_cosines(
            self.theta_h[:, None, None], self.theta_d[None, :, None], self.phi_d[None, None, :]
        )

    def measure(self) -> Array:
        r"""dω_i dω_o of each cell, (H, D, P): the grid covers all pairs of directions.

            dω_i dω_o = 4 cos θ_d dω_h dω_d,   dω = sin θ dθ dφ

        with ∫dφ_h = 2π and a factor 2 for the half of φ_d that is left out. Each cell's angular
        integrals are exact. The sum over pairs above the horizon is (2π)², up to the cells it cuts.
        """
        d_h = -jnp.diff(jnp.cos(self.theta_h_edges))
        d_d = jnp.diff(jnp.sin(self.theta_d_edges) ** 2) / 2  # ∫ cos θ_d sin θ_d dθ_d
        d_phi = jnp.diff(self.phi_d_edges)
        return 4 * 2 * (2 * np.pi) * d_h[:, None, None] * d_d[None, :, None] * d_phi[None, None, :]


def merl_grid() -> HalfDifferenceGrid:
    r"""The grid of the MERL database (Matusik et al. 2003): 90 × 90 × 180 cells.

    θ_h bin i spans (π/2)(i/90)² to (π/2)((i+1)/90)², with its centre at (π/2)((i+½)/90)²; θ_d and
    φ_d bins are 1° wide.
    """
    half, degree = np.pi / 2, np.pi / 180
    return HalfDifferenceGrid(
        theta_h=half * ((np.arange(90) + 0.5) / 90) ** 2,
        theta_d=degree * (np.arange(90) + 0.5),
        phi_d=degree * (np.arange(180) + 0.5),
        theta_h_edges=half * (np.arange(91) / 90) ** 2,
        theta_d_edges=degree * np.arange(91.0),
        phi_d_edges=degree * np.arange(181.0),
    )
