"""What fits to tables minimise: against scipy's likelihood and plain sums, with derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import poisson

from fitting.table_loss import TABLE_LOSSES, table_loss

DA, N = 0.01, 500  # area of a cell, normals
RNG = np.random.default_rng(0)
D = RNG.uniform(0.01, 3.0, 40)
COUNTS = np.concatenate([np.zeros(10), RNG.poisson(N * D[10:] * DA)])
T = COUNTS / (N * DA)


def half_square(loss, D, T, scale):
    r, _ = loss.residual_and_slope(jnp.asarray(D), jnp.asarray(T))
    return 0.5 * float(jnp.sum((scale * r) ** 2))


def test_likelihood_is_what_poisson_counts_lack_to_their_highest():
    loss = TABLE_LOSSES["likelihood"]
    lacks = poisson.logpmf(COUNTS, COUNTS) - poisson.logpmf(COUNTS, N * D * DA)
    (scale,) = loss.scale(T[None], DA)
    np.testing.assert_allclose(half_square(loss, D, T, scale), 100 * lacks.sum() / N, rtol=1e-12)


def test_area_weighted_is_a_share_of_what_the_table_holds():
    loss = TABLE_LOSSES["l2"]
    (scale,) = loss.scale(T[None], DA)
    expected = 50 * np.sum((D - T) ** 2) / np.sum(T**2)
    np.testing.assert_allclose(half_square(loss, D, T, scale), expected, rtol=1e-12)


@pytest.mark.parametrize("loss", TABLE_LOSSES.values(), ids=TABLE_LOSSES)
def test_slopes_are_derivatives_also_next_to_the_table(loss):
    """Where D nears T the deviance is a series: on both sides of the change, and at D = T itself."""
    near = np.array([0.0, 1e-12, -1e-6, 9.99e-4, -1.001e-3, 0.1, -0.5])
    density, table = np.append(D, 2 / (1 + near)), np.append(T, np.full(len(near), 2.0))
    _, slope = loss.residual_and_slope(jnp.asarray(density), jnp.asarray(table))
    h = 1e-5 * density
    up, down = (
        loss.residual_and_slope(jnp.asarray(d), jnp.asarray(table))[0] for d in (density + h, density - h)
    )
    np.testing.assert_allclose(slope, (up - down) / (2 * h), rtol=1e-6)
    through = jax.jvp(
        lambda d: loss.residual(d, jnp.asarray(table)), (jnp.asarray(density),), (jnp.ones(len(density)),)
    )[1]
    np.testing.assert_array_equal(through, slope)


@pytest.mark.parametrize("loss", TABLE_LOSSES.values(), ids=TABLE_LOSSES)
def test_cells_without_a_value_do_not_count(loss):
    r, slope = loss.residual_and_slope(jnp.array([1.0, 2.0]), jnp.array([np.nan, 1.0]))
    weight = loss.weight(jnp.array([1.0, 2.0]), jnp.array([np.nan, 1.0]))
    assert r[0] == slope[0] == weight[0] == 0
    assert r[1] != 0
    assert weight[1] > 0


def test_the_gradient_is_that_of_weighted_squares():
    """As `weight` says: Σ r dr/dD = Σ w (D − T)."""
    for loss in TABLE_LOSSES.values():
        r, slope = loss.residual_and_slope(jnp.asarray(D), jnp.asarray(T))
        np.testing.assert_allclose(
            r * slope, loss.weight(jnp.asarray(D), jnp.asarray(T)) * (D - T), rtol=1e-9
        )


def test_normals_where_a_density_underflows_are_a_great_loss():
    """And no reward, for which narrow distributions would be found elsewhere; its derivative is a number."""
    loss, T = TABLE_LOSSES["likelihood"], jnp.array([0.0, 2.0])
    r, slope = loss.residual_and_slope(jnp.zeros(2), T)
    assert abs(r[0]) < 1e-100
    assert -r[1] > np.sqrt(2 * 2 * 500)  # T log(T/D) of a D of e^-500
    assert np.isfinite(slope).all()


def test_a_count_below_nothing_has_no_likelihood():
    assert np.isnan(TABLE_LOSSES["likelihood"].residual(jnp.array([1.0]), jnp.array([-0.5])))[0]


def test_an_unknown_loss_is_explained():
    with pytest.raises(ValueError, match="l2, likelihood; found 'l3'"):
        table_loss("l3")
