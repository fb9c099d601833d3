"""The house's page on shapes, as a test: batches are vmapped, channels trail, and memory is bounded."""

import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxbrdf as jb

WI = jb.spherical(jnp.linspace(0.1, 1.2, 6).reshape(2, 3), 0.2)
WO = jb.spherical(jnp.linspace(1.3, 0.3, 6).reshape(2, 3), 2.5)


@eqx.filter_jit
def evaluate(brdf, wi, wo):
    return brdf(wi, wo)


def sgd(alpha, rho_d=0.1):
    return jb.ShiftedGammaBRDF(rho_d, 0.5, alpha, 0.6, 0.7, 0.1)


def test_one_grey_model():
    assert evaluate(sgd(0.1), WI, WO).shape == (2, 3)


def test_one_rgb_model_with_mixed_leaves():
    """Some parameters are (C,), the others () and shared."""
    alpha = jnp.array([0.05, 0.1, 0.3])
    value = evaluate(sgd(alpha), WI, WO)
    assert value.shape == (2, 3, 3)
    for c in range(3):
        assert_allclose(value[..., c], evaluate(sgd(alpha[c]), WI, WO), rtol=1e-12)


def test_a_hundred_materials_in_rgb():
    """Leaves (100, C), by vmap over the model's leaves: (100, ..., C)."""
    alpha = jnp.linspace(0.01, 0.5, 300).reshape(100, 3)
    rho_d = jnp.linspace(0, 0.4, 100)
    models = jax.vmap(sgd)(alpha, rho_d)
    value = jax.vmap(evaluate, (0, None, None))(models, WI, WO)
    assert value.shape == (100, 2, 3, 3)
    assert_allclose(value[42], evaluate(sgd(alpha[42], rho_d[42]), WI, WO), rtol=1e-12)


def test_ten_thousand_patches_share_their_directions():
    """Leaves (10000,), by vmap; m: (cells, 3) shared: (10000, cells)."""
    alpha, p = jnp.linspace(0.01, 0.9, 10_000), jnp.linspace(0, 1.9, 10_000)
    m = jb.spherical(jnp.linspace(0, 1.2, 20), 0.0)
    value = jax.jit(jax.vmap(lambda ndf, m: ndf(m), (0, None)))(jax.vmap(jb.ShiftedGamma)(alpha, p), m)
    assert value.shape == (10_000, 20)
    assert_allclose(value[1234], jb.ShiftedGamma(alpha[1234], p[1234])(m), rtol=1e-12)


def test_a_stack_of_tables():
    """values (B, N, N), by vmap."""
    values = jax.random.uniform(jax.random.key(0), (4, 9, 9))
    tables = jax.vmap(jb.TabulatedNDF)(values)
    area = jax.vmap(lambda table: table.projected_area(WI))(tables)
    assert area.shape == (4, 2, 3)
    assert_allclose(area[2], jb.TabulatedNDF(values[2]).projected_area(WI), rtol=1e-12)


def test_an_image_of_materials_is_a_vmap_over_models_and_directions_alike():
    alpha = jnp.linspace(0.05, 0.4, 6).reshape(2, 3)
    value = jax.vmap(jax.vmap(lambda a, i, o: sgd(a)(i, o)))(alpha, WI, WO)
    assert_allclose(value[1, 2], evaluate(sgd(alpha[1, 2]), WI[1, 2], WO[1, 2]), rtol=1e-12)


def test_different_numbers_of_channels_are_refused():
    brdf = jb.Lambertian(jnp.ones(2)) + jb.Lambertian(jnp.ones(3))
    with pytest.raises(ValueError, match=r"different numbers of channels: \[2, 3\]"):
        brdf(WI, WO)


@pytest.mark.parametrize(
    "model",
    [
        lambda: jb.Lambertian(jnp.ones((100, 3)))(WI, WO),
        lambda: jb.ShiftedGamma(jnp.ones((4, 5)), 0.5)(WI),
        lambda: sgd(jnp.ones((2, 2)))(WI, WO),
    ],
    ids=["Lambertian", "ShiftedGamma", "ShiftedGammaBRDF"],
)
def test_too_many_axes_are_refused_with_a_way_out(model):
    with pytest.raises(ValueError, match="vmap"):
        model()


def test_a_parameter_inside_another_model_is_named():
    brdf = jb.CookTorrance(0.1, 0.2, jb.ShiftedGamma(jnp.ones((4, 5)), 0.5), jb.LinearSchlick(0.5, 0.0))
    with pytest.raises(ValueError, match=r"\.ndf\.alpha has shape \(4, 5\)"):
        brdf(WI, WO)


MEMORY = """
import resource, sys
from pathlib import Path
import jax, jax.numpy as jnp, numpy as np, equinox as eqx
import jaxbrdf as jb
jax.config.update("jax_enable_x64", True)
n = 360_000

def peak():
    status = Path("/proc/self/status")
    if status.exists():  # Linux: there ru_maxrss starts from the peak of the process that started this one
        return 1024 * int(status.read_text().split("VmHWM:")[1].split()[0])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

w = jax.random.normal(jax.random.key(1), (2, n, 3))
w = w.at[..., 2].set(jnp.abs(w[..., 2]) + 1e-3)
wi, wo = w / jnp.linalg.norm(w, axis=-1, keepdims=True)
rgb = jnp.array([0.1, 0.2, 0.3])
sgd = jb.ShiftedGamma(0.1, 0.5)
fresnel = jb.LinearSchlick(0.5, 0.1)
m_x, m_y = np.meshgrid(np.linspace(-1, 1, 65), np.linspace(-1, 1, 65))
table = jb.TabulatedNDF(np.exp(-(m_x**2 + m_y**2)))
models = {
    "Lambertian": jb.Lambertian(rgb),
    "ShiftedGammaBRDF": jb.ShiftedGammaBRDF(0.1, 0.2, rgb, 0.5, 0.5, 0.1),
    "approximated": jb.ShiftedGammaBRDF(
        0.1, 0.2, 0.1, rgb, 0.5, 0.1, jb.ShiftedGammaShadowing(2.0, 0.5, 6.0)),
    "TabulatedArea": jb.CookTorrance(rgb, 0.2, jb.tabulate_projected_area(sgd), fresnel),
    "TabulatedNDF": jb.CookTorrance(0.1, 0.2, table, fresnel),
    "GaussianMicrofacets": jb.Microfacet(jb.GaussianMicrofacets(0.1, 0.3), jb.Constant(rgb)),
    "AnisotropicPhong": jb.Microfacet(jb.AnisotropicPhong(50.0, 10.0), jb.Constant(rgb)),
    "FacetScattering": jb.FacetScattering(jb.Beckmann(0.3), jb.Lambertian(0.5), nodes=256),
    "MeasuredBRDF": jb.MeasuredBRDF(np.ones((90, 90, 180, 3)), np.ones(3), jb.merl_grid()),
}
for name, model in models.items():
    f = eqx.filter_jit(lambda brdf, wi, wo: brdf(wi, wo))(model, wi, wo).block_until_ready()
    assert f.shape[0] == n
    print(name, peak())
images = jnp.broadcast_to(rgb, (64, 64, 3))
facets = jb.Ellipsoid(images, images, 0.1, 0.1, 0.1)
varying = jb.SpatiallyVaryingBRDF(jb.Microfacet(facets, jb.Constant(rgb)))
u = jax.random.uniform(jax.random.key(2), (n, 2))
eqx.filter_jit(lambda f, u, wi, wo: f(u[:, 0], u[:, 1], wi, wo))(varying, u, wi, wo).block_until_ready()
print("SpatiallyVaryingBRDF", peak())
eqx.filter_jit(lambda ndf, u: ndf.sample(u))(sgd, u).block_until_ready()
print("sample", peak())
"""


def test_360_000_pairs_of_directions_stay_under_2_gb():
    """The peak of one process that evaluates every model in turn, jitted, JAX itself included."""
    run = subprocess.run([sys.executable, "-c", MEMORY], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    peaks = {name: int(peak) / 1e9 for name, peak in (line.split() for line in run.stdout.splitlines())}
    assert len(peaks) == 11
    assert max(peaks.values()) < 2, peaks


@pytest.mark.parametrize(
    "evaluate_nothing",
    [
        lambda none: sgd(0.1)(none, none),
        lambda none: jb.ShiftedGamma(0.1, 0.5).projected_area(none),
        lambda none: jb.TabulatedNDF(jnp.ones((5, 5))).projected_area(none),
        lambda none: jb.ShiftedGamma(0.1, 0.5).sample(none[:, :2])[..., 0],
        lambda none: jb.albedo(jb.Lambertian(0.2), none),
        lambda none: jb.to_half_difference(none, none)[0],
    ],
    ids=["BRDF", "area", "table", "sample", "albedo", "angles"],
)
def test_no_directions_give_no_values(evaluate_nothing):
    assert evaluate_nothing(jnp.zeros((0, 3))).shape == (0,)


def test_work_in_chunks_is_the_same_work():
    """More directions than a chunk holds, and a number of them that no chunk divides."""
    ndf = jb.ShiftedGamma(0.1, 0.5)
    w = jb.spherical(jnp.linspace(0, 1.5, 20_001), 0.0)
    area = eqx.filter_jit(lambda ndf, w: ndf.projected_area(w))(ndf, w)
    picked = np.array([0, 8191, 8192, 16_384, 20_000])
    assert_allclose(area[picked], ndf.projected_area(w[picked]), rtol=1e-13)
