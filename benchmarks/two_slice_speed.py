r"""How fast is the two-slice fit? Our batched call against a loop of scipy.optimize.least_squares.

    python benchmarks/two_slice_speed.py FOLDER [--repeat N]

FOLDER holds MERL files (*.binary); only their slices are read. Both sides minimise the same step-1 error,
with ρ_d and F_r projected out, from the same starts, the minima on the same grid of shapes. The loop runs
scipy's method 'lm' on the jitted residual and the jitted Jacobian with exact masking: about as well as a
loop can do. Our call does more: it also searches the grid, solves step 2 with exact masking and returns
covariances and residuals. Shown are the times of one run, compilation and tables apart, and how the two
costs compare, both evaluated with exact masking. For scale: the paper reports 2.5 minutes a material.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares

from data_loaders import read_merl_slices
from fitting import fit_shifted_gamma
from fitting.parameters import ShapeSpace
from fitting.starts import lowest
from fitting.two_slice import exact_residual, slice_lanes, slice_samples, starts
from jaxbrdf import ShiftedGamma, Slices


def timed(function: Callable, repeat: int) -> tuple[float, object]:
    """The median seconds of `repeat` calls, and the last result."""
    seconds = []
    for _ in range(repeat):
        begin = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds)), result


def scipy_loop(slices: list[Slices]) -> Callable[[], np.ndarray]:
    """A function that fits every lane in a loop and gives back all t, (L, n); compiled before it returns."""
    lanes, (back, _) = slice_lanes(slices), slice_samples(ShapeSpace(ShiftedGamma), slices[0])
    lane, start = starts(lanes, back)
    residual = jax.jit(lambda t, v, w: exact_residual(t, ((v, w), back)))
    jacobian = jax.jit(jax.jacfwd(lambda t, v, w: exact_residual(t, ((v, w), back))))
    data = [(jnp.asarray(lanes.values_h[i]), jnp.asarray(lanes.weight_h[i])) for i in lane]
    jax.block_until_ready((residual(start[0], *data[0]), jacobian(start[0], *data[0])))

    def fit(t, args):
        options = {"method": "lm", "xtol": 1e-6, "ftol": 1e-8, "args": args}
        return least_squares(residual, t, jacobian, **options)

    def loop():
        found = [fit(t, args) for t, args in zip(start, data, strict=True)]
        best = lowest(np.array([f.cost for f in found]), lane, len(lanes.enough))
        return np.stack([found[i].x for i in best])

    return loop


def exact_costs(slices: list[Slices], t: np.ndarray) -> np.ndarray:
    """½ Σ r² of step 1 at the shapes t, with exact masking, (L,)."""
    lanes, (back, _) = slice_lanes(slices), slice_samples(ShapeSpace(ShiftedGamma), slices[0])
    residual = jax.jit(jax.vmap(lambda t, v, w: exact_residual(t, ((v, w), back))))
    return np.sum(np.asarray(residual(t, lanes.values_h, lanes.weight_h)) ** 2, axis=1) / 2


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of MERL files")
    parser.add_argument(
        "--repeat", type=int, default=5, help="timed calls of ours; the loop runs a third of them"
    )
    args = parser.parse_args()
    slices = [read_merl_slices(file) for file in sorted(args.folder.glob("*.binary"))]
    if not slices:
        parser.error(f"no MERL files (*.binary) in {args.folder}")

    space = ShapeSpace(ShiftedGamma)
    first, _ = timed(lambda: fit_shifted_gamma(slices, "slices"), 1)
    warm, ours = timed(lambda: fit_shifted_gamma(slices, "slices"), args.repeat)
    loop = scipy_loop(slices)
    seconds, theirs = timed(loop, max(1, args.repeat // 3))
    t = space.shape_of(ours.model.ndf).reshape(-1, len(space.names))
    excess = exact_costs(slices, t) / exact_costs(slices, theirs) - 1

    table = Table("", "seconds", "ratio", title=f"{len(slices)} materials, {len(t)} fits")
    table.add_row("ours, first call (compilation, tables)", f"{first:.2f}", "")
    table.add_row("ours, warm", f"{warm:.3f}", "1")
    table.add_row("scipy loop, warm", f"{seconds:.3f}", f"{seconds / warm:.1f}")
    table.add_row(
        "the paper, 2.5 minutes a material", f"{150 * len(slices):.0f}", f"{150 * len(slices) / warm:.0f}"
    )
    console = Console(width=110)
    console.print(table)
    console.print(
        f"cost against scipy's: largest excess {excess.max():.1e}, worse by more than 1e-6 on "
        f"{(excess > 1e-6).sum()}, better by more than 1e-6 on {(excess < -1e-6).sum()}; "
        f"not converged: {(~ours.success).sum()}"
    )


if __name__ == "__main__":
    main()
