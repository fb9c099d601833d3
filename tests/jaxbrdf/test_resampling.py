"""Any record as any other: against the models they were made of, and what holds whatever the numbers are."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from jaxbrdf.resampling import evaluate

LAMBERTIAN = jb.Lambertian(0.5)
GGX = jb.Lambertian(0.3) + 0.2 * jb.Microfacet(
    jb.TrowbridgeReitz(0.1), jb.Schlick(0.04), jb.HeightCorrelated()
)
WARD = jb.Lambertian(0.1) + 0.3 * jb.Ward(0.1, 0.3)
MODELS = {"Lambertian": LAMBERTIAN, "GGX": GGX, "anisotropic Ward": WARD}
L2 = {"Lambertian": 0.008, "GGX": 0.05, "anisotropic Ward": 0.009}  # as adaptive tables
ABOUT = {"wavelengths": np.array([0.45, 0.6]), "name": "paint", "origin": ("by hand", "µ")}
every_model = pytest.mark.parametrize("name", MODELS)


def small_grid(H=12, D=10, P=16):
    h, d, p = (np.arange(n + 1) / n for n in (H, D, P))
    edges = np.pi / 2 * h**2, np.pi / 2 * d, np.pi * p
    return jb.HalfDifferenceGrid(*((e[1:] + e[:-1]) / 2 for e in edges), *edges)


def small_table(seed=0, grid=None, **about):
    """Numbers that no reflectance has, in two channels; the same for φ_d and π − φ_d."""
    grid = small_grid() if grid is None else grid
    raw = np.random.default_rng(seed).lognormal(size=(*grid.shape, 2))
    return jb.MeasuredBRDF(raw + raw[:, :, ::-1], np.array([0.1, 0.2]), grid, **about)


def made_up(phi_i=(0.0,), **about):
    """Adaptive tables without a meaning; nothing makes them reciprocal."""
    P, T, K, rng = len(phi_i), 4, 6, np.random.default_rng(3)

    def numbers(*shape):
        return rng.uniform(0.2, 1, shape).astype(np.float32)

    return jb.AdaptiveBRDF(
        theta_i=np.linspace(0, 1.5, T, dtype=np.float32),
        phi_i=np.asarray(phi_i, np.float32),
        ndf=np.repeat(numbers(1, 9), 2, axis=0),
        sigma=np.repeat(numbers(1, 7), 2, axis=0),
        vndf=numbers(P, T, 8, 10),
        luminance=numbers(P, T, K, K),
        values=numbers(P, T, K, K, 2),
        **about,
    )


def pairs(n, lowest=0.2):
    """Random pairs with both cosines above `lowest`, (n, 3) each."""
    rng = np.random.default_rng(n)
    z, phi = rng.uniform(lowest, 1, (2, n)), rng.uniform(-np.pi, np.pi, (2, n))
    return np.moveaxis(np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z]), 0, -1)


def samples(wi, wo, values, **about):
    angles = [a for w in (wi, wo) for a in (np.arctan2(np.hypot(*w.T[:2]), w[:, 2]), np.arctan2(*w.T[1::-1]))]
    return jb.MeasuredSamples(*angles, values, np.ones(len(wi)), **about)


@pytest.fixture(scope="module")
def adaptive():
    return {name: jb.as_adaptive(model) for name, model in MODELS.items()}


# Models


@every_model
def test_samples_of_a_model_are_its_values(name):
    found = jb.as_samples(MODELS[name])
    assert 20_000 < len(found.theta_i) < 200_000
    assert found.valid.all()
    assert_allclose(found.values[:, 0], MODELS[name](found.wi, found.wo), rtol=1e-6)
    turns = np.unique(np.round(np.arctan2(*(found.wi + found.wo).T[1::-1]), 6))
    assert (len(turns) > 3) == (name == "anisotropic Ward")


@every_model
def test_adaptive_tables_of_a_model(name, adaptive):
    brdf = adaptive[name]
    error = jb.resampling_error(MODELS[name], brdf)
    assert error.pairs > 10_000
    assert error.relative_l2[0] < L2[name]
    assert error.median[0] < 0.005
    assert brdf.is_isotropic == (name != "anisotropic Ward")
    assert {getattr(brdf, table).dtype for table in ("ndf", "sigma", "vndf", "luminance", "values")} == {
        np.dtype(np.float32)
    }


@pytest.mark.parametrize("name", ["GGX", "anisotropic Ward"])
def test_energy_of_adaptive_tables(name, adaptive):
    w = jb.spherical(np.radians(45.0), 0.3)
    assert_allclose(jb.albedo(adaptive[name], w)[0], jb.albedo(MODELS[name], w), rtol=0.01)


def test_adaptive_tables_turn_with_an_anisotropic_surface(adaptive):
    """Ward's highlight is three times as wide in y as in x."""
    tilt = np.radians([15.0, 15.0])
    h = np.asarray(jb.spherical(tilt, np.array([0.0, np.pi / 2])))
    found, expected = evaluate(adaptive["anisotropic Ward"], h, h)[:, 0], np.asarray(WARD(h, h))
    assert expected[1] > 5 * expected[0]
    assert_allclose(found, expected, rtol=0.03)


@pytest.mark.parametrize("name", ["Lambertian", "GGX"])
def test_a_table_of_a_model(name):
    table = jb.as_table(MODELS[name])
    error = jb.resampling_error(MODELS[name], table)
    assert error.relative_l2[0] < 5e-4
    assert error.median[0] < 1e-4
    assert table.grid.shape == (90, 90, 180)
    assert_array_equal(np.isfinite(table.values[..., 0]), table.above_horizon)
    assert (table.raw[~table.above_horizon] == -1).all()


def test_no_table_of_an_anisotropic_reflectance(adaptive):
    for brdf in (WARD, adaptive["anisotropic Ward"]):
        with pytest.raises(ValueError, match="depends on the azimuth"):
            jb.as_table(brdf)


# Records


def test_a_record_of_the_kind_already_is_left_as_it_is():
    grid = small_grid()
    table, adaptive, scattered = small_table(), made_up(), samples(*pairs(20), np.ones((20, 1)))
    assert jb.as_samples(scattered) is scattered
    assert jb.as_adaptive(adaptive) is adaptive
    assert jb.as_table(table, grid) is table
    assert jb.as_table(table, small_grid(P=14)) is not table


def test_what_a_record_says_of_itself_comes_along():
    adaptive, scattered = made_up(**ABOUT), samples(*pairs(40), np.ones((40, 2)), **ABOUT)
    made = [make(small_table(**ABOUT)) for make in (jb.as_samples, jb.as_adaptive)]
    made += [jb.as_samples(adaptive), jb.as_adaptive(scattered), jb.as_table(scattered, small_grid())]
    for record in made:
        assert_array_equal(record.wavelengths, ABOUT["wavelengths"])
        assert (record.name, record.origin) == (ABOUT["name"], ABOUT["origin"])
    assert jb.as_samples(LAMBERTIAN).wavelengths is None


def test_a_table_comes_back_from_its_samples():
    table = small_table()
    holes = np.random.default_rng(1).random(table.grid.shape) < 0.2
    table.raw[(holes | holes[..., ::-1]) & (table.grid.theta_h < 0.8)[:, None, None]] = -0.5
    scattered = jb.as_samples(table)
    assert len(scattered.theta_i) == np.isfinite(table.values[..., 0]).sum()
    assert scattered.valid.all()
    back = jb.as_table(scattered, table.grid)
    known = np.isfinite(table.values)
    assert 0.5 < known[table.above_horizon].mean() < 0.9
    assert_allclose(back.values[known], table.values[known], rtol=1e-12)
    assert (back.raw[~table.above_horizon] == -1).all()


@pytest.mark.parametrize("missing", [-1.0, np.nan])
def test_one_channel_may_lack_samples_that_another_has(missing):
    table = small_table()
    table.raw[3:5, :, :, 1] = missing
    scattered = jb.as_samples(table)
    both = np.isfinite(table.values)[table.above_horizon]
    assert_array_equal(scattered.valid, both)
    assert_array_equal(scattered.values[both], table.values[table.above_horizon][both])


def test_cells_out_of_reach_are_not_valid():
    scattered = jb.as_samples(small_table())
    near = scattered.theta_i < 0.5
    some = samples(scattered.wi[near], scattered.wo[near], scattered.values[near])
    table = jb.as_table(some, small_grid())
    wi, wo = (np.asarray(w) for w in table.grid.directions())
    known = (table.raw >= 0).all(axis=-1)
    far = np.minimum(wi[..., 2], wo[..., 2]) < np.cos(1.2)
    assert known.any()
    assert not known[far & (np.maximum(wi[..., 2], wo[..., 2]) < np.cos(0.9))].any()
    assert (table.raw[~known] == -1).all()


def test_a_table_is_the_mean_of_both_orders():
    brdf = made_up()
    table = jb.as_table(brdf, small_grid(8, 6, 10))
    wi, wo = (np.asarray(w)[table.above_horizon] for w in table.grid.directions())
    there, back = np.asarray(brdf(wi, wo)), np.asarray(brdf(wo, wi))
    assert np.median(np.abs(there - back) / there) > 0.1
    assert_allclose(table.values[table.above_horizon], (there + back) / 2, rtol=1e-6)


@every_model
def test_at_their_nodes_adaptive_tables_are_exact(name, adaptive):
    """Which the samples of the tables are."""
    found = jb.as_samples(adaptive[name])
    assert len(found.theta_i) > adaptive[name].luminance.size / 2
    assert_allclose(found.values[:, 0], MODELS[name](found.wi, found.wo), rtol=2e-3)


# Holes


@pytest.mark.parametrize("kind", ["table", "samples"])
@pytest.mark.parametrize("missing", [-1.0, np.nan])
def test_adaptive_tables_of_a_record_with_holes(kind, missing):
    """Two diffuse channels with random holes, one of them large, and a channel of which nothing is known."""
    table = jb.MeasuredBRDF(
        np.broadcast_to([0.3, 0.9, missing], (*small_grid().shape, 3)) / np.pi, np.ones(3), small_grid()
    )
    table.raw[np.random.default_rng(1).random(table.raw.shape) < 0.1] = missing
    table.raw[4:6, 2:7, :, 1] = missing
    source = table if kind == "table" else jb.as_samples(table)
    brdf = jb.as_adaptive(source)
    assert all(np.isfinite(getattr(brdf, name)).all() for name in ("ndf", "sigma", "vndf", "luminance"))
    assert np.isfinite(brdf.values).all()
    found = evaluate(brdf, *pairs(200))
    assert_allclose(found[:, :2], np.broadcast_to([0.3, 0.9], (200, 2)) / np.pi, rtol=0.03)
    assert_array_equal(found[:, 2], 0)


def test_a_channel_without_samples_does_not_blunt_the_others():
    """Where the nodes lie is told by the channels that are known."""
    table = jb.as_table(GGX)
    lame = replace(
        table, raw=np.concatenate([table.raw, np.full_like(table.raw, -1)], axis=-1), scale=np.ones(2)
    )
    error = jb.resampling_error(GGX, jb.as_adaptive(lame))
    assert error.relative_l2[0] < L2["GGX"]
    assert error.median[0] < 0.006


def test_incidences_are_those_measured_above_the_horizon():
    """Goniometers state 90 degrees, too, and ALTA's parameterisations reach below the horizon."""
    theta = np.radians([10.0, 20, 30, 40, 50, 60, 70, 80, 90, 110])
    theta_i, theta_o, phi_o = (
        a.ravel() for a in np.meshgrid(theta, theta[:7:2], np.radians([0, 60, 120, 180]))
    )
    zero = np.zeros(len(theta_i))
    values = np.full((len(zero), 1), 0.5 / np.pi)
    brdf = jb.as_adaptive(jb.MeasuredSamples(theta_i, zero, theta_o, phi_o, values, zero + 1))
    assert_allclose(brdf.theta_i, theta[:9], atol=2e-4)
    assert brdf.theta_i.max() < np.pi / 2
    assert_allclose(evaluate(brdf, *pairs(200, lowest=0.2)), 0.5 / np.pi, rtol=0.1)


# How far records are from each other


def test_the_error_between_diffuse_reflectances():
    for a, b in ((0.5, 0.4), (0.2, 0.3)):
        error = jb.resampling_error(jb.Lambertian(a), jb.Lambertian(b))
        assert_allclose(error.relative_l2, [abs(a - b) / a], rtol=1e-12)
        assert_allclose(error.median, [abs(a - b) / a], rtol=1e-12)
    colours = jb.resampling_error(jb.Lambertian(0.5), jb.Lambertian(jnp.array([0.5, 0.6])))
    assert_allclose(colours.median, [0, 0.2], atol=1e-12)


def test_the_error_against_its_formula():
    """Every pair has another error; those beyond 80 degrees, below the horizon or invalid do not count."""
    wi, wo = pairs(401, lowest=0.19)
    wo[-1] *= [1, 1, -1]
    f = np.random.default_rng(1).lognormal(size=(401, 2))
    f[::7, 0] = -1
    f[3::7, 1] = 0
    before = samples(wi, wo, f)
    error = jb.resampling_error(before, LAMBERTIAN)
    for channel in (0, 1):
        known = f[:-1, channel][f[:-1, channel] >= 0]
        off = np.abs(0.5 / np.pi - known)
        assert_allclose(error.relative_l2[channel], np.linalg.norm(off) / np.linalg.norm(known), rtol=1e-12)
        assert_allclose(error.median[channel], np.median((off / known.clip(1e-300))[known > 0]), rtol=1e-12)
    assert error.pairs == 400
    grazing = replace(before, theta_o=np.full(401, np.radians(80.1)))
    assert jb.resampling_error(grazing, LAMBERTIAN).pairs == 0


def test_the_error_where_nothing_is_known_or_reflected():
    black, before = jb.Lambertian(0.0), samples(*pairs(50), np.full((50, 2), 0.5) / np.pi)
    error = jb.resampling_error(black, LAMBERTIAN)
    assert np.isnan(error.median).all()
    assert not np.isfinite(error.relative_l2).any()
    assert np.isnan(jb.resampling_error(black, black).relative_l2).all()
    unknown = jb.MeasuredBRDF(np.full((*small_grid().shape, 1), -1.0), np.ones(1), small_grid())
    assert_array_equal(jb.resampling_error(before, unknown).relative_l2, 1)
    assert np.isnan(jb.resampling_error(before, unknown).median).all()
    half = replace(before, values=before.values * [1, -1])
    error = jb.resampling_error(half, LAMBERTIAN)
    assert_allclose(error.median, [0, np.nan], atol=1e-12)
    assert np.isnan(error.relative_l2[1])
    nothing = jb.resampling_error(replace(before, values=-before.values), LAMBERTIAN)
    assert nothing.pairs == 0
    assert np.isnan(nothing.relative_l2).all()


# Evaluation


@pytest.mark.parametrize("n", [0, 1, 37, 64])
def test_as_many_values_as_pairs(n):
    wi, wo = pairs(n)
    assert_allclose(evaluate(LAMBERTIAN, wi, wo), np.full((n, 1), 0.5 / np.pi), rtol=1e-12)
    colours = evaluate(jb.Lambertian(jnp.array([0.1, 0.2, 0.3])), wi, wo)
    assert_allclose(colours, np.broadcast_to([0.1, 0.2, 0.3], (n, 3)) / np.pi, rtol=1e-12)
    assert evaluate(samples(*pairs(30), np.ones((30, 2))), wi, wo, np.inf).shape == (n, 2)


def test_many_pairs_are_evaluated_in_their_order():
    n = 2**16 + 2**14 + 5
    wi, wo = pairs(n)
    phong = jb.Phong(3.0)
    some = np.random.default_rng(1).integers(0, n, 50)
    some[:3] = 2**16 - 1, 2**16, n - 1
    assert_allclose(evaluate(phong, wi, wo)[some, 0], phong(wi[some], wo[some]), rtol=1e-12)


def test_samples_are_nan_out_of_reach():
    wi, wo = pairs(50, lowest=0.8)
    scattered = samples(wi, wo, np.ones((50, 2)))
    wi[0] = np.sin(1.4), 0, np.cos(1.4)
    assert_array_equal(np.isnan(evaluate(scattered, wi, wo)), np.arange(50)[:, None] == [0, 0])
    assert_allclose(evaluate(scattered, wi, wo, np.inf), 1, rtol=1e-12)
