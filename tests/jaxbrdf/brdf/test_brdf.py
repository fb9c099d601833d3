"""Every reflectance × every property that a reflectance has; a new one is a line in CASES."""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from tests import references

RNG = np.random.default_rng(11)
BRONZE = {
    "rho_d": 0.0478786,
    "rho_s": 0.0364976,
    "alpha": 0.014832,
    "p": 0.459076,
    "f0": 6.05524,
    "f1": 5.05524,
}
SATIN = {"rho_d": 0.1, "rho_s": 0.4, "alpha": 0.3, "p": 1.2, "f0": 0.6, "f1": 0.1}


@dataclass(frozen=True)
class Case:
    name: str
    brdf: jb.AbstractBRDF
    reference: Callable[[np.ndarray, np.ndarray], float]
    error: float = 1e-8

    def __str__(self):
        return self.name


def sgd_reference(parameters):
    return lambda wi, wo: references.cook_torrance(wi, wo, **parameters)


def approximated(wi, wo):
    """SATIN with its masking taken from eq. 9 instead."""
    smith = references.cook_torrance(wi, wo, **{**SATIN, "rho_d": 0})
    for w in (wi, wo):
        exact = w[2] / references.projected_area(references.sgd(SATIN["alpha"], SATIN["p"]), w)
        smith *= references.mask_approximation(np.arccos(w[2]), 2.0, 0.5, 6.0)[0] / exact
    return SATIN["rho_d"] / np.pi + smith


def with_fresnel(parameters):
    lobe = {name: parameters[name] for name in ("alpha", "p")}
    return jb.CookTorrance(
        parameters["rho_d"],
        parameters["rho_s"],
        jb.tabulate_projected_area(jb.ShiftedGamma(**lobe)),
        jb.LinearSchlick(parameters["f0"], parameters["f1"]),
    )


CASES = [
    Case("Lambertian", jb.Lambertian(0.3), lambda wi, wo: 0.3 / np.pi),
    Case("shifted gamma, bronze", jb.ShiftedGammaBRDF(**BRONZE), sgd_reference(BRONZE)),
    Case("shifted gamma, satin", jb.ShiftedGammaBRDF(**SATIN), sgd_reference(SATIN)),
    Case(
        "approximated masking",
        jb.ShiftedGammaBRDF(**SATIN, shadowing=jb.ShiftedGammaShadowing(2.0, 0.5, 6.0)),
        approximated,
    ),
    Case("Cook-Torrance, tabulated area", with_fresnel(SATIN), sgd_reference(SATIN), error=2e-7),
    Case(
        "sum",
        jb.Lambertian(0.2) + jb.ShiftedGammaBRDF(**SATIN) + jb.Lambertian(0.1),
        lambda wi, wo: 0.3 / np.pi + references.cook_torrance(wi, wo, **SATIN),
    ),
]
every_brdf = pytest.mark.parametrize("case", CASES, ids=str)


def pairs(n):
    """Directions above the horizon, of which half are near mirror pairs, where a lobe is."""
    wi = references.direction(np.arccos(RNG.uniform(0.05, 1, n)), RNG.uniform(-np.pi, np.pi, n))
    wo = references.direction(np.arccos(RNG.uniform(0.05, 1, n)), RNG.uniform(-np.pi, np.pi, n))
    mirror = wi[: n // 2] * [-1, -1, 1] + 0.05 * RNG.normal(size=(n // 2, 3))
    mirror[:, 2] = np.abs(mirror[:, 2])
    wo[: n // 2] = mirror / np.linalg.norm(mirror, axis=-1, keepdims=True)
    return wi, wo


WI, WO = pairs(16)


@eqx.filter_jit
def evaluate(brdf, wi, wo):
    return brdf(wi, wo)


@every_brdf
def test_value_is_plain_numpys(case):
    expected = [case.reference(i, o) for i, o in zip(WI, WO, strict=True)]
    assert_allclose(evaluate(case.brdf, jnp.asarray(WI), jnp.asarray(WO)), expected, rtol=case.error)


@every_brdf
def test_reciprocity(case):
    wi, wo = jnp.asarray(WI), jnp.asarray(WO)
    assert_allclose(evaluate(case.brdf, wi, wo), evaluate(case.brdf, wo, wi), rtol=1e-12)


@every_brdf
def test_isotropy_and_mirror_symmetry(case):
    wi, wo = (jnp.asarray(w @ references.rotation("z", 1.1).T) for w in (WI, WO))
    assert_allclose(
        evaluate(case.brdf, wi, wo), evaluate(case.brdf, jnp.asarray(WI), jnp.asarray(WO)), rtol=1e-9
    )


SEAM_DIRECTIONS = np.array(
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
SEAM_WI, SEAM_WO = (
    jnp.asarray(a.reshape(-1, 3))
    for a in (np.repeat(SEAM_DIRECTIONS, 8, 0), np.tile(SEAM_DIRECTIONS, (8, 1)))
)


@every_brdf
def test_at_and_below_the_horizon_it_is_zero_and_above_finite(case):
    value = np.asarray(evaluate(case.brdf, SEAM_WI, SEAM_WO))
    dark = np.asarray((SEAM_WI[:, 2] <= 0) | (SEAM_WO[:, 2] <= 0))
    assert_array_equal(value[dark], 0)
    assert np.all(np.isfinite(value))
    assert np.all(value[~dark] > 0)


@eqx.filter_jit
def gradients(brdf, wi, wo):
    gradient = jax.grad(lambda brdf, wi, wo: brdf(wi, wo), (0, 1, 2))
    return jax.vmap(gradient, (None, 0, 0))(brdf, wi, wo)


@every_brdf
def test_gradients_are_finite_at_the_seams(case):
    for leaf in jax.tree.leaves(gradients(case.brdf, SEAM_WI, SEAM_WO)):
        assert np.all(np.isfinite(leaf))


@every_brdf
def test_channels_trail(case):
    """One leaf with three channels makes the result RGB; the other leaves are shared."""
    leaves, treedef = jax.tree.flatten(case.brdf)
    factors = jnp.array([1.0, 0.9, 0.8])
    rgb = treedef.unflatten([leaves[0] * factors, *leaves[1:]])
    value = evaluate(rgb, jnp.asarray(WI), jnp.asarray(WO))
    assert value.shape == (len(WI), 3)
    for k, factor in enumerate(factors):
        alone = treedef.unflatten([leaves[0] * factor, *leaves[1:]])
        assert_allclose(value[:, k], evaluate(alone, jnp.asarray(WI), jnp.asarray(WO)), rtol=1e-12)


@every_brdf
def test_single_precision_stays_single(case):
    brdf, wi, wo = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), (case.brdf, WI, WO))
    value = evaluate(brdf, wi, wo)
    assert value.dtype == jnp.float32
    assert_allclose(value, evaluate(case.brdf, jnp.asarray(WI), jnp.asarray(WO)), rtol=1e-3)


def test_derivatives_by_all_six_parameters():
    """By central differences of the plain numpy formula, at a pair inside the lobe."""
    wi, wo = references.direction(np.array([0.9, 0.8]), np.array([0.0, 2.9]))
    gradient = jax.jit(jax.grad(lambda brdf: brdf(jnp.asarray(wi), jnp.asarray(wo))))(
        jb.ShiftedGammaBRDF(**SATIN)
    )
    for name, value in SATIN.items():
        up, down = (references.cook_torrance(wi, wo, **{**SATIN, name: value + h}) for h in (1e-5, -1e-5))
        assert_allclose(getattr(gradient, name), (up - down) / 2e-5, rtol=1e-6)


def test_the_published_normalisation_has_one_over_pi():
    """At normal incidence F D G / (π cos cos) is F D / π, not F D / 4 (Bagher 2012, eq. 1)."""
    n = jnp.array([0.0, 0.0, 1.0])
    D = references.sgd(0.3, 1.2)(np.asarray(n))
    assert_allclose(jb.ShiftedGammaBRDF(0.0, 1.0, 0.3, 1.2, 1.0, 0.0)(n, n), D / np.pi, rtol=1e-12)


def test_a_sum_of_colours_and_greys():
    rgb = jb.Lambertian(jnp.array([0.1, 0.2, 0.3])) + jb.Lambertian(0.5)
    n = jnp.array([[0.0, 0.0, 1.0]])
    assert_allclose(rgb(n, n), [[0.6 / np.pi, 0.7 / np.pi, 0.8 / np.pi]])
