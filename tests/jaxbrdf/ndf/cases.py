"""The table of every distribution with its truth, and what the tests evaluate of it; a new one is a line."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbrdf as jb
from tests import references


@dataclass(frozen=True)
class Case:
    """A distribution make(*parameters), its reference(*parameters), and how far σ and D may be apart."""

    make: Callable
    parameters: tuple[float, ...]
    reference: Callable
    area_error: float = 1e-8  # relative above the horizon, absolute below
    density_error: float = 1e-9

    def __str__(self):
        name = getattr(self.make, "__name__", "").strip("_")
        return f"{name} {' '.join(f'{p:g}' for p in self.parameters)}"

    @property
    def has_visible(self) -> bool:
        return hasattr(self.make, "sample_visible")

    @property
    def density(self) -> references.Density:
        return reference(self.reference, self.parameters)

    @property
    def array(self) -> jax.Array:
        return jnp.array(self.parameters)


@cache
def reference(make: Callable, parameters: tuple[float, ...]) -> references.Density:
    return make(*parameters)


def tabulated_sgd(alpha, p):
    return jb.tabulate_projected_area(jb.ShiftedGamma(alpha, p))


def satin(flats, ends):
    return jb.mixture([0.7, 0.3], [jb.GaussianCylinder(flats), jb.GaussianCylinder(ends)])


def true_satin(flats, ends):
    shares = references.mixture_shares([0.7, 0.3], [(flats, np.inf), (ends, np.inf)])
    return references.mixture(shares, [references.gaussian_cylinder(s) for s in (flats, ends)])


def image(n=33):
    """A smooth picture without symmetry, with a dark disk beside its middle."""
    x, y = np.meshgrid(*[(2 * np.arange(n) + 1) / n - 1] * 2)
    return 1.2 + np.sin(2 * x + 1) * np.cos(3 * y) - np.exp(-((x - 0.2) ** 2 + y**2) / 0.1)


def modulated(sigma):
    return jb.Modulated(jb.GaussianMicrofacets(sigma), jnp.asarray(image(), sigma.dtype))


def true_modulated(sigma):
    return references.modulated(references.gaussian_microfacets(sigma), image())


CASES = [
    *(Case(jb.ShiftedGamma, lobe, references.sgd) for lobe in references.PUBLISHED_LOBES),
    Case(tabulated_sgd, (0.2, 1.8), references.sgd, area_error=1e-7),
    Case(jb.Beckmann, (1e-5,), references.beckmann),
    Case(jb.Beckmann, (1.0,), references.beckmann),
    Case(jb.Beckmann, (0.05, 0.5), references.beckmann),
    Case(jb.TrowbridgeReitz, (1e-5,), references.trowbridge_reitz),
    Case(jb.TrowbridgeReitz, (1.0,), references.trowbridge_reitz),
    Case(jb.TrowbridgeReitz, (0.05, 0.5), references.trowbridge_reitz),
    Case(jb.Ellipsoid, (0.1, 0.5, 0.3, 0.2, 0.7), references.ellipsoid),
    Case(jb.Ellipsoid, (0.3, 0.02, -0.4, 0.02, 2.0), references.ellipsoid),
    Case(jb.StudentT, (1e-5, 3.0), references.student_t),
    Case(jb.StudentT, (1.0, 1.9), references.student_t, area_error=1e-7),
    Case(jb.StudentT, (0.2, 40.0), references.student_t),
    Case(jb.BlinnPhong, (0.0,), references.blinn_phong),
    Case(jb.BlinnPhong, (1e6,), references.blinn_phong),
    Case(jb.BlinnPhong, (30.0,), references.blinn_phong),
    Case(jb.AnisotropicPhong, (5.0, 500.0), references.anisotropic_phong, area_error=1e-6),
    Case(jb.AnisotropicPhong, (40.0, 40.0), references.anisotropic_phong, area_error=1e-6),
    Case(jb.AnisotropicPhong, (1e5, 0.0), references.anisotropic_phong, area_error=1e-6),
    Case(jb.Exponential, (1e-5,), references.exponential),
    Case(jb.Exponential, (1.0,), references.exponential),
    Case(jb.Exponential, (0.1,), references.exponential),
    Case(jb.GaussianMicrofacets, (1e-5,), references.gaussian_microfacets),
    Case(jb.GaussianMicrofacets, (1.0,), references.gaussian_microfacets),
    Case(jb.GaussianMicrofacets, (0.05, 0.5), references.gaussian_microfacets),
    Case(jb.GaussianCylinder, (0.1,), references.gaussian_cylinder),
    Case(jb.GaussianCylinder, (1.0,), references.gaussian_cylinder),
    Case(jb.VGrooves, (0.7, 0.1), references.v_grooves),
    Case(jb.VGrooves, (1.2, 0.4), references.v_grooves),
    Case(jb.Velvet, (0.5,), references.velvet),
    Case(jb.Velvet, (0.05,), references.velvet),
    Case(jb.SlantedVelvet, (0.7, 0.5), references.slanted_velvet),
    Case(satin, (0.1, 0.3), true_satin, area_error=1e-5, density_error=1e-5),
    Case(modulated, (0.3,), true_modulated, area_error=1e-4, density_error=1e-4),
]
every_ndf = pytest.mark.parametrize("case", CASES, ids=str)
every_kind = pytest.mark.parametrize(
    "case", list({(c.make, len(c.parameters)): c for c in CASES}.values()), ids=str
)
every_visible = pytest.mark.parametrize("case", [c for c in CASES if c.has_visible], ids=str)

POLAR = np.array([0.0, 1e-6, 3e-3, 0.2, 0.8, 1.3, 1.55, np.pi / 2 - 1e-5, np.pi / 2 - 1e-7])
WAVES = references.direction(POLAR, np.linspace(-2, 2, len(POLAR)))
SEAMS = np.array(  # normal incidence; grazing, exactly and nearly; below the horizon; the nadir
    [
        [0.0, 0.0, 1.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 1e-9],
        [0.0, 1.0, 6e-17],
        [0.6, 0.0, -0.8],
        [0.0, 0.0, -1.0],
    ]
)
ABOVE, BELOW = slice(0, len(WAVES)), slice(len(WAVES), 2 * len(WAVES))
AT_SEAMS = slice(BELOW.stop, BELOW.stop + len(SEAMS))
TYPICAL = slice(AT_SEAMS.stop, AT_SEAMS.stop + 4)


def typical_normals(case: Case) -> np.ndarray:
    """Four normals about the middle of a distribution, where D is neither flat nor nothing."""
    piece = references.pieces(case.density)[0]
    bins = references.bins(piece, lambda m: np.abs(m[..., 2]), cells=90)
    return piece.normals(bins.rings[[2, 5, 7, 9]], np.array([0.4, 1.3, 2.2, 0.9]))[0]


@dataclass(frozen=True)
class Evaluated:
    """D and σ, (2, N), and their gradients by the parameters, (2, P, N), and the direction, (2, 3, N)."""

    m: np.ndarray
    value: np.ndarray
    by_parameter: np.ndarray
    by_direction: np.ndarray


# for programs of many gradients at few directions: compiling them takes the time, not running them
compiled_quickly = partial(eqx.filter_jit, compiler_options={"xla_backend_optimization_level": 0})


@compiled_quickly
def values_and_gradients(make, parameters, m):
    def both(parameters, m):
        ndf = make(*parameters)
        return jnp.stack([ndf(m), ndf.projected_area(m)])

    def at(m):
        return both(parameters, m), *jax.jacrev(both, (0, 1))(parameters, m)

    return tuple(jnp.moveaxis(a, 0, -1) for a in jax.vmap(at)(m))


@cache
def evaluated(case: Case, rounded: type = np.float64, dtype: type | None = None) -> Evaluated:
    """A case at the directions WAVES, −WAVES, SEAMS and four typical normals, in this order.

    Directions and parameters are first `rounded` and then evaluated in `dtype`, by default the same.
    """
    m = np.concatenate([WAVES, -WAVES, SEAMS, typical_normals(case)]).astype(rounded)
    parameters = np.array(case.parameters, rounded)
    dtype = dtype or rounded
    values = values_and_gradients(case.make, parameters.astype(dtype), m.astype(dtype))
    return Evaluated(m, *(np.asarray(a) for a in values))
