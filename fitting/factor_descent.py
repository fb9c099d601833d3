r"""Levenberg–Marquardt for free factors: one channel, every node at once, in logarithms.

Minimised is log E² + xᵀ P x over x = log (ρ_d, D, F, G1), with E² = Σ w (φ(f) − φ(m))². Gauss–Newton's matrix
of log E² is JᵀJ / E²: the penalty counts as much for a good fit as for a bad one.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.sparse import block_diag, csr_array

from fitting.factor_cells import Sums
from fitting.losses import Loss

_STEPS = 100
_TOLERANCE = 2e-4  # two steps in a row that gain less, a ten-thousandth of E, are the end
_LONGEST = 2.0  # change of a logarithm in one step
_EXACT = 1e-14  # E² relative to that of no reflectance at all; what is lower is exact
_FACTORS = (0.1, 1.0, 1.0)  # of the penalty: D is what varies most


class Problem(NamedTuple):
    """What one channel is fitted to: m in N cells, and the weights w, with Σ w φ(m)² = 1."""

    sums: Sums
    loss: Loss
    values: Float[np.ndarray, " N"]
    weight: Float[np.ndarray, " N"]
    penalty: csr_array

    def factors(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        """ρ_d, D, F, G1."""
        rho_d, D, F, G1 = np.split(np.exp(x), np.cumsum([1, *self.sums.sizes[:2]]))
        return float(rho_d[0]), D, F, G1

    def residual(self, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """φ(f) − φ(m), and φ'(f)."""
        r, slope = _residual(self.loss, f, self.values, self.sums.cells.cos_i)
        return np.asarray(r), np.asarray(slope)

    def error(self, x: np.ndarray) -> float:
        """E², relative."""
        rho_d, *factors = self.factors(x)
        r, _ = self.residual(rho_d / np.pi + self.sums.lobe(*factors)[0])
        return float(np.sum(self.weight * r**2))

    def objective(self, x: np.ndarray) -> float:
        return np.log(self.error(x) + _EXACT) + x @ (self.penalty @ x)


class Descent(NamedTuple):
    """Where the descent ended and E² there, the objective at each step, and whether that was a minimum."""

    x: Float[np.ndarray, " n"]
    error: float
    objective: list[float]
    converged: bool


def make_penalty(sizes: tuple[int, ...], smoothness: float) -> csr_array:
    r"""P (n, n) of xᵀ P x = μ Σ_factors c Σ (x_{k+1} − x_k)²; that of ρ_d is 0."""
    differences = [np.diff(np.eye(n), axis=0) for n in sizes]
    blocks = [smoothness * c * d.T @ d for c, d in zip(_FACTORS, differences, strict=True)]
    return csr_array(block_diag([np.zeros((1, 1)), *blocks]))


def descend(problem: Problem, x: Float[np.ndarray, " n"]) -> Descent:
    """From x down; the objective falls at every step that is taken."""
    damping, growth, idle = 1e-2, 4.0, 0
    history = [problem.objective(x)]
    gradient, matrix = _linearised(problem, x)
    while len(history) <= _STEPS and np.isfinite(history[-1]) and idle < 2:
        damped = matrix + np.diag(damping * np.diag(matrix) + 1e-10)
        step = np.clip(-np.asarray(_solve(damped, gradient)), -_LONGEST, _LONGEST)
        objective = problem.objective(x + step)
        if objective < history[-1]:
            idle = idle + 1 if history[-1] - objective < _TOLERANCE else 0
            x, damping, growth = x + step, max(damping / 5, 1e-7), 4.0
            gradient, matrix = _linearised(problem, x)
        else:
            damping, growth = damping * growth, 2 * growth
            idle = 2 if damping > 1e10 else idle  # no way down is left
        history.append(min(objective, history[-1]))
    return Descent(x, problem.error(x), history, idle >= 2)


def nowhere(x: Float[np.ndarray, " n"]) -> Descent:
    """No descent: there is nothing to fit."""
    return Descent(x, np.nan, [np.nan], False)


def _linearised(problem: Problem, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half the gradient of the objective and half of Gauss–Newton's matrix."""
    sums, weight = problem.sums, problem.weight
    rho_d, D, F, G1 = problem.factors(x)
    s, *g = sums.lobe(D, F, G1)
    r, slope = problem.residual(rho_d / np.pi + s)
    w, wr = weight * slope**2, weight * slope * r
    error = np.sum(weight * r**2) + _EXACT
    gradient = np.concatenate([[wr.sum() * rho_d / np.pi], sums.project(wr * s, G1, *g)])
    upper = np.zeros((len(x), len(x)))
    upper[0, 0] = w.sum() * (rho_d / np.pi) ** 2
    upper[0, 1:] = sums.project(w * s, G1, *g) * rho_d / np.pi
    upper[1:, 1:] = sums.gram(w * s**2, G1, *g)
    gram = np.triu(upper) + np.triu(upper, 1).T
    return gradient / error + problem.penalty @ x, gram / error + problem.penalty.toarray()


@jax.jit
def _solve(matrix: Float[Array, "n n"], vector: Float[Array, " n"]) -> Float[Array, " n"]:
    """matrix⁻¹ vector by Gauss–Jordan without pivoting, for a positive definite matrix.

    LAPACK takes 0.6 ms for n = 226 where it has all cores to itself, but its threads wait for each other for
    100 to 250 ms where it has not; this takes 4 to 10 ms anywhere.
    """

    def eliminate(k, M):
        row = M[k] / M[k, k]
        return (M - M[:, k][:, None] * row[None, :]).at[k].set(row)

    M = jnp.concatenate([matrix, vector[:, None]], axis=1)
    return jax.lax.fori_loop(0, len(vector), eliminate, M)[:, -1]


@eqx.filter_jit
def _residual(loss: Loss, f, m, cos_i):
    f, m, cos_i = (jnp.asarray(a) for a in (f, m, cos_i))
    return loss.transformed(f, cos_i) - loss.transformed(m, cos_i), loss.slope(f, cos_i)
