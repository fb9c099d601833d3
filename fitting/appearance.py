"""Fits judged by how they look: the closest of several, and one brought as close as it can be."""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float

from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.fit_result import FitResult
from jaxbrdf.preview import Appearance
from jaxbrdf.resampling import Measurement, as_table
from jaxbrdf.samples import MeasuredSamples
from jaxbrdf.scene import lit_sphere


def appearance(measured: Measurement) -> Appearance:
    """How a measurement looks as a lit sphere; scattered samples as a table of them."""
    table = as_table(measured) if isinstance(measured, MeasuredSamples) else measured
    return Appearance.of(table, lit_sphere())


def differences(
    results: Sequence[FitResult], measured: Measurement | Sequence[Measurement]
) -> Float[np.ndarray, "R B"]:
    """ΔE*_ab of every result with each of its materials; NaN where a channel's fit is no result."""
    materials = [measured] if isinstance(measured, Measurement) else list(measured)
    rows = []
    for b, material in enumerate(materials):
        seen = appearance(material)
        each = [result if isinstance(measured, Measurement) else result[b] for result in results]
        rows.append([float(seen.difference(_model(one).tabulated())) for one in each])
    return np.array(rows).T


def closest_picture(results: Sequence[FitResult], measured: Measurement | Sequence[Measurement]) -> FitResult:
    """Of each material the result whose lit sphere is closest, put together; `recipe` names the losses."""
    best = np.argmin(np.nan_to_num(differences(results, measured), nan=np.inf), axis=0)
    if isinstance(measured, Measurement):
        return dataclasses.replace(results[best[0]], recipe=f"image: {results[best[0]].recipe}")
    chosen = [results[k][b] for b, k in enumerate(best)]
    alike = [dataclasses.replace(one, recipe="", names=()) for one in chosen]
    together = jax.tree.map(lambda *leaves: np.stack(leaves), *alike)
    recipes = ", ".join(one.recipe for one in chosen)
    names = tuple(name for one in chosen for name in one.names)
    return dataclasses.replace(together, recipe=f"image: {recipes}", names=names)


def _model(result: FitResult) -> AbstractBRDF:
    assert isinstance(result.model, AbstractBRDF)
    return result.model
