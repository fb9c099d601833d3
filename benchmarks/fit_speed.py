r"""How fast is a batch of fits? All materials in one call, against loops of scipy and of jaxopt.

    python benchmarks/fit_speed.py FOLDER

FOLDER holds MERL files (*.binary). The model is Lambertian + factor · Microfacet(GGX, Schlick) under L2,
each channel of each material by itself. The rivals start where our batch starts, on the same residuals, whose
linear unknowns are solved for; a channel's best fit counts. scipy is given the jitted residual and Jacobian;
jaxopt is jitted as a whole. Compilation is left out of all times but the first call's, and so are files.
The last table is one material over its whole table: fitted to a subsample, then scored on all its cells.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares

from data_loaders import read_merl
from fitting import catalogue, fit_reflectance, fit_shifted_gamma
from fitting.catalogue import General
from fitting.lanes import Lanes, Shared, make_lanes
from fitting.lobes import lobe_starts, projected_residual, some_pairs
from fitting.losses import LOSSES
from fitting.minimize import jaxopt
from fitting.model_space import model_space
from fitting.observations import observe
from fitting.starts import lowest
from jaxbrdf import MeasuredBRDF, compare

LIMIT = float(np.deg2rad(80))


def seconds(work: Callable) -> tuple[float, object]:
    begin = time.perf_counter()
    result = work()
    return time.perf_counter() - begin, result


def problems(measured: list[MeasuredBRDF]) -> tuple[Lanes, Shared, np.ndarray, np.ndarray]:
    """What the batch solves: its lanes, what they share, and where each of its searches starts."""
    model = catalogue()["ggx"]
    assert isinstance(model, General)
    space, given, own = model_space(model.model)
    seen = observe(measured)
    lanes = make_lanes(seen, [LOSSES["l2"]], LIMIT, own)
    shared = Shared(space, jnp.asarray(seen.wi), jnp.asarray(seen.wo))
    count = len(lanes.enough)
    rows = some_pairs(lanes)
    few, shared_few = lanes.thinned(rows), shared.thinned(rows)
    lane, start = lobe_starts(few, shared_few.first_lobes(0), shared_few, np.zeros((count, 0)), 3)
    return (
        lanes,
        shared,
        np.append(lane, np.arange(count)),
        np.concatenate([start, np.tile(given, (count, 1))]),
    )


def by_scipy(lanes: Lanes, shared: Shared, lane: np.ndarray, start: np.ndarray) -> np.ndarray:
    """½ Σ r² where each search ended."""

    @eqx.filter_jit
    def residual(t, data):
        return projected_residual(t, (data, shared))

    @eqx.filter_jit
    def jacobian(t, data):
        return jax.jacfwd(projected_residual)(t, (data, shared))

    cost = []
    for k, t in zip(lane, start, strict=True):
        data = jnp.asarray(lanes.values[k]), jnp.asarray(lanes.projected[k]), []
        found = least_squares(
            lambda t, data: np.asarray(residual(t, data)),
            t,
            lambda t, data: np.asarray(jacobian(t, data)),
            bounds=(0, 1),
            xtol=1e-6,
            ftol=1e-6,
            gtol=1e-6,
            args=(data,),
        )
        cost.append(found.cost)
    return np.array(cost)


def by_jaxopt(lanes: Lanes, shared: Shared, lane: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The same by jaxopt, which has no bounds: t is clipped."""

    def residual(t, data):
        return projected_residual(jnp.clip(t, 0, 1), (data, shared))

    solver = jaxopt.LevenbergMarquardt(residual, tol=1e-6, maxiter=120)

    @eqx.filter_jit
    def fit(t, data):
        t = solver.run(t, data).params
        return jnp.sum(residual(t, data) ** 2) / 2

    cost = [
        float(fit(jnp.asarray(t), (jnp.asarray(lanes.values[k]), jnp.asarray(lanes.projected[k]), [])))
        for k, t in zip(lane, start, strict=True)
    ]
    return np.array(cost)


def batch_table(measured: list[MeasuredBRDF]) -> Table:
    model = catalogue()["ggx"].model
    first, _ = seconds(lambda: fit_reflectance(model, measured))
    ours, result = seconds(lambda: fit_reflectance(model, measured))
    cost = result.cost.ravel()
    args = problems(measured)
    table = Table("", "s", "time / ours", "largest cost / ours", "fits worse than ours", "ours worse")
    table.add_row("ours, first call", f"{first:.1f}", "", "", "", "")
    table.add_row(f"ours, warm ({cost.size} fits, {len(args[2])} searches)", f"{ours:.2f}", "1", "1", "", "")
    for name, rival in (("scipy", by_scipy), ("jaxopt", by_jaxopt)):
        rival(args[0], args[1], args[2][:1], args[3][:1])  # compiles
        taken, ends = seconds(lambda rival=rival: rival(*args))
        theirs = ends[lowest(ends, args[2], cost.size)]
        worse, better = np.sum(theirs > cost * (1 + 1e-4)), np.sum(cost > theirs * (1 + 1e-4))
        ratio = np.max(theirs / cost)
        table.add_row(
            f"{name}, warm", f"{taken:.1f}", f"{taken / ours:.1f}", f"{ratio:.3g}", str(worse), str(better)
        )
    return table


def whole_table(measured: MeasuredBRDF) -> Table:
    """One material: fitted, and scored on every cell."""
    model = catalogue()["ggx"].model
    fits = {
        "GGX": lambda: fit_reflectance(model, measured),
        "sgd, recipe 'full'": lambda: fit_shifted_gamma(measured, "full"),
    }
    table = Table(f"{measured.name}, warm", "fit, s", "score on all cells, s", "both, s")
    for name, fit in fits.items():
        fit()
        taken, result = seconds(fit)
        jax.block_until_ready(compare(result.model.tabulated(), measured))
        scored, _ = seconds(
            lambda result=result: jax.block_until_ready(compare(result.model.tabulated(), measured))
        )
        table.add_row(name, f"{taken:.2f}", f"{scored:.2f}", f"{taken + scored:.2f}")
    return table


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder of MERL files")
    args = parser.parse_args()
    measured = [read_merl(file) for file in sorted(args.folder.glob("*.binary"))]
    if not measured:
        parser.error(f"no MERL files (*.binary) in {args.folder}")
    console = Console(width=120)
    console.print(batch_table(measured))
    console.print(whole_table(measured[0]))


if __name__ == "__main__":
    main()
