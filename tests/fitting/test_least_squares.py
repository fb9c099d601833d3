"""Small least squares in batches, against scipy: non-negative, and Levenberg–Marquardt in lanes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import approx_fprime, least_squares, nnls

from fitting.least_squares import map_lanes, nonnegative_least_squares, solve_lanes

solve_all = jax.jit(jax.vmap(nonnegative_least_squares))


def random_problems(count=200, n=4, samples=12, seed=1):
    """A (count, samples, n), y (count, samples), of columns whose sizes differ by orders of magnitude."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(count, samples, n)) * 10 ** rng.uniform(-4, 4, (count, 1, n))
    return A, rng.normal(size=(count, samples))


def solved(A, y):
    return np.asarray(solve_all(np.einsum("bsn,bsm->bnm", A, A), np.einsum("bsn,bs->bn", A, y)))


def squares(A, x, y):
    return np.sum((np.einsum("bsn,bn->bs", A, x) - y) ** 2, axis=1)


@pytest.mark.parametrize("n", [1, 2, 4, 6])
def test_nonnegative_solutions_are_scipys(n):
    A, y = random_problems(n=n)
    expected = np.array([nnls(a, b)[0] for a, b in zip(A, y, strict=True)])
    size = np.linalg.norm(A, axis=1)
    if n > 1:
        assert 0.2 < np.mean(expected == 0) < 0.8
    assert_allclose(solved(A, y) * size, expected * size, rtol=1e-8, atol=1e-9)


def test_a_zero_row_stays_at_zero_and_the_others_are_scipys():
    A, y = random_problems(50)
    A[:, :, 2] = 0
    expected = np.array([nnls(a, b)[0] for a, b in zip(A[..., [0, 1, 3]], y, strict=True)])
    x, size = solved(A, y), np.linalg.norm(A, axis=1)
    assert_array_equal(x[:, 2], 0)
    assert_allclose((x * size)[:, [0, 1, 3]], expected * size[:, [0, 1, 3]], rtol=1e-8, atol=1e-9)


def test_collinear_columns_reach_the_least_sum_of_squares():
    """Which of them carries the weight is undetermined; the fit is not, nor its sign."""
    A, y = random_problems(50)
    A[:, :, 1] = 3 * A[:, :, 0]
    A[25:, :, 3] = A[25:, :, 0] + A[25:, :, 2]
    x = solved(A, y)
    assert np.all(x >= 0)
    assert_allclose(squares(A, x, y), [nnls(a, b)[1] ** 2 for a, b in zip(A, y, strict=True)], rtol=1e-6)


def test_where_every_projection_is_negative_the_solution_is_zero():
    A = np.abs(random_problems(20)[0])
    assert_array_equal(solved(A, -np.ones(A.shape[:2])), 0)


def test_gradient_is_the_finite_difference_while_the_active_set_stays():
    A, y = random_problems(6, seed=5)
    A /= np.linalg.norm(A, axis=1, keepdims=True)
    target = np.arange(1.0, 5.0)

    def value(A, y):
        return nonnegative_least_squares(A.T @ A, A.T @ y) @ target

    gradients = jax.jit(jax.vmap(jax.grad(value, (0, 1))))(A, y)
    for a, b, by_A, by_y in zip(A, y, *gradients, strict=True):
        assert_allclose(by_y, approx_fprime(b, lambda b, a=a: nnls(a, b)[0] @ target, 1e-7), atol=1e-5)
        numeric = approx_fprime(a.ravel(), lambda a, b=b: nnls(a.reshape(12, 4), b)[0] @ target, 1e-7)
        assert_allclose(by_A.ravel(), numeric, atol=1e-5)


TIMES = np.linspace(0, 3, 25)
LANES = 40


def decay(t, args):
    """Residuals of a e^{−b τ}, (a, b) = t; lane: the measured y and a weight."""
    (y, root_weight), tau = args
    return root_weight * (t[0] * jnp.exp(-t[1] * tau) - y)


def decay_in_numpy(t, y, root_weight):
    return root_weight * (t[0] * np.exp(-t[1] * TIMES) - y)


@pytest.fixture(scope="module")
def decays():
    """(truths, data): noisy decays, each with weights of its own."""
    rng = np.random.default_rng(2)
    truth = np.stack([rng.uniform(0.5, 2, LANES), rng.uniform(0.2, 4, LANES)], axis=1)
    y = truth[:, :1] * np.exp(-truth[:, 1:] * TIMES) + 0.05 * rng.normal(size=(LANES, len(TIMES)))
    return truth, (y, rng.uniform(0.5, 2, (LANES, len(TIMES))))


@pytest.fixture(scope="module")
def fitted(decays):
    return solve_lanes(decay, np.ones((LANES, 2)), decays[1], TIMES)


def test_lanes_find_scipys_minimum(decays, fitted):
    y, root_weight = decays[1]
    assert np.all(fitted.converged)
    for lane in range(LANES):
        truth = least_squares(
            decay_in_numpy, [1, 1], args=(y[lane], root_weight[lane]), xtol=1e-12, ftol=1e-14
        )
        assert_allclose(fitted.t[lane], truth.x, rtol=1e-3)
        assert_allclose(fitted.cost[lane], truth.cost, rtol=1e-6)


def test_lanes_without_noise_find_the_truth(decays):
    truth = decays[0]
    y = truth[:, :1] * np.exp(-truth[:, 1:] * TIMES)
    fit = solve_lanes(decay, np.ones((LANES, 2)), (y, np.ones_like(y)), TIMES)
    assert np.all(fit.converged)
    assert_allclose(fit.t, truth, rtol=1e-5)


@pytest.mark.parametrize("count", [1, 5, 17])
def test_a_lane_does_not_notice_how_many_others_there_are(decays, fitted, count):
    data = tuple(a[:count] for a in decays[1])
    fit = solve_lanes(decay, np.ones((count, 2)), data, TIMES)
    assert_allclose(fit.t, fitted.t[:count], rtol=1e-9)
    assert_allclose(fit.cost, fitted.cost[:count], rtol=1e-9)
    assert_array_equal(fit.steps, fitted.steps[:count])
    assert_array_equal(fit.converged, True)


def test_a_lane_of_nan_stops_nobody(decays, fitted):
    y, root_weight = decays[1]
    y = y.copy()
    y[7] = np.nan
    fit = solve_lanes(decay, np.ones((LANES, 2)), (y, root_weight), TIMES)
    others = np.arange(LANES) != 7
    assert not fit.converged[7]
    assert not np.isfinite(fit.cost[7])
    assert np.all(fit.converged[others])
    assert_allclose(fit.t[others], fitted.t[others], rtol=1e-9)


def test_slow_lanes_go_on_in_further_rounds(decays, fitted):
    """Rounds of six steps: what one round does not finish, the later ones do; and they have a limit."""
    start = np.ones((LANES, 2))
    short = solve_lanes(decay, start, decays[1], TIMES, steps_a_round=6, rounds=1)
    long = solve_lanes(decay, start, decays[1], TIMES, steps_a_round=6, rounds=20)
    assert not np.all(short.converged)
    assert np.all(long.converged)
    assert np.all(long.steps[~short.converged] > 6)
    assert_allclose(long.t, fitted.t, rtol=1e-3)


@pytest.mark.parametrize("count", [1, 4, 5, 16, 17, 33])
def test_mapping_over_lanes_pads_and_cuts(count):
    lanes = {"a": np.arange(count, dtype=float), "b": np.arange(2.0 * count).reshape(count, 2)}
    scaled, total = map_lanes(_scale_and_sum, lanes, np.array([2.0, 3.0]))
    assert isinstance(scaled, np.ndarray)
    assert_array_equal(scaled, lanes["b"] * [2.0, 3.0])
    assert_array_equal(total, lanes["a"] + lanes["b"].sum(axis=1))


def _scale_and_sum(lane, factors):
    return lane["b"] * factors, lane["a"] + jnp.sum(lane["b"])


def test_an_unknown_that_is_not_there_leaves_the_gradient_finite():
    """A lobe that underflows at every sample is a row of zeros; the solver still asks for derivatives."""

    def first(scale):
        A = jnp.array([[1.0, 2.0, 1.0], [0.0, 0.0, 0.0]]) * jnp.stack([scale, scale])[:, None]
        return nonnegative_least_squares(A @ A.T, A @ jnp.array([1.0, 1.0, 2.0]))[0]

    # x = (a·y) / (a·a) / scale with a·y = 5, a·a = 6.
    assert_allclose(jax.value_and_grad(first)(2.0), (5 / 12, -5 / 24), rtol=1e-12)


def test_a_lane_that_cannot_move_from_its_bound_has_converged():
    """Every step from its start leads outwards, or not below the minimum by more than rounding."""
    found = solve_lanes(_above_its_bound, np.zeros((2, 1)), np.array([1.0, 2.0]), None, (0, 1))
    assert_array_equal(found.t, 0)
    assert found.converged.all()


def _above_its_bound(t, args):
    return jnp.append(t + args[0], 1)
