"""What fits to tables minimise: against scipy's likelihood and plain sums, with derivatives."""

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


def minimised(loss, D, T):
    scale = float(loss.scale(jnp.asarray(T), DA))
    return 0.5 * scale**2 * float(jnp.sum(loss.loss(jnp.asarray(D), jnp.asarray(T))))


def test_likelihood_is_what_poisson_counts_lack_to_their_highest():
    lacks = poisson.logpmf(COUNTS, COUNTS) - poisson.logpmf(COUNTS, N * D * DA)
    np.testing.assert_allclose(minimised(TABLE_LOSSES["likelihood"], D, T), 100 * lacks.sum() / N, rtol=1e-12)


def test_area_weighted_is_a_share_of_what_the_table_holds():
    expected = 50 * np.sum((D - T) ** 2) / np.sum(T**2)
    np.testing.assert_allclose(minimised(TABLE_LOSSES["l2"], D, T), expected, rtol=1e-12)


@pytest.mark.parametrize("loss", TABLE_LOSSES.values(), ids=TABLE_LOSSES)
def test_derivatives(loss):
    """By differences of ℓ; `weight` is the curvature that is expected: that at T = D."""
    h = 1e-4 * D
    low, at, high = (np.asarray(loss.loss(jnp.asarray(d), jnp.asarray(T))) for d in (D - h, D, D + h))
    weight, curvature = (np.asarray(f(jnp.asarray(D), jnp.asarray(T))) for f in (loss.weight, loss.curvature))
    np.testing.assert_allclose(weight * (D - T), (high - low) / (4 * h), rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(curvature, (high - 2 * at + low) / (2 * h**2), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(loss.curvature(jnp.asarray(D), jnp.asarray(D)), weight)


@pytest.mark.parametrize("loss", TABLE_LOSSES.values(), ids=TABLE_LOSSES)
def test_cells_without_a_value_do_not_count(loss):
    D, T = jnp.array([1.0, 2.0]), jnp.array([np.nan, 1.0])
    for part in (loss.loss, loss.weight, loss.curvature):
        missing, known = part(D, T)
        assert missing == 0
        assert known > 0


def test_a_table_is_its_own_best():
    for loss in TABLE_LOSSES.values():
        np.testing.assert_allclose(loss.loss(jnp.asarray(T), jnp.asarray(T)), 0, atol=1e-15)


def test_a_gram_is_made_of_all_cells():
    J = RNG.standard_normal((40, 3))
    for loss in TABLE_LOSSES.values():
        parts = [np.asarray(part(jnp.asarray(D), jnp.asarray(T))) for part in (loss.weight, loss.loss)]
        gram = loss.gram(jnp.asarray(D), jnp.asarray(T), jnp.asarray(J), jnp.array([2.0]))
        columns = np.concatenate([J, (D - T)[:, None]], axis=1)
        expected = 4 * columns.T @ (parts[0][:, None] * columns)
        expected[3, 3] = 4 * parts[1].sum()
        np.testing.assert_allclose(gram, expected, rtol=1e-12)


def test_normals_where_a_density_underflows_are_a_great_loss():
    """And no reward, for which narrow distributions would be found elsewhere; its derivatives are numbers."""
    loss, T = TABLE_LOSSES["likelihood"], jnp.array([0.0, 2.0])
    nothing, much = loss.loss(jnp.zeros(2), T)
    assert nothing == 0
    assert much > 2 * 2 * 200  # T log(T/D) of a D of e^-200
    assert np.isfinite(loss.weight(jnp.zeros(2), T)).all()
    assert np.isfinite(loss.curvature(jnp.zeros(2), T)).all()


def test_a_count_below_nothing_has_no_likelihood():
    assert np.isnan(TABLE_LOSSES["likelihood"].loss(jnp.array([1.0]), jnp.array([-0.5])))[0]


def test_an_unknown_loss_is_explained():
    with pytest.raises(ValueError, match="l2, likelihood; found 'l3'"):
        table_loss("l3")
