r"""How near does the closed form of masking come to Smith's? Our (λ, c, k) against the published ones.

    python benchmarks/masking_approximation.py [--all] [--csv FILE]

For each of the 300 rows (100 MERL materials × RGB) of Bagher et al. 2012, `fitting.fit_masking` and the
published (λ, c, k) are held against the exact G1 by three measures of e(θ) = G1 approximated − G1 exact:

    L2            √∫ e² dθ    over [0, π/2], θ in radians
    L2²           ∫ e² dθ     what is minimised
    mean square   (2/π) ∫ e² dθ

and by max |e|. The paper says "L2 error mostly below 1e-5" without a formula: the first table counts the
rows below 1e-5 in each measure; the second shows every 20th row in the order of alpha, or all (--all).
The exact G1 comes from `smith_G1`; the integrals from 1,000 nodes that are not the fit's.
"""

import argparse
import csv
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from data_loaders import published_materials, published_parameters
from fitting import fit_masking
from jaxbrdf import ShiftedGamma, ShiftedGammaShadowing, smith_G1, spherical

LIMIT = 1e-5
MEASURES = ("L2", "L2²", "mean square", "max |e|")


def read() -> tuple[list[str], dict[str, np.ndarray]]:
    """Names of the rows, and their columns (300,)."""
    materials = published_materials("sgd")
    rows = [published_parameters("sgd", material) for material in materials]
    names = [f"{material} {channel}" for material in materials for channel in "RGB"]
    return names, {k: np.concatenate([row[k] for row in rows]) for k in ("alpha", "p", "lambda", "c", "k")}


def angles() -> tuple[np.ndarray, np.ndarray]:
    """θ with π/2 − θ = (π/2) r⁴, r Gauss–Legendre nodes; weights of ∫ dθ."""
    x, weight = np.polynomial.legendre.leggauss(1000)
    r = (1 + x) / 2
    return np.pi / 2 * (1 - r**4), np.pi * r**3 * weight


def errors(shadowing: ShiftedGammaShadowing, exact: np.ndarray) -> np.ndarray:
    """The four measures of each row, (rows, 4)."""
    theta, weight = angles()
    e = np.asarray(jax.vmap(lambda s: s.G1(jnp.cos(theta)))(shadowing)) - exact
    square = np.sum(weight * e**2, axis=1)
    return np.stack([np.sqrt(square), square, square * 2 / np.pi, np.abs(e).max(axis=1)], axis=1)


def exact_masking(ndf: ShiftedGamma) -> np.ndarray:
    w = spherical(angles()[0], 0.0)
    return np.asarray(jax.jit(lambda rows: jax.lax.map(lambda one: smith_G1(one, w), rows))(ndf))


def print_counts(ours: np.ndarray, theirs: np.ndarray) -> None:
    table = Table("measure", "whose", f"below {LIMIT:g}", "smallest", "median", "90 %", "largest")
    for m, measure in enumerate(MEASURES):
        for whose, e in (("ours", ours[:, m]), ("published", theirs[:, m])):
            numbers = [f"{np.quantile(e, q):.3g}" for q in (0, 0.5, 0.9, 1)]
            table.add_row(measure, whose, f"{np.sum(e < LIMIT)} of {len(e)}", *numbers)
    Console(width=120).print(table)


def print_rows(names, ndf, shadowing, ours, theirs, every: int) -> None:
    table = Table("row", "alpha", "p", "λ", "c", "k", "θ_0", "L2 ours", "L2 published", "ratio")
    for i in np.argsort(np.asarray(ndf.alpha))[::every]:
        values = (ndf.alpha, ndf.p, shadowing.lam, shadowing.c, shadowing.k, shadowing.theta_0)
        mine, other = ours[i, 0], theirs[i, 0]
        numbers = [f"{float(v[i]):.3g}" for v in values] + [f"{mine:.2e}", f"{other:.2e}"]
        table.add_row(names[i], *numbers, f"{mine / other:.3f}")
    Console(width=150).print(table)


def write_csv(path: Path, names, shadowing, ours, theirs) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        measures = ("l2", "l2_squared", "mean_square", "max")
        writer.writerow(
            [
                "row",
                "lambda",
                "c",
                "k",
                *(f"{m}_{whose}" for whose in ("ours", "published") for m in measures),
            ]
        )
        for i, name in enumerate(names):
            fitted = (float(v[i]) for v in (shadowing.lam, shadowing.c, shadowing.k))
            writer.writerow([name, *fitted, *ours[i], *theirs[i]])


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--all", action="store_true", help="show all rows")
    parser.add_argument("--csv", type=Path, help="write every row's parameters and errors here")
    args = parser.parse_args()
    names, columns = read()
    ndf = ShiftedGamma(columns["alpha"], columns["p"])
    exact = exact_masking(ndf)
    seconds = []
    for _ in range(2):
        begin = time.perf_counter()
        shadowing = fit_masking(ndf)
        seconds.append(time.perf_counter() - begin)
    theirs = ShiftedGammaShadowing(columns["lambda"], columns["c"], columns["k"])
    ours, other = errors(shadowing, exact), errors(theirs, exact)
    print_counts(ours, other)
    print_rows(names, ndf, shadowing, ours, other, every=1 if args.all else 20)
    ratio = ours[:, 0] / other[:, 0]
    print(
        f"L2 ours / published: median {np.median(ratio):.3f}, from {ratio.min():.3f} to {ratio.max():.6f}; "
        f"smaller by more than 1 % in {np.sum(ratio < 0.99)} of {len(ratio)}"
    )
    print(f"{len(names)} fits: {seconds[0]:.1f} s with compilation, {seconds[1]:.1f} s again")
    if args.csv:
        write_csv(args.csv, names, shadowing, ours, other)


if __name__ == "__main__":
    main()
