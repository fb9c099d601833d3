r"""Many small least-squares problems at once: Levenberg–Marquardt, and non-negative linear ones.

A *lane* is one problem. Lanes are solved in blocks of a fixed size, one compilation for any number of
them. Levenberg–Marquardt runs in short rounds, after which only the lanes that have not converged are
gathered and run again, so that nobody waits for the slowest.
"""

from collections.abc import Callable
from functools import lru_cache
from itertools import product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

_BLOCKS = (1, 4, 16)  # lanes: one, one material alone, or many
_SINGULAR = 1e-14  # what is added to a Gram matrix of unit diagonal, whose rounding may make it indefinite
_INSIDE = 0.01  # how far from a bound a t is set that should not be on it


class LaneSolutions(eqx.Module):
    """Of each lane: the minimum found, ½ Σ r² there, the steps taken, and whether it converged."""

    t: Float[np.ndarray, "L n"]
    cost: Float[np.ndarray, " L"]
    steps: Int[np.ndarray, " L"]
    converged: Bool[np.ndarray, " L"]


def nonnegative_least_squares(
    gram: Float[Array, "n n"], projection: Float[Array, " n"]
) -> Float[Array, " n"]:
    r"""The x ≥ 0 that minimises ½ xᵀ G x − bᵀ x, with G = A Aᵀ and b = A y: at most 6 unknowns.

    Exact and free of iterations: every set of active unknowns is solved, and of the solutions that are
    non-negative the lowest is taken. Differentiable wherever that set does not change. An unknown whose
    row of A is zero stays at 0.
    """
    n = projection.shape[0]
    active = jnp.asarray(list(product([0.0, 1.0], repeat=n)), projection.dtype)
    squares = jnp.diagonal(gram)
    scale = jnp.sqrt(jnp.where(squares > 0, squares, 1))
    G = gram / jnp.outer(scale, scale) + 1e-14 * jnp.eye(n, dtype=gram.dtype)
    b = projection / scale

    def solve(G, b, mask):
        return _solve_small(jnp.outer(mask, mask) * G + jnp.diag(1 - mask), mask * b)

    # Which set is best has no derivative: only the one solution that is kept is differentiated.
    x = jax.vmap(solve, (None, None, 0))(*jax.lax.stop_gradient((G, b)), active)
    cost = jnp.where(jnp.all(x >= 0, axis=1), -x @ jax.lax.stop_gradient(b), jnp.inf)
    return solve(G, b, active[jnp.argmin(cost)]) / scale


def _solve_small(G, b):
    """G⁻¹ b by Gauss–Jordan without pivoting, for G positive definite with a unit diagonal.

    Unrolled, it fuses over lanes, where LAPACK would be called once for each of them.
    """
    M = jnp.concatenate([G, b[:, None]], axis=1)
    for k in range(len(b)):
        row = M[k] / M[k, k]
        M = (M - M[:, k : k + 1] * row[None, :]).at[k].set(row)
    return M[:, -1]


def solve_lanes(
    residual: Callable[[Array, Any], Array],
    start: Float[np.ndarray, "L n"],
    lanes: Any,
    shared: Any = None,
    bounds: tuple[ArrayLike, ArrayLike] = (-np.inf, np.inf),
    *,
    steps_a_round: int = 12,
    rounds: int = 10,
    tolerance: float = 1e-6,
) -> LaneSolutions:
    """Minimise ½ ‖residual(t, (lane, shared))‖² for each lane by Levenberg–Marquardt, low ≤ t ≤ high.

    `start` (L, n); `lanes` is a pytree of arrays with a leading axis L, `shared` one that all lanes read;
    `bounds` are numbers or (n,). Residuals should be of order one and t free of units: damping is λ I and
    starts at λ = 1. A t that steps beyond a bound counts as on it and stays there for the round; where the
    error then falls inwards, it is set back inside for the next. A lane has converged where a step, or the
    next one without damping, is below the tolerance.
    """
    limits = steps_a_round, rounds, tolerance
    return solve_grams(_gram_of(residual), start, lanes, shared, bounds, None, *limits)


def solve_grams(
    gram: Callable[[Array, Any], Array],
    start: Float[np.ndarray, "L n"],
    lanes: Any,
    shared: Any = None,
    bounds: tuple[ArrayLike, ArrayLike] = (-np.inf, np.inf),
    block: int | None = None,
    steps_a_round: int = 12,
    rounds: int = 10,
    tolerance: float = 1e-6,
) -> LaneSolutions:
    """`solve_lanes` of residuals r with Jacobians J of which only gram(t, (lane, shared)) = [J r]ᵀ[J r],
    (n + 1, n + 1), is at hand: (the curvature, the gradient; the gradient, twice the value) of any function
    for whose curvature there is a positive estimate. `block` is how many lanes run at once, if not a few.
    """
    t, n = np.array(start), start.shape[1]
    low, high = (np.broadcast_to(np.asarray(bound, float), n) for bound in bounds)
    cost, steps = np.full(len(t), np.nan), np.zeros(len(t), int)
    converged = np.zeros(len(t), bool)
    open_lanes = np.arange(len(t))
    for _ in range(rounds):
        if not len(open_lanes):
            break
        chosen = (t[open_lanes], _rows(lanes, open_lanes))
        found = map_lanes(_one_round(gram, steps_a_round, tolerance), chosen, (shared, low, high), block)
        t[open_lanes], freed = _set_back(found[0], found[4], low, high)
        cost[open_lanes] = found[1]
        steps[open_lanes] += found[2]
        converged[open_lanes] = found[3]
        open_lanes = open_lanes[(~found[3] | freed) & np.isfinite(found[1])]
    return LaneSolutions(np.clip(t, low, high), cost, steps, converged)


def _set_back(t, gradient, low, high):
    """The same t, but a little inside the bound that it is beyond wherever the error falls inwards; and
    for which lanes that is so."""
    below, above = (t < low) & (gradient < 0), (t > high) & (gradient > 0)
    t = np.where(below, low + _INSIDE, np.where(above, high - _INSIDE, t))
    return t, np.any(below | above, axis=1)


@lru_cache
def _one_round(gram, max_steps, tolerance):
    solver = optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance)

    def factor(t, args):
        data, (shared, low, high) = args
        free = jnp.append((t >= low) & (t <= high), True)  # the derivative of clip
        return _factor(gram(jnp.clip(t, low, high), (data, shared)) * jnp.outer(free, free))

    few = _compressed(factor)

    def solve(lane, shared):
        t, data = lane
        found = optx.least_squares(
            few, solver, t, (data, shared), {"jac": "fwd"}, max_steps=max_steps, throw=False
        )
        _, low, high = shared
        # On a bound, as clip's derivative beyond it is 0; the sign is all that matters.
        R = factor(jnp.clip(found.value, low, high), (data, shared))
        cost, gradient = R[:, -1] @ R[:, -1] / 2, R[:, :-1].T @ R[:, -1]
        # Next to a minimum no step may lower the error by more than rounding: it is the next step that tells.
        at_low, at_high = found.value <= low, found.value >= high
        held = (at_low & (gradient > 0)) | (at_high & (gradient < 0))
        near = jnp.all(jnp.abs(_undamped_step(R, held)) < tolerance)
        done = (found.result == optx.RESULTS.successful) | near
        return found.value, cost, found.stats["num_steps"], done, gradient

    return solve


def _undamped_step(R, held):
    """The step to where Jᵀr = 0, were J constant; 0 for what is held."""
    J = jnp.where(held[None, :], 0, R[:, :-1])
    size = jnp.sqrt(jnp.sum(J**2, axis=0))
    scale = jnp.where(size > 0, size, 1)
    G = (J.T @ J) / jnp.outer(scale, scale) + jnp.diag(jnp.where(size > 0, _SINGULAR, 1))
    return _solve_small(G, J.T @ R[:, -1] / scale) / scale


@lru_cache
def _gram_of(residual):
    """[J r]ᵀ[J r] of N residuals r of n unknowns."""

    def gram(t, args):
        J, r = jax.jacfwd(lambda t: (residual(t, args),) * 2, has_aux=True)(t)
        columns = jnp.concatenate([J.T, r[None, :]])
        return columns @ columns.T

    return gram


def _factor(gram):
    """R, upper triangular, with RᵀR = [J r]ᵀ[J r]."""
    squares = jnp.diagonal(gram)
    scale = jnp.sqrt(jnp.where(squares > 0, squares, 1))
    correlation = gram / jnp.outer(scale, scale) + _SINGULAR * jnp.eye(len(scale), dtype=gram.dtype)
    return _cholesky(correlation).T * (scale * (squares > 0))[None, :]


def _cholesky(matrix):
    """L, lower triangular, with L Lᵀ the matrix; where r is shorter than what J makes of it, which only a
    Gram matrix can be that is an estimate, the last row is what r should be at least."""
    L = jnp.linalg.cholesky(matrix[:-1, :-1])
    row = jax.scipy.linalg.solve_triangular(L, matrix[:-1, -1], lower=True)
    last = jnp.sqrt(jnp.maximum(matrix[-1, -1] - row @ row, 0))
    return jnp.block([[L, jnp.zeros((len(L), 1), L.dtype)], [row[None, :], last[None, None]]])


def _compressed(factor):
    r"""n + 1 numbers that Levenberg–Marquardt cannot tell from N residuals r: the last column of R.

    A step asks for JᵀJ, Jᵀr and ‖r‖ alone, and R's other columns J̃ and last one r̃ have the same. They are
    all that the solver then carries along, where the linearisation of a large residual would be dozens of
    arrays of its size.
    """

    @jax.custom_jvp
    def few(t, args):
        return factor(t, args)[:, -1]

    @few.defjvp
    def _(primals, tangents):
        R = factor(*primals)
        return R[:, -1], R[:, :-1] @ tangents[0]

    return few


def map_lanes(function: Callable, lanes: Any, shared: Any = None, block: int | None = None) -> Any:
    """`jax.vmap(function, (0, None))(lanes, shared)`, block by block; numpy arrays come back.

    The last block is filled up with copies of the last lane.
    One block at a time: XLA itself spreads a block over the cores, and two programs that it runs at once on
    the CPU were seen to wait for each other for ever (jaxlib 0.10.2).
    """
    count = len(jax.tree.leaves(lanes)[0])
    size = block or _block_size(count)
    compiled = _compiled(function)
    blocks = [_rows(lanes, np.minimum(np.arange(i, i + size), count - 1)) for i in range(0, count, size)]
    done = [jax.tree.map(np.asarray, compiled(lane_block, shared)) for lane_block in blocks]
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *done)


def _block_size(lanes):
    """The smallest block that holds all lanes, or the largest: each size is compiled once."""
    return next((size for size in _BLOCKS if size >= lanes), _BLOCKS[-1])


@lru_cache
def _compiled(function):
    return eqx.filter_jit(jax.vmap(function, (0, None)))


def _rows(lanes, which):
    """Some of the lanes; without copying where they lie side by side."""
    at = slice(which[0], which[-1] + 1) if which[-1] - which[0] + 1 == len(which) else which
    return jax.tree.map(lambda a: np.asarray(a)[at], lanes)


def with_rows(array: np.ndarray, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """An array with some of its rows replaced."""
    array = array.copy()
    array[rows] = values
    return array
