"""A fit as plain Python types, for JSON: the numbers people and scripts read; store.py keeps the whole."""

import math
from typing import SupportsFloat

import jax
import numpy as np

from data_loaders.provenance import Source, provenance
from jaxbrdf import FitResult, FitStatus


def fit_to_json(result: FitResult, source: Source = None) -> dict:
    """A record of a fit for `json.dumps`; NaN and infinity, which JSON lacks, become None.

    `fits` has one entry for each material and channel: its `name` and `channel` (None where there is
    none), `status` with its `message`, `cost`, `steps`, and `parameters`, each with its `value` and its
    `standard_error` from the covariance (None where that does not exist). Tables inside a model are
    left out. `source` names the measured files.
    """
    result = jax.tree.map(np.asarray, result)
    values = _parameters(result)
    errors = dict.fromkeys(values, np.full(result.status.shape, np.nan)) | _standard_errors(result)
    return {
        "model": type(result.model).__name__,
        "recipe": result.recipe,
        "fits": [_fit(result, values, errors, index) for index in np.ndindex(result.status.shape)],
        "provenance": {key: v if isinstance(v, str) else list(v) for key, v in provenance(source).items()},
    }


def _fit(result: FitResult, values: dict, errors: dict, index: tuple[int, ...]) -> dict:
    """The fit at `index`, which is (), (channel,) or (material, channel)."""
    status = FitStatus(int(result.status[index]))
    material = index[0] if len(index) > 1 else 0
    return {
        "name": result.names[material] if result.names else None,
        "channel": index[-1] if index else None,
        "status": status.name,
        "message": status.message,
        "cost": _number(result.cost[index]),
        "steps": int(result.steps[index]),
        "parameters": {
            name: {"value": _number(value[index]), "standard_error": _number(errors[name][index])}
            for name, value in values.items()
        },
    }


def _parameters(result: FitResult) -> dict[str, np.ndarray]:
    """The model's parameters by name ("alpha", "ndf.alpha"), each of the shape of the fits."""
    shape = result.status.shape
    leaves, _ = jax.tree_util.tree_flatten_with_path(result.model)
    named = {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}
    return {
        name: np.broadcast_to(leaf, shape) for name, leaf in named.items() if _one_each(leaf.shape, shape)
    }


def _one_each(shape: tuple[int, ...], fits: tuple[int, ...]) -> bool:
    """Whether an array of `shape` has one number for each fit, or for several: whether it is not a table."""
    return len(shape) <= len(fits) and all(n in (1, m) for n, m in zip(shape[::-1], fits[::-1], strict=False))


def _standard_errors(result: FitResult) -> dict[str, np.ndarray]:
    """The standard error of each parameter of the covariance, by name; NaN where it has none."""
    variance = np.diagonal(result.covariance, axis1=-2, axis2=-1)
    error = np.sqrt(np.where(variance >= 0, variance, np.nan))
    return {name: error[..., k] for k, name in enumerate(result.parameters)}


def _number(value: SupportsFloat) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None
