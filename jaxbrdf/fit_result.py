"""What a fit gives back: the model, and per fit how it went. Made by `fitting`, stored by `data_loaders`."""

import dataclasses
from enum import IntEnum

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int


class FitStatus(IntEnum):
    """How one fit ended; `FitStatus(code).message` says it in words."""

    CONVERGED = 0
    AT_BOUND = 1
    STEP_LIMIT = 2
    NO_LOBE = 3
    TOO_FEW_SAMPLES = 4
    NOT_FINITE = 5

    @property
    def message(self) -> str:
        return _MESSAGES[self]


_MESSAGES = {
    FitStatus.CONVERGED: "converged",
    FitStatus.AT_BOUND: "converged, with a shape parameter on its bound",
    FitStatus.STEP_LIMIT: "stopped at the step limit before it converged",
    FitStatus.NO_LOBE: "no lobe found above the diffuse part: the shape parameters mean nothing",
    FitStatus.TOO_FEW_SAMPLES: "too few valid samples to determine the parameters",
    FitStatus.NOT_FINITE: "the error or a parameter became infinite or NaN",
}


class FitResult(eqx.Module):
    r"""The record of one fit, of C channels fitted apart (...=C), or of a batch of materials (...=B, C).

    `model`       the fitted model, parameters (...); a batch is a model with leaves (B, C), for `jax.vmap`
    `status`      a FitStatus code for each fit
    `cost`        ½ Σ r² of the weighted residuals that were minimised last
    `steps`       Levenberg–Marquardt steps taken
    `covariance`  (..., n, n) of the n numbers named in `parameters`, in that order; NaN where it has none
    `residuals`   (..., N) model minus measurement in 1/sr over the slices (θ_h, then θ_d); NaN where unused
    `recipe`      what was minimised;  `names`  the materials, one for each row of a batch

    A fit that did not succeed is data, not an exception: look at `status`.
    """

    model: eqx.Module
    status: Int[Array | np.ndarray, "..."]
    cost: Float[Array | np.ndarray, "..."]
    steps: Int[Array | np.ndarray, "..."]
    covariance: Float[Array | np.ndarray, "... n n"]
    residuals: Float[Array | np.ndarray, "... N"]
    parameters: tuple[str, ...] = eqx.field(static=True)
    recipe: str = eqx.field(static=True, default="")
    names: tuple[str, ...] = eqx.field(static=True, default=())

    def __getitem__(self, index: int) -> "FitResult":
        """The fit of one material of a batch."""
        name = self.names[index : index + 1] if index >= 0 else (self.names[index],)
        leaves = jax.tree.map(lambda leaf: leaf[index], self)
        return dataclasses.replace(leaves, names=name)

    @property
    def success(self) -> np.ndarray:
        """Whether each fit converged, on a bound or not."""
        return np.asarray(np.asarray(self.status) <= FitStatus.AT_BOUND)
