"""The materials that Ashikhmin et al. 2000 made with their generator, by name."""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxbrdf.arrays import Parameter
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.brdf.generated import GeneratedBRDF, GeneratedMetal, tabulate_reflectance
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.gaussian_microfacets import GaussianCylinder, GaussianMicrofacets
from jaxbrdf.ndf.grooves import VGrooves
from jaxbrdf.ndf.mixture import mixture
from jaxbrdf.ndf.modulated import Modulated
from jaxbrdf.ndf.tabulated_area import tabulate_projected_area
from jaxbrdf.ndf.velvet import SlantedVelvet, Velvet
from jaxbrdf.shadowing import AbstractShadowing, AzimuthCorrelated, Uncorrelated

# ((η − 1)² + κ²) / ((η + 1)² + κ²), white-balanced R, G and B of gold, η = (0.0584, 0.5002, 1.4590) and
# κ = (3.6131, 2.3240, 1.8186): those of `data_loaders.optical_constants("Au")`
GOLD = (0.9835, 0.7385, 0.3761)
NOT_METAL = 0.05  # f_0 of all that is not metal, section 6
SLANT = math.radians(40)  # of the bundles of velvet, and of the sides of the grooves


def ashikhmin_material(name: str, nodes: tuple[int, int] | None = None, facets: int = 8192) -> AbstractBRDF:
    """A material of Ashikhmin et al. 2000, in RGB; `nodes` and `facets` are those of `tabulate_reflectance`.

    | name | distribution | figure |
    |---|---|---|
    | anisotropic-gold | Gaussian 0.1 × 1.0 | 5 |
    | painted-plastic | Gaussian 0.1 × 0.2 | 7 |
    | grooved-metal | grooves with sides tilted by 40°, rough by 0.1; gold too | 9 |
    | satin | cylinders 0.1 and 0.3, of 70 and 30 % of the area | 11 |
    | velvet | inverse Gaussian 0.5, shadowing correlated | 11 |
    | slanted-velvet | cylinder 0.5 slanted by 40°, shadowing correlated | 13 |
    | image-modulated | Gaussian times a star | 1 |

    Metals have f_0 of gold, the others 0.05. The paper prints no diffuse colours, and for Fig. 1 neither the
    width of the Gaussian nor the image nor what it is made of: those are ours. σ and R are tabulated, which
    takes seconds. Raises ValueError for another name.
    """
    if name not in _MATERIALS:
        raise ValueError(f"no material {name!r}; there are: {', '.join(ASHIKHMIN_MATERIALS)}")
    recipe = _MATERIALS[name]
    ndf = tabulate_projected_area(recipe.make_ndf(*(jnp.asarray(p) for p in recipe.parameters)))
    shadowing = recipe.shadowing()
    reflectance = tabulate_reflectance(ndf, shadowing, nodes, facets)
    if recipe.rho_d is None:
        return GeneratedMetal(ndf, jnp.array(GOLD), shadowing, reflectance)
    return GeneratedBRDF(ndf, NOT_METAL, jnp.array(recipe.rho_d), shadowing, reflectance)


def star(n: int = 257) -> np.ndarray:
    """An image (n, n) of the disk of normals: five rays of light, each dark between, fading to the rim."""
    x, y = np.meshgrid(*[(2 * np.arange(n) + 1) / n - 1] * 2)
    r, phi = np.hypot(x, y), np.arctan2(y, x)
    return np.exp(-((r / 0.6) ** 2)) * (0.02 + np.clip((1 + np.cos(5 * phi)) / 2, 0, 1) ** 4)


def _satin(flats: Parameter, ends: Parameter) -> AbstractNDF:
    return mixture([0.7, 0.3], [GaussianCylinder(flats), GaussianCylinder(ends)])


def _starry(sigma: Parameter) -> AbstractNDF:
    return Modulated(GaussianMicrofacets(sigma), jnp.asarray(star(), sigma.dtype))


class _Recipe(NamedTuple):
    make_ndf: Callable[..., AbstractNDF]
    parameters: tuple[float, ...]
    shadowing: Callable[[], AbstractShadowing]
    rho_d: tuple[float, float, float] | None  # None: a metal


_MATERIALS = {
    "anisotropic-gold": _Recipe(GaussianMicrofacets, (0.1, 1.0), Uncorrelated, None),
    "painted-plastic": _Recipe(GaussianMicrofacets, (0.1, 0.2), Uncorrelated, (0.6, 0.4, 0.1)),
    "grooved-metal": _Recipe(VGrooves, (SLANT, 0.1), Uncorrelated, None),
    "satin": _Recipe(_satin, (0.1, 0.3), Uncorrelated, (0.4, 0.08, 0.1)),
    "velvet": _Recipe(Velvet, (0.5,), AzimuthCorrelated, (0.3, 0.02, 0.04)),
    "slanted-velvet": _Recipe(SlantedVelvet, (SLANT, 0.5), AzimuthCorrelated, (0.3, 0.02, 0.04)),
    "image-modulated": _Recipe(_starry, (0.3,), Uncorrelated, None),
}
ASHIKHMIN_MATERIALS = tuple(_MATERIALS)
