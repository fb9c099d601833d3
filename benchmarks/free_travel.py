r"""How far does Sun's free-travel probability hold? The formula, its integral, and traced profiles.

    python benchmarks/free_travel.py [--rays N] [--csv FILE] [--figure FILE]

Redraws Fig. 7 of Sun 2002 (--figure): Γ_0(θ) of eq. 3.4.23 against the share of rays that escape at polar
angle θ from points at mean height of random Gaussian profiles, s = τ/σ from 0.1 to 5. Three counts:

    by length    each point counts by the horizontal length at that height, as eq. 3.4.4 conditions on the
                 height alone; a ray that starts into the surface is blocked
    by crossing  each point where the profile crosses mean height counts once, as the paper picked them
    facing       by length, but only of points that face the ray: what multiplies a distribution of facets

The first table has all of them where the formula is .9, .7, .5, .3 and .1, from the rays of all s together,
for the six curves are one in s cot θ. The second has for each s the mean and the largest absolute difference
over θ = 1° … 89°: between Γ_0, the integral that eq. 3.4.18 simplifies ("quadrature"), and the counts; and
between the product Γ_0 Γ_0, the mean ⟨Γ(h, θ_l) Γ(h, θ_v)⟩ over the heights h that eq. 3.5.2 replaces by it
(by quadrature, over all pairs of angles), and traced mirror pairs: θ_l = θ_v, opposite azimuths, flat facets.

Lengths are in τ, heights in σ. A profile is a periodic Gaussian process of correlation exp(−x²), 32 points a
unit and 128 units long, made by FFT and conditioned exactly on height or slope at its first point, by taking
off a multiple of their covariance. A ray escapes if it is steeper than every line from its start to the
profile: one number a ray, the steepest of these lines, serves every angle.
"""

import argparse
import csv
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from jaxbrdf.shadowing import FreeTravel

SMOOTHNESS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0)
THETA = np.radians(np.arange(1, 90))
STEP, LENGTH = 1 / 32, 128
COUNTS = ("by length", "by crossing", "facing")


def profiles(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Heights of periodic profiles (count, points), and their slopes at the first point (count,)."""
    points = round(LENGTH / STEP)
    k = 2 * np.pi * np.fft.rfftfreq(points, STEP)
    amplitude = np.exp(-(k**2) / 8) * np.sqrt(np.sqrt(np.pi) / LENGTH / 2) * points
    waves = amplitude * (rng.standard_normal((count, k.size)) + 1j * rng.standard_normal((count, k.size)))
    waves[:, 0] = np.sqrt(2) * waves[:, 0].real
    slope = np.sum(-2 * k * waves.imag, axis=1) / points
    return np.fft.irfft(waves, points, axis=1), slope


def steepest(z: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The steepest line from the first point of each profile to any other, or along it there; (count,)."""
    half = z.shape[1] // 2
    x = STEP * np.arange(1, half)
    return np.maximum(slope, np.max((z[:, 1:half] - z[:, :1]) / x, axis=1))


def both_ways(z: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`steepest` towards growing and towards falling x."""
    return steepest(z, slope), steepest(np.roll(z[:, ::-1], 1, axis=1), -slope)


def trace(rng: np.random.Generator, rays: int, chunk: int = 100) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(limit, slope, pair): slopes that free rays exceed, and of the ground they start from; (rays,) each.

    From mean height; `pair` (rays / 2,) from flat facets of any height, for rays both ways.
    """
    x = STEP * np.arange(round(LENGTH / STEP))
    x = np.minimum(x, LENGTH - x) * np.where(x < LENGTH / 2, 1, -1)
    limits, slopes, pairs = [], [], []
    for _ in range(rays // (2 * chunk)):
        z, slope = profiles(rng, chunk)
        limits += both_ways(z - np.exp(-(x**2)) * z[:, :1], slope)
        slopes += [slope, -slope]
        flat = both_ways(z - x * np.exp(-(x**2)) * slope[:, None], np.zeros(chunk))
        pairs.append(np.maximum(*flat))
    return np.concatenate(limits), np.concatenate(slopes), np.concatenate(pairs)


def escaping(limit: np.ndarray, slope: np.ndarray, steepness: np.ndarray) -> np.ndarray:
    """The share of rays that escape at each steepness s cot θ, in each of the COUNTS; (3, angles)."""
    free, facing = limit < steepness[:, None], slope < steepness[:, None]
    crossings = np.abs(slope) / np.sum(np.abs(slope))
    return np.stack([free.mean(axis=1), free @ crossings, free.sum(axis=1) / facing.sum(axis=1)])


@jax.jit
def probability_from(s: float, height: np.ndarray, cos_theta: np.ndarray) -> jax.Array:
    return FreeTravel(s).probability_from(height, cos_theta)


def mean_product(s: float) -> np.ndarray:
    """⟨Γ(h, θ_l) Γ(h, θ_v)⟩ over Gaussian heights by Gauss–Hermite quadrature, (angles, angles)."""
    h, weight = np.polynomial.hermite_e.hermegauss(40)
    probability = np.asarray(probability_from(s, h[:, None], np.cos(THETA)[None, :]))
    return np.einsum("h,hl,hv->lv", weight / weight.sum(), probability, probability)


def curves(s: float, rays: tuple[np.ndarray, np.ndarray, np.ndarray]) -> dict[str, np.ndarray]:
    """All that is known of one smoothness at each angle, (angles,); products also (angles, angles)."""
    limit, slope, pair = rays
    steepness = s / np.tan(THETA)
    formula = np.asarray(FreeTravel(s).probability(np.cos(THETA)))
    return {
        "formula": formula,
        "quadrature": np.asarray(probability_from(s, 0.0, np.cos(THETA))),
        **dict(zip(COUNTS, escaping(limit, slope, steepness), strict=True)),
        "mean product": mean_product(s),
        "traced pair": np.mean(pair < steepness[:, None], axis=1),
    }


def differences(c: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What the second table shows, by column."""
    product, mirror = np.outer(c["formula"], c["formula"]), c["formula"] ** 2
    return {
        **{f"Γ_0 − {count}": c["formula"] - c[count] for count in COUNTS},
        "quadrature − by length": c["quadrature"] - c["by length"],
        "quadrature − facing": c["quadrature"] - c["facing"],
        "Γ_0 Γ_0 − ⟨Γ Γ⟩": product - c["mean product"],
        "Γ_0 Γ_0 − traced pair": mirror - c["traced pair"],
        "⟨Γ Γ⟩ − traced pair": np.diag(c["mean product"]) - c["traced pair"],
    }


def print_levels(limit: np.ndarray, slope: np.ndarray) -> None:
    steepness = np.geomspace(1e-2, 1e2, 100_001)
    theta = np.arctan(1 / steepness)
    formula = np.asarray(FreeTravel(1.0).probability(np.cos(theta)))
    at = steepness[np.searchsorted(formula, [0.9, 0.7, 0.5, 0.3, 0.1])]
    quadrature = np.asarray(probability_from(1.0, 0.0, np.cos(np.arctan(1 / at))))
    table = Table("s cot θ", "Γ_0", "quadrature", *COUNTS)
    for a, q, counts in zip(at, quadrature, escaping(limit, slope, at).T, strict=True):
        gamma = np.interp(a, steepness, formula)
        table.add_row(f"{a:.3f}", *(f"{v:.3f}" for v in (gamma, q, *counts)))
    Console(width=120).print(table)


def print_differences(results: dict[float, dict[str, np.ndarray]]) -> None:
    columns = list(differences(next(iter(results.values()))))
    table = Table("s", *columns, title="mean and largest difference")
    for s, c in results.items():
        table.add_row(
            f"{s:g}", *(f"{np.mean(np.abs(d)):.3f} {np.max(np.abs(d)):.3f}" for d in differences(c).values())
        )
    Console(width=150).print(table)


def write_csv(path: Path, results: dict[float, dict[str, np.ndarray]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        names = ["formula", "quadrature", *COUNTS, "mean product", "traced pair"]
        writer.writerow(["s", "theta_degrees", *(name.replace(" ", "_") for name in names)])
        for s, c in results.items():
            columns = (np.diag(c[name]) if c[name].ndim == 2 else c[name] for name in names)
            for theta, *values in zip(np.degrees(THETA), *columns, strict=True):
                writer.writerow([s, round(theta), *values])


def draw(path: Path, results: dict[float, dict[str, np.ndarray]]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4), layout="constrained")
    degrees = np.degrees(THETA)
    styles = {
        "formula": {"linewidth": 4, "alpha": 0.4, "label": "formula"},
        "by length": {"linewidth": 1, "label": "traced, by length"},
        "facing": {"linestyle": ":", "label": "traced, facing"},
    }
    for i, (s, c) in enumerate(results.items()):
        color = plt.get_cmap("viridis")(i / len(results))
        for name, style in styles.items():
            axes.plot(degrees, c[name], color=color, **(style if i == 0 else style | {"label": None}))
        x = np.interp(-0.5, -c["formula"], degrees)
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1}
        axes.text(x, 0.5, f"s = {s:g}", color=color, ha="center", va="center", fontsize=8, bbox=box)
    axes.set(xlabel="θ / degree", ylabel="free-travel probability", xlim=(0, 90), ylim=(0, 1.02))
    axes.legend(loc="lower left", fontsize=8)
    figure.savefig(path, dpi=90, pil_kwargs={"optimize": True})


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--rays", type=int, default=40_000, help="rays for each smoothness, in steps of 200 (40000)"
    )
    parser.add_argument("--csv", type=Path, help="write all curves here")
    parser.add_argument("--figure", type=Path, help="write the picture here")
    args = parser.parse_args()
    rng = np.random.default_rng(2002)
    rays = {s: trace(rng, args.rays) for s in SMOOTHNESS}
    results = {s: curves(s, rays[s]) for s in SMOOTHNESS}
    print_levels(*(np.concatenate([r[i] for r in rays.values()]) for i in (0, 1)))
    print_differences(results)
    if args.csv:
        write_csv(args.csv, results)
    if args.figure:
        draw(args.figure, results)


if __name__ == "__main__":
    main()
