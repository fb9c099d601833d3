"""How fits ended, and a word on the precision they ran in."""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbrdf.fit_result import FitResult, FitStatus


class Outcome(NamedTuple):
    """Of each lane, or in whatever shape the lanes are brought: what a `FitResult` is made of."""

    numbers: Float[np.ndarray, "... n"]
    status: Int[np.ndarray, "..."]
    cost: Float[np.ndarray, "..."]
    steps: Int[np.ndarray, "..."]
    covariance: Float[np.ndarray, "... n n"]
    residuals: Float[np.ndarray, "... N"]

    def without_residuals(self) -> "Outcome":
        """Of many fits residuals are as large as all that was measured."""
        return self._replace(residuals=np.zeros((*np.shape(self.status), 0)))

    def result(self, model: eqx.Module, names: tuple[str, ...], recipe: str) -> FitResult:
        """The record of it; `numbers` are those of the model."""
        _, status, cost, steps, covariance, residuals = self
        return FitResult(model, status, cost, steps, covariance, residuals, names, recipe)


def joined(parts: Sequence[Outcome]) -> Outcome:
    """The outcomes of lanes that were fitted some at a time."""
    return Outcome(*[np.concatenate(part) for part in zip(*parts, strict=True)])


def statuses(
    *,
    enough: Bool[np.ndarray, " L"],
    finite: Bool[np.ndarray, " L"],
    no_lobe: Bool[np.ndarray, " L"],
    converged: Bool[np.ndarray, " L"],
    on_bound: Bool[np.ndarray, " L"],
) -> Int[np.ndarray, " L"]:
    """The FitStatus of each lane: the first of its troubles, in the order of the arguments."""
    cases = {
        FitStatus.TOO_FEW_SAMPLES: ~enough,
        FitStatus.NOT_FINITE: ~finite,
        FitStatus.NO_LOBE: no_lobe,
        FitStatus.STEP_LIMIT: ~converged,
        FitStatus.AT_BOUND: on_bound,
    }
    return np.select(list(cases.values()), list(cases), FitStatus.CONVERGED)


def means_nothing(status: Int[np.ndarray, " L"]) -> Bool[np.ndarray, " L"]:
    """Whether the parameters of a fit are no result at all."""
    return np.isin(status, (FitStatus.TOO_FEW_SAMPLES, FitStatus.NOT_FINITE))


def warn_of_float32() -> None:
    """A warning where JAX runs in single precision."""
    if not jax.config.read("jax_enable_x64"):
        warnings.warn(
            "fitting in float32: expect fewer digits and fits that do not converge; "
            "call jax.config.update('jax_enable_x64', True) first",
            stacklevel=3,
        )
