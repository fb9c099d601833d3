"""Measurements made of models, on a grid small enough for many fits."""

import numpy as np

from jaxbrdf import MeasuredBRDF
from jaxbrdf.metrics import tabulate
from jaxbrdf.quadrature import HalfDifferenceGrid


def small_grid() -> HalfDifferenceGrid:
    """A grid of 30 × 15 × 12 cells, θ_h crowded at 0 as MERL's."""
    half = np.pi / 2
    edges = half * (np.arange(31) / 30) ** 2, half * np.arange(16) / 15, np.pi * np.arange(13) / 12
    centres = (half * ((np.arange(30) + 0.5) / 30) ** 2, *((e[1:] + e[:-1]) / 2 for e in edges[1:]))
    return HalfDifferenceGrid(*centres, *edges)


GRID = small_grid()


def table(brdf, name="made up", noise=0.0, grid=GRID) -> MeasuredBRDF:
    """A model tabulated, with relative noise; C channels."""
    f = np.asarray(tabulate(brdf, grid))
    f = f if f.ndim == 4 else f[..., None]
    f = f * (1 + noise * np.random.default_rng(3).standard_normal(f.shape))
    return MeasuredBRDF(f, np.ones(f.shape[-1]), grid, name=name)
