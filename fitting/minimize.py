"""Bounded minima of any differentiable number, by jaxopt's L-BFGS-B: the one module that knows jaxopt."""

import warnings
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # jaxopt says that it is no longer developed
    import jaxopt


class Minimum(NamedTuple):
    """Where the minimum is, (n,), what the objective is there, iterations made, and whether it converged."""

    z: Float[Array, " n"]
    value: Float[Array, ""]
    steps: int
    converged: bool


def minimize(
    objective: Callable[[Float[Array, " n"]], Float[Array, ""]],
    start: Float[Array, " n"],
    low: Float[Array, " n"],
    high: Float[Array, " n"],
    *,
    tolerance: float = 1e-5,
    max_steps: int = 200,
) -> Minimum:
    """The least value of an objective for low ≤ z ≤ high, from a start within; ±∞ is no bound.

    Byrd, Lu, Nocedal & Zhu 1995. It has converged where the projected gradient is below `tolerance`, so z
    and the objective should be of order one. What comes back is never worse than the start.
    """
    solver = jaxopt.LBFGSB(objective, tol=tolerance, maxiter=max_steps)
    z, state = solver.run(start, bounds=(low, high))
    value, before = jax.jit(jax.vmap(objective))(jnp.stack([z, start]))
    if not value <= before:  # also where it is NaN
        return Minimum(start, before, int(state.iter_num), False)
    return Minimum(z, value, int(state.iter_num), bool(state.error <= tolerance))
