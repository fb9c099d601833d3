"""The table of every reflectance with its truth, and what the tests evaluate of it; a new one is a line."""

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
from tests.jaxbrdf.brdf.truths import classic, physical

BRONZE = (0.0478786, 0.0364976, 0.014832, 0.459076, 6.05524, 5.05524)  # alum-bronze, red, as published
SATIN = (0.1, 0.4, 0.3, 1.2, 0.6, 0.1)
SGD_NAMES = ("rho_d", "rho_s", "alpha", "p", "f0", "f1")


@dataclass(frozen=True)
class Case:
    """A reflectance make(*parameters), its reference(*parameters)(wi, wo), and what it promises."""

    make: Callable
    parameters: tuple[float, ...]
    reference: Callable
    error: float = 1e-8
    isotropic: bool = True
    conserves: bool = True  # albedo ≤ 1, at every incidence

    def __str__(self):
        name = getattr(self.make, "__name__", "").strip("_")
        return f"{name} {' '.join(f'{p:g}' for p in self.parameters)}"

    @property
    def brdf(self) -> jb.AbstractBRDF:
        return self.make(*(jnp.asarray(p) for p in self.parameters))


def truth_of_sgd(*parameters):
    return partial(references.cook_torrance, **dict(zip(SGD_NAMES, parameters, strict=True)))


def approximated(*parameters):
    return jb.ShiftedGammaBRDF(*parameters, shadowing=jb.ShiftedGammaShadowing(2.0, 0.5, 6.0))


def truth_of_approximated(rho_d, rho_s, alpha, p, f0, f1):
    """Masking taken from eq. 9 instead."""
    smith = truth_of_sgd(0.0, rho_s, alpha, p, f0, f1)

    def f(wi, wo):
        value = smith(wi, wo)
        for w in (wi, wo):
            exact = w[2] / references.projected_area(references.sgd(alpha, p), w)
            value *= references.mask_approximation(np.arccos(w[2]), 2.0, 0.5, 6.0)[0] / exact
        return rho_d / np.pi + value

    return f


def tabulated(rho_d, rho_s, alpha, p, f0, f1):
    ndf = jb.tabulate_projected_area(jb.ShiftedGamma(alpha, p))
    return jb.CookTorrance(rho_d, rho_s, ndf, jb.LinearSchlick(f0, f1))


def a_sum(*parameters):
    return jb.Lambertian(0.2) + jb.ShiftedGammaBRDF(*parameters) + 0.5 * jb.Lambertian(0.2)


def truth_of_the_sum(*parameters):
    sgd = truth_of_sgd(*parameters)
    return lambda wi, wo: 0.3 / np.pi + sgd(wi, wo)


def ggx_facets(alpha_x, alpha_y, f0):
    return jb.Microfacet(jb.TrowbridgeReitz(alpha_x, alpha_y), jb.Schlick(f0), jb.HeightCorrelated())


def truth_of_ggx_facets(alpha_x, alpha_y, f0):
    """Walter et al. 2007, eq. 20, with 1 / (1 + Λ_i + Λ_o)."""
    D = references.trowbridge_reitz(alpha_x, alpha_y)

    def f(wi, wo):
        h = (wi + wo) / np.linalg.norm(wi + wo)
        both = sum(references.smith_lambda("trowbridge_reitz", alpha_x, alpha_y, w) for w in (wi, wo))
        F = f0 + (1 - f0) * (1 - wi @ h) ** 5
        return float(F * D(h) / (1 + both) / (4 * wi[2] * wo[2]))

    return f


def grooves(angle, sigma):
    """Their facets reach below the horizon, and are not drawn for a direction."""
    return jb.Microfacet(jb.VGrooves(angle, sigma), jb.Constant(1.0))


def truth_of_grooves(angle, sigma):
    D = references.v_grooves(angle, sigma)

    def f(wi, wo):
        h = (wi + wo) / np.linalg.norm(wi + wo)
        G1 = [min(1, w[2] / references.projected_area(D, w)) for w in (wi, wo)]
        return float(D(h) * G1[0] * G1[1] / (4 * wi[2] * wo[2]))

    return f


def glossy_lobe(f0, *exponents):
    return jb.AshikhminShirleyLobe(jb.Schlick(f0), *exponents)


def rough_metal(smoothness, eta, kappa):
    return jb.RoughMetal(smoothness, jb.Conductor(eta, kappa))


def kirchhoff(wavelength, f0):
    dtype = jnp.result_type(float, wavelength)
    tables = jnp.asarray(physical.tables(), dtype), jnp.asarray(physical.WAVELENGTHS_Q, dtype)
    return jb.KirchhoffBRDF(*tables, wavelength, jb.Constant(f0))


CASES = [
    Case(jb.Lambertian, (0.3,), lambda albedo: lambda wi, wo: albedo / np.pi),
    Case(jb.ShiftedGammaBRDF, BRONZE, truth_of_sgd),
    Case(jb.ShiftedGammaBRDF, SATIN, truth_of_sgd),
    Case(approximated, SATIN, truth_of_approximated, conserves=False),
    Case(tabulated, SATIN, truth_of_sgd, error=2e-7),
    Case(a_sum, SATIN, truth_of_the_sum),
    Case(ggx_facets, (0.1, 0.5, 0.6), truth_of_ggx_facets, isotropic=False),
    Case(grooves, (0.7, 0.2), truth_of_grooves, isotropic=False),
    Case(jb.OrenNayar, (0.8, 0.5), classic.oren_nayar),
    Case(jb.OrenNayar, (0.5, 1.2, 0.33), classic.oren_nayar),
    Case(jb.Phong, (2.0,), classic.phong),
    Case(jb.Phong, (100.0,), classic.phong),
    Case(jb.BlinnPhongBRDF, (30.0,), classic.blinn_phong, conserves=False),
    Case(jb.Lafortune, (20.0, -1.0, -1.0, 0.8), classic.lafortune),
    Case(jb.Lafortune, (3.0, 0.8, -0.5, 1.0), classic.lafortune, isotropic=False, conserves=False),
    Case(jb.Ward, (0.1, 0.4), classic.ward, isotropic=False, conserves=False),
    Case(jb.WardDuer, (0.2,), classic.ward_duer, conserves=False),
    Case(glossy_lobe, (0.2, 50.0, 400.0), classic.ashikhmin_shirley_lobe, isotropic=False),
    Case(jb.AshikhminShirley, (0.5, 0.1, 200.0), classic.ashikhmin_shirley),
    Case(jb.ABC, (2.240743, 123.54203, 1.498179, 1.741225), physical.abc),  # cherry-235
    Case(jb.SmoothABC, (46.04591, 484.464679, 1.333677, 3.40619), physical.smooth_abc),  # nickel, red
    Case(rough_metal, (2.0, 0.2, 3.0), physical.rough_metal),
    Case(kirchhoff, (0.55, 0.9), physical.kirchhoff, isotropic=False, conserves=False),
]
every_brdf = pytest.mark.parametrize("case", CASES, ids=str)
every_kind = pytest.mark.parametrize("case", list({c.make: c for c in CASES}.values()), ids=str)


def pairs(n):
    """Directions above the horizon, of which half are near mirror pairs, where a lobe is."""
    rng = np.random.default_rng(11)
    wi = references.direction(np.arccos(rng.uniform(0.05, 1, n)), rng.uniform(-np.pi, np.pi, n))
    wo = references.direction(np.arccos(rng.uniform(0.05, 1, n)), rng.uniform(-np.pi, np.pi, n))
    mirror = wi[: n // 2] * [-1, -1, 1] + 0.05 * rng.normal(size=(n // 2, 3))
    mirror[:, 2] = np.abs(mirror[:, 2])
    wo[: n // 2] = mirror / np.linalg.norm(mirror, axis=-1, keepdims=True)
    return wi, wo


PAIRS = pairs(16)
TURN = references.rotation("z", 1.1)
SEAM_DIRECTIONS = (
    np.array(  # normal, grazing, oblique in two azimuths, below the horizon, nadir, nearly grazing
        [
            [0, 0, 1.0],
            [1.0, 0, 0],
            [0.6, 0, 0.8],
            [-0.6, 0, 0.8],
            [0.6, 0, -0.8],
            [0, 0, -1.0],
            [0, 1.0, 1e-9],
            [0, 1.0, 6e-17],
        ]
    )
)
SEAMS = np.repeat(SEAM_DIRECTIONS, 8, 0), np.tile(SEAM_DIRECTIONS, (8, 1))
WI, WO = (
    np.concatenate([PAIRS[k], PAIRS[1 - k], PAIRS[k] @ TURN.T, PAIRS[k] * [1, -1, 1], SEAMS[k]])
    for k in (0, 1)
)
PLAIN, EXCHANGED, TURNED, MIRRORED = (slice(16 * k, 16 * (k + 1)) for k in range(4))
AT_SEAMS = slice(64, None)

# for programs of many gradients at few directions: compiling them takes the time, not running them
compiled_quickly = partial(eqx.filter_jit, compiler_options={"xla_backend_optimization_level": 0})


@dataclass(frozen=True)
class Evaluated:
    """f (N,) at the pairs WI, WO; its gradients by the parameters (P, N) and by both directions (3, N)."""

    value: np.ndarray
    by_parameter: np.ndarray
    by_wi: np.ndarray
    by_wo: np.ndarray


@compiled_quickly
def value_and_gradients(make, parameters, wi, wo):
    def f(parameters, wi, wo):
        return make(*parameters)(wi, wo)

    def at(wi, wo):
        value, gradients = jax.value_and_grad(f, (0, 1, 2))(parameters, wi, wo)
        return value, *gradients

    return tuple(jnp.moveaxis(a, 0, -1) for a in jax.vmap(at)(wi, wo))


@cache
def evaluated(case: Case, dtype: type = np.float64) -> Evaluated:
    parameters = np.array(case.parameters, dtype)
    return Evaluated(
        *(
            np.asarray(a)
            for a in value_and_gradients(case.make, parameters, WI.astype(dtype), WO.astype(dtype))
        )
    )
