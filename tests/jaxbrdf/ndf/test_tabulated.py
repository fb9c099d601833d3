"""Tables of a distribution over the disk, and tables of its projected area."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

import jaxbrdf as jb
from tests import references

N = 129


def cells(n):
    """m_x, m_y, m_z at the centres of an n × n table, m_z = 0 outside the disk."""
    m_x, m_y = ((2 * np.arange(n) + 1) / n - 1)[None, :], ((2 * np.arange(n) + 1) / n - 1)[:, None]
    m_x, m_y = np.broadcast_arrays(m_x, m_y)
    return m_x, m_y, np.sqrt(np.maximum(1 - m_x**2 - m_y**2, 0))


@eqx.filter_jit
def projected_area(ndf, w):
    return ndf.projected_area(w)


@eqx.filter_jit
def sample(ndf, u):
    return ndf.sample(u)


@eqx.filter_jit
def visible_sample(ndf, u, w):
    return ndf.sample_visible(u, w)


def tilted(n=N):
    """A table without symmetry, of the shifted gamma density tilted in slope space, NaN outside the disk."""
    m_x, m_y, m_z = cells(n)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope2 = (m_x / m_z - 0.3) ** 2 + (m_y / m_z + 0.1) ** 2 / 0.25
        D = np.exp(-slope2 / 0.1) / m_z**4
    return np.where(m_z > 0, D, np.nan)


@pytest.fixture(scope="module")
def table():
    return jb.TabulatedNDF(np.nan_to_num(tilted()))


def test_density_looks_up_the_cell_of_the_normal(table):
    """values[i, j] stands at m_x = (2j+1)/N − 1, m_y = (2i+1)/N − 1: x runs along a row."""
    m = np.stack(cells(N), axis=-1)
    inside = m[..., 2] > 0
    assert_allclose(table(m[inside]), tilted()[inside])
    assert float(table(jb.spherical(0.3, 0.0))) > 20 * float(table(jb.spherical(0.3, np.pi)))


def test_the_middle_cell_of_an_odd_table_is_centred_on_the_normal():
    values = np.zeros((5, 5))
    values[2, 2] = 7.0
    table = jb.TabulatedNDF(values)
    assert float(table(jnp.array([0.0, 0.0, 1.0]))) == 7.0
    edge = np.arcsin(0.2)
    assert float(table(jb.spherical(edge - 1e-6, 0.0))) == 7.0
    assert float(table(jb.spherical(edge + 1e-6, 0.0))) == 0.0


def test_below_the_horizon_there_is_nothing(table):
    m_x, m_y, m_z = cells(N)
    m = np.stack([m_x, m_y, -m_z], axis=-1)[m_z > 0]
    assert_array_equal(table(m), 0)


def test_projected_area_is_the_sum_over_cells(table):
    """σ(w) = Σ (w·m)+ D dA / m_z, in plain loops over the cells, above and below the horizon."""
    m_x, m_y, m_z = cells(N)
    inside = m_z > 0
    m = np.stack([m_x, m_y, m_z], axis=-1)[inside]
    weight = tilted()[inside] * (2 / N) ** 2 / m_z[inside]
    w = references.direction(np.array([0.0, 0.7, 1.4, np.pi / 2, 2.0, np.pi]), np.linspace(-2, 3, 6))
    expected = [sum(max(x @ normal, 0) * share for normal, share in zip(m, weight, strict=True)) for x in w]
    sigma = projected_area(table, jnp.asarray(w))
    assert_allclose(sigma, expected, rtol=1e-11, atol=1e-13)
    assert_allclose(projected_area(table, -jnp.asarray(w)), sigma - w @ (m.T @ weight), atol=1e-11)


def test_what_stands_outside_the_disk_is_ignored(table):
    poisoned = jb.TabulatedNDF(tilted())  # NaN there
    assert np.isnan(poisoned.values).any()
    w = jb.spherical(jnp.array([0.2, 1.2]), 0.5)
    u = jnp.linspace(0, 0.99, 20).reshape(10, 2)
    rim = jb.spherical(np.pi / 2 - 1e-9, jnp.linspace(0, 2 * jnp.pi, 300))  # in cells whose centre is outside
    assert np.any(np.linalg.norm(np.floor(np.asarray(rim)[:, :2] * N / 2 + 0.5) * 2 / N, axis=-1) > 1)
    for a, b in [
        (poisoned(rim), table(rim)),
        (projected_area(poisoned, w), projected_area(table, w)),
        (sample(poisoned, u), sample(table, u)),
    ]:
        assert_array_equal(a, b)


def test_samples_fall_into_cells_as_their_values(table):
    """χ² over the blocks of a coarser grid; the probability of a cell is D dA."""
    m = np.asarray(sample(table, jax.random.uniform(jax.random.key(5), (50_000, 2))))
    assert_allclose(np.linalg.norm(m, axis=-1), 1, atol=1e-14)
    assert chi_squared(m, np.nan_to_num(tilted())) > 1e-3


def chi_squared(m, weight):
    """The probability of a histogram over the blocks of a coarser grid as far off as that of normals m."""
    borders = np.array([0, 50, 58, 64, 70, 76, 82, 88, 95, N])
    counts, _, _ = np.histogram2d(m[:, 1], m[:, 0], [2 * borders / N - 1] * 2)
    share = np.add.reduceat(np.add.reduceat(weight, borders[:-1], 0), borders[:-1], 1)
    expected = len(m) * share / share.sum()
    many = expected > 5
    assert many.sum() >= 10
    return chi2.sf(np.sum((counts - expected)[many] ** 2 / expected[many]), many.sum() - 1)


@pytest.mark.parametrize("theta", [0.0, 1.0, 1.5, 2.0])
def test_visible_samples_fall_into_cells_as_a_direction_sees_them(table, theta):
    """The probability of a cell is (w·m)+ D dA / m_z; the plain samples are not of it."""
    w = references.direction(theta, 0.6)
    u = jax.random.uniform(jax.random.key(6), (20_000, 2))
    m = np.asarray(visible_sample(table, u, jnp.asarray(w)))
    assert_allclose(np.linalg.norm(m, axis=-1), 1, atol=1e-14)
    m_x, m_y, m_z = cells(N)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = np.where(m_z > 0, np.maximum(w @ [m_x.ravel(), m_y.ravel(), m_z.ravel()], 0).reshape(N, N), 0)
        weight = np.where(m_z > 0, seen * tilted() / m_z, 0)
    assert chi_squared(m, weight) > 1e-3
    if theta > 0:
        assert chi_squared(np.asarray(sample(table, u)), weight) < 1e-6


def test_visible_samples_of_many_directions_are_those_of_each(table):
    u = jax.random.uniform(jax.random.key(7), (6, 2))
    w = jb.spherical(jnp.linspace(0.1, 2, 6), 0.3)
    each = [visible_sample(table, u[k], w[k]) for k in range(6)]
    assert_allclose(visible_sample(table, u, w), each, atol=1e-14)


def test_samples_never_hit_an_empty_cell():
    values = np.zeros((9, 9))
    values[4, 2] = values[6, 5] = 1.0
    tiny = 1e-12  # on the very border between two cells rounding decides
    u = np.stack(np.meshgrid([tiny, 0.2, 0.5 - tiny, 0.5 + tiny, 1 - tiny], [tiny, 0.5, 1 - tiny]), axis=-1)
    u = u.reshape(-1, 2)
    m = sample(jb.TabulatedNDF(values), jnp.asarray(u))
    assert_array_equal(jb.TabulatedNDF(values)(m), 1)


def test_a_table_of_the_shifted_gamma_distribution_has_its_area_and_its_samples():
    alpha, p, n = 0.1, 0.6, 257
    density = references.sgd(alpha, p)
    m_x, m_y, m_z = cells(n)
    table = jb.TabulatedNDF(density(np.stack([m_x, m_y, m_z], axis=-1)))
    assert_allclose(np.sum(table.values) * (2 / n) ** 2, 1, rtol=1e-3)
    w = references.direction(np.array([0.0, 0.6, 1.2, 1.5]), 0.4)
    expected = [references.projected_area(density, x) for x in w]
    assert_allclose(projected_area(table, jnp.asarray(w)), expected, rtol=2e-3)
    u = jax.random.uniform(jax.random.key(1), (20_000, 2))
    tilt = [np.asarray(sample(ndf, u))[:, 2].mean() for ndf in (table, jb.ShiftedGamma(alpha, p))]
    assert_allclose(*tilt, atol=4e-3)


def test_gradients_by_the_values_and_the_direction_are_finite(table):
    w = jnp.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.0, 0.8]])

    def total(table, w):
        return jnp.sum(projected_area(table, w))

    by_values = jax.jit(jax.grad(total))(table, w).values
    m_x, m_y, m_z = cells(N)
    share = np.where(m_z > 0, (2 / N) ** 2 / np.where(m_z > 0, m_z, 1), 0)
    facing = sum(np.maximum(x[0] * m_x + x[1] * m_y + x[2] * m_z, 0) for x in np.asarray(w))
    assert_allclose(by_values, facing * share, atol=1e-14)
    assert np.all(np.isfinite(jax.jit(jax.grad(total, 1))(table, w)))


def test_channels_trail(table):
    rgb = jb.TabulatedNDF(jnp.stack([table.values, 2 * table.values], axis=-1))
    m = jb.spherical(jnp.array([0.1, 0.5, 1.0]), 0.3)
    assert_allclose(rgb(m), jnp.stack([table(m), 2 * table(m)], axis=-1))
    assert sample(rgb, jnp.full((4, 2), 0.3)).shape == (4, 3, 2)


# Tables of a window


@pytest.fixture(scope="module")
def window():
    """A table of a window of the disk, and the same cells amid a table of the whole disk."""
    values = np.random.default_rng(8).random((33, 33))
    whole = np.zeros((N, N))
    whole[48:81, 48:81] = values
    return jb.TabulatedNDF(values, (33 / N, 33 / N)), jb.TabulatedNDF(whole)


def test_a_window_is_the_middle_of_a_table_of_the_disk(window):
    small, whole = window
    m = jb.spherical(jnp.linspace(0, 1.5, 200)[:, None], jnp.linspace(0.01, 6.2, 40))
    assert_array_equal(small(m), whole(m))
    assert 0.02 < np.mean(np.asarray(small(m)) > 0) < 0.5
    w = jb.spherical(jnp.linspace(0, 3.1, 9), 0.7)
    assert_allclose(projected_area(small, w), projected_area(whole, w), rtol=1e-11, atol=1e-14)
    u = jax.random.uniform(jax.random.key(3), (500, 2))
    assert_allclose(sample(small, u), sample(whole, u), atol=1e-10)
    assert_allclose(visible_sample(small, u, w[4]), visible_sample(whole, u, w[4]), atol=1e-10)


def test_a_window_whose_corners_leave_the_disk():
    """Looked up, summed and drawn from in plain numpy; NaN outside the disk is ignored."""
    n, extent = 20, np.array([0.9, 0.6])
    values = 0.2 + np.random.default_rng(9).random((n, n))
    m_x, m_y = np.meshgrid(*(e * cells(n)[0][0] for e in extent))
    inside = m_x**2 + m_y**2 < 1
    table = jb.TabulatedNDF(np.where(inside, values, np.nan), tuple(extent.tolist()))
    normals = references.direction(*np.random.default_rng(10).random((2, 3000)) * [[1.5], [6.28]])
    j, i = np.floor((normals[:, :2] + extent) / (2 * extent / n)).astype(int).T
    within = (i >= 0) & (i < n) & (j >= 0) & (j < n)
    i, j = np.where(within, i, 0), np.where(within, j, 0)
    assert_array_equal(table(normals), np.where(within & inside[i, j], values[i, j], 0))
    assert 0.1 < np.mean(within) < 0.9

    m = np.stack([m_x, m_y, np.sqrt(1 - np.minimum(m_x**2 + m_y**2, 1))], axis=-1)[inside]
    weight = values[inside] * (1.8 / n) * (1.2 / n)
    w = references.direction(1.1, 0.8)
    assert_allclose(projected_area(table, w), np.sum(np.maximum(m @ w, 0) * weight / m[:, 2]), rtol=1e-11)

    drawn = np.asarray(sample(table, jax.random.uniform(jax.random.key(4), (50_000, 2))))
    counts = np.histogram2d(drawn[:, 1], drawn[:, 0], n, [[-0.6, 0.6], [-0.9, 0.9]])[0]
    full = np.hypot(np.abs(m_x) + 0.9 / n, np.abs(m_y) + 0.6 / n) < 1  # no corner to be drawn back from
    expected = 50_000 * values / values[inside].sum()
    assert counts.sum() == 50_000
    assert chi2.sf(np.sum((counts - expected)[full] ** 2 / expected[full]), full.sum()) > 1e-3


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_samples_of_a_window_never_hit_an_empty_cell(dtype):
    rng = np.random.default_rng(11)
    values = (rng.random((65, 65)) < 0.1).astype(dtype)
    table = jb.TabulatedNDF(values, (0.013, 0.37))
    u = rng.random((4000, 2))
    u[:2000, 0] = rng.integers(0, values.sum(), 2000) / values.sum()  # the very borders between two cells
    u[1000:3000, 1] = rng.choice([0, 1 - np.finfo(dtype).epsneg], 2000)
    m = sample(table, jnp.asarray(u, dtype))
    assert_array_equal(eqx.filter_jit(jb.TabulatedNDF._density)(table, m), 1)


@pytest.mark.parametrize("extent", [(0.5, 0.0), (-0.5, 1.0), (0.5, 1.01), (np.nan, 1.0), (0.5,)])
def test_a_window_outside_the_disk_is_refused(extent):
    with pytest.raises(ValueError, match="extent must be two numbers, each greater than 0 and at most 1"):
        jb.TabulatedNDF(np.ones((5, 5)), extent)


# The projected area in a table

ALPHA, P = (jnp.asarray(a.ravel()) for a in np.meshgrid(np.geomspace(1e-5, 1, 6), [0.0, 0.5, 1.0, 1.5, 2.0]))
ANGLES = np.concatenate([np.linspace(0, np.pi / 2, 301), np.pi / 2 - np.geomspace(1e-8, 0.5, 300)])


@pytest.fixture(scope="module")
def area_with_slope():
    """σ and ∂σ/∂α of all lobes at all angles, exact (as tested against brute force) and from the table."""
    w = jb.spherical(jnp.asarray(ANGLES), 0.3)

    def evaluate(prepare):
        def area(alpha, p):
            return prepare(jb.ShiftedGamma(alpha, p)).projected_area(w)

        return jax.jit(jax.vmap(lambda a, p: jax.jvp(lambda a: area(a, p), (a,), (jnp.ones_like(a),))))(
            ALPHA, P
        )

    return evaluate(lambda ndf: ndf), evaluate(jb.tabulate_projected_area)


def test_tabulated_area_is_as_accurate_as_stated(area_with_slope):
    (exact, by_alpha), (table, table_by_alpha) = area_with_slope
    assert np.max(np.abs(table / exact - 1)) < 5e-7
    assert np.max(np.abs(table_by_alpha - by_alpha) * ALPHA[:, None] / exact) < 1e-5


@pytest.mark.parametrize(
    ("ndf", "nodes", "error"),
    [
        (jb.GaussianMicrofacets(0.1, 0.2), (10, 20), 2e-2),  # the paper's 200 nodes
        (jb.GaussianMicrofacets(0.1, 0.2), (33, 64), 1e-4),
        (jb.Beckmann(0.05, 0.5), None, 2e-4),
        (jb.Ellipsoid(0.1, 0.5, 0.3, 0.2, 0.7), None, 2e-5),
        (jb.SlantedVelvet(0.7, 0.5), None, 5e-4),
        (jb.Velvet(0.5), None, 1e-10),
    ],
    ids=lambda x: type(x).__name__ if isinstance(x, jb.AbstractNDF) else str(x),
)
def test_tabulated_areas_of_all_azimuths(ndf, nodes, error):
    """Relative error of σ above the horizon, absolute below; and not better than stated by far."""
    theta = np.concatenate([np.linspace(0, np.pi / 2, 31), np.pi / 2 - np.geomspace(1e-7, 0.3, 30)])
    phi = np.concatenate([np.linspace(-np.pi, np.pi, 24), np.geomspace(0.004, 0.3, 12)])
    w = references.direction(theta[:, None], phi[None])
    table = jb.tabulate_projected_area(ndf, nodes)
    above, below = (projected_area(ndf, v) for v in (w, -w))
    found = np.max(np.abs(projected_area(table, w) / above - 1))
    assert error / 50 < found < error
    assert np.max(np.abs(projected_area(table, -w) - below)) < error
    assert table.is_isotropic == ndf.is_isotropic


def test_a_table_of_fewer_nodes_is_less_accurate():
    """The accuracy does hang on the nodes: sixth order, so half of them cost a factor of about 64."""
    w, ndf = jb.spherical(jnp.asarray(ANGLES), 0.0), jb.ShiftedGamma(0.5, 0.5)
    exact = projected_area(ndf, w)
    errors = [
        np.max(np.abs(projected_area(jb.tabulate_projected_area(ndf, (n, 1)), w) / exact - 1))
        for n in (37, 73)
    ]
    assert 24 < errors[0] / errors[1] < 160


def test_tabulated_area_of_an_rgb_distribution():
    alpha = jnp.array([0.01, 0.1, 0.4])
    table = jb.tabulate_projected_area(jb.ShiftedGamma(alpha, 0.7))
    w = jb.spherical(jnp.array([[0.1, 0.9], [1.3, 1.55]]), 0.2)
    assert table.area.shape[2:] == (3,)
    expected = np.stack([projected_area(jb.ShiftedGamma(a, 0.7), w) for a in alpha], axis=-1)
    assert_allclose(projected_area(table, w), expected, rtol=1e-6)
    assert_allclose(table(w), jb.ShiftedGamma(alpha, 0.7)(w))


def test_a_table_of_a_table_is_that_table(table):
    """Tables over the disk have no symmetry; σ of one is looked up like any other's."""
    w = references.direction(np.array([0.3, 0.9, 1.4, 1.9]), np.array([0.0, 1.0, 2.0, 3.0]))
    fast = jb.tabulate_projected_area(table, (33, 64))
    assert_allclose(projected_area(fast, w), projected_area(table, w), rtol=2e-3)
    assert_allclose(fast(w), table(w))
    u = jnp.linspace(0.1, 0.9, 8).reshape(4, 2)
    assert_allclose(sample(fast, u), sample(table, u))
