"""Facets that scatter: the reflectance of a rough surface whose facets have a reflectance of their own."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbrdf.arrays import in_chunks, precision
from jaxbrdf.brdf.base import AbstractBRDF, both_above, cosine_product
from jaxbrdf.directions import NORMAL, Direction, cos_theta, spherical
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.shadowing import AbstractShadowing, Uncorrelated
from jaxbrdf.special import safe_divide

_GOLDEN = (5**0.5 - 1) / 2


class FacetScattering(AbstractBRDF):
    r"""A surface whose facets have the reflectance β:

        f(wi, wo) = G(wi, wo) / (cos θ_i cos θ_o) ∫ β(wi', wo') (wi·m)+ (wo·m)+ D(m) dm

    Ashikhmin et al. 2000, eq. 33, with D = p / ⟨h·n⟩. wi', wo' are the directions in the frame of the facet:
    the macro-frame turned by the shortest rotation that takes n to m, see `to_facet`; a β that is isotropic
    does not ask for its tangent. Mirror facets are `Microfacet`; Lambertian ones look like `OrenNayar`.

    The integral is a sum over `nodes` facets, see `facet_nodes`, the same for all directions. With Lambertian
    facets the error of 4096 is 2e-4 (relative, rms over directions) for Beckmann and shifted gamma
    distributions of any width, 2e-3 for Gaussian microfacets and 4e-3 for velvets and cylinders, several
    times that at the worst; it falls about like 1/nodes. Where hardly a facet faces both directions, as
    across grooves, it is larger. A lobe of β must be wider than the facets lie apart: the width of D over
    √nodes. Symmetries of D hold as far. Tabulate a costly σ first, `tabulate_projected_area`.
    """

    ndf: AbstractNDF
    facet_brdf: AbstractBRDF
    shadowing: AbstractShadowing = Uncorrelated()
    nodes: int = eqx.field(static=True, default=4096)

    def _reflectance(self, wi: Direction, wo: Direction) -> Float[Array, "..."]:
        m, area = facet_nodes(self.ndf, self.nodes)

        def scattered(*components):
            wi, wo = (to_facet(jnp.stack(w), m) for w in (components[:3], components[3:]))
            facing = jnp.maximum(cos_theta(wi), 0) * jnp.maximum(cos_theta(wo), 0)
            return jnp.sum(area * facing * self.facet_brdf._reflectance(wi, wo))

        integral = in_chunks(scattered, *_components(wi), *_components(wo), size=max(1, 2**13 // self.nodes))
        G = self.shadowing(self.ndf, wi, wo)
        return jnp.where(both_above(wi, wo), G * integral / cosine_product(wi, wo), 0)


def facet_nodes(ndf: AbstractNDF, count: int) -> tuple[Float[Array, "n 3"], Float[Array, " n"]]:
    r"""About `count` normals m and their facet areas: Σ area g(m) ≈ ∫ g(m) D(m) dm, over the whole sphere.

    Half of them are drawn from the distribution, which finds its peak however sharp, half are even over the
    sphere, which finds what looks sideways or below the horizon; each counts D over the mean of the two
    densities. Both come from the lattice u = ((i + ½) / n, i / golden ratio mod 1). They are for scalar
    parameters; by these only the areas are differentiable, the normals stand still.
    """
    u = _lattice(count // 4 * 2, precision(ndf))  # an even number: none of the even ones is on the horizon
    even = spherical(jnp.arccos(1 - 2 * u[:, 0]), 2 * jnp.pi * u[:, 1])
    m = jax.lax.stop_gradient(jnp.concatenate([ndf._sample(u), even]))
    n = jnp.array(NORMAL, m.dtype)
    D = ndf._density(m)
    drawn = D * jnp.maximum(cos_theta(m), 0) / ndf._projected_area(n)
    density = jax.lax.stop_gradient(drawn + 1 / (4 * jnp.pi)) / 2
    return m, D / (density * len(m))


def to_facet(w: Direction, m: Direction) -> Direction:
    r"""Components of w in the frame of a facet m: R⁻¹ w, R the shortest rotation that takes n to m.

        w'_z = w·m,   w'_xy = w_xy − m_xy (w_z + w'_z) / (1 + m_z)

    Facets that look straight down, for which there is no shortest rotation, keep w_xy.
    """
    z = w[..., 0] * m[..., 0] + w[..., 1] * m[..., 1] + w[..., 2] * m[..., 2]
    along = safe_divide(w[..., 2] + z, 1 + m[..., 2])
    return jnp.stack([w[..., 0] - m[..., 0] * along, w[..., 1] - m[..., 1] * along, z], axis=-1)


def _lattice(n: int, dtype) -> Float[Array, "n 2"]:
    i = np.arange(n)
    return jnp.asarray(np.stack([(i + 0.5) / n, i * _GOLDEN % 1], axis=-1), dtype)


def _components(w: Direction) -> tuple[Float[Array, "..."], ...]:
    return w[..., 0], w[..., 1], w[..., 2]
