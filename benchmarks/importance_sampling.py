r"""How should the shifted gamma lobe be drawn? The variance of four samplers over all published lobes.

    python benchmarks/importance_sampling.py [--samples N] [--csv FILE]

For each of the 300 published rows (100 MERL materials × RGB, Bagher et al. 2012) and two angles of incidence
the albedo of the lobe alone (F = 1, exact masking) is estimated with the same random numbers by

    cosine     directions of density cos θ / π
    GGX(α)     half vectors of the GGX distribution with the row's own α, as the paper's section 4.5 prints
    median     visible normals of the GGX of the same median slope: what `ShiftedGammaBRDF.sample` does
    own        half vectors of the shifted gamma distribution itself, by a root for each sample

Shown is the standard deviation of one sample over the albedo: median, 90 % and largest of the rows, the
largest single weight, and the nanoseconds a sample takes with its density (compiled, one row at a time).
"""

import argparse
import csv
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import jaxbrdf as jb
from data_loaders import published_materials, published_parameters
from jaxbrdf.brdf.base import sample_cosine
from jaxbrdf.brdf.microfacet import mirrored_density, sample_mirrored

ANGLES = (30, 70)


class Plain(jb.AbstractNDF):
    """A distribution that is drawn from without asking which facets a direction sees."""

    ndf: jb.AbstractNDF

    @property
    def is_isotropic(self) -> bool:
        return self.ndf.is_isotropic

    def _density(self, m):
        return self.ndf._density(m)

    def _projected_area(self, w):
        return self.ndf._projected_area(w)

    def _sample(self, u):
        return self.ndf._sample(u)


SAMPLERS = {
    "cosine": lambda lobe: None,
    "GGX(α)": lambda lobe: Plain(jb.TrowbridgeReitz(lobe.alpha)),
    "median": lambda lobe: lobe,
    "own": Plain,
}


@eqx.filter_jit
def draw(name: str, lobe: jb.ShiftedGamma, wo, u):
    """Directions (N, 3) and their density."""
    proposal = SAMPLERS[name](lobe)
    if proposal is None:
        wi = sample_cosine(u)
        return wi, wi[:, 2] / jnp.pi
    wo = jnp.broadcast_to(wo, (*u.shape[:-1], 3))
    wi = sample_mirrored(proposal, u, wo)
    return wi, mirrored_density(proposal, wi, wo)


@eqx.filter_jit
def weights(lobe: jb.ShiftedGamma, wo, wi, pdf):
    """The estimates f cos θ_i / pdf, one a sample."""
    facets = jb.Microfacet(lobe, jb.Constant(jnp.ones_like(lobe.alpha)))
    f = facets(wi, wo)
    return jnp.where((pdf > 0) & (wi[:, 2] > 0), f * wi[:, 2] / jnp.where(pdf > 0, pdf, 1), 0)


def published_lobes() -> list[jb.ShiftedGamma]:
    rows = [published_parameters("sgd", material) for material in published_materials("sgd")]
    return [jb.ShiftedGamma(a, p) for row in rows for a, p in zip(row["alpha"], row["p"], strict=True)]


def measure(samples: int) -> np.ndarray:
    """(samplers, angles, rows, 3): relative standard deviation, largest relative weight, ns a sample."""
    u, lobes = np.random.default_rng(0).uniform(size=(samples, 2)), published_lobes()
    result = np.zeros((len(SAMPLERS), len(ANGLES), len(lobes), 3))
    for k, lobe in enumerate(track(lobes, description="rows", console=Console(stderr=True))):
        for j, angle in enumerate(ANGLES):
            wo = jb.spherical(np.radians(angle), 0.0)
            for i, name in enumerate(SAMPLERS):
                begin = time.perf_counter()
                wi, pdf = jax.block_until_ready(draw(name, lobe, wo, u))
                seconds = time.perf_counter() - begin
                estimate = np.asarray(weights(lobe, wo, wi, pdf))
                result[i, j, k] = estimate.std(), estimate.max(), 1e9 * seconds / samples
            result[:, j, k, :2] /= estimate.mean()  # by its own distribution, the last
    return result


def print_table(result: np.ndarray) -> None:
    table = Table("sampler", "angle", "median", "90 %", "largest", "largest weight", "ns a sample")
    for i, name in enumerate(SAMPLERS):
        for j, angle in enumerate(ANGLES):
            spread, weight, ns = np.moveaxis(result[i, j], -1, 0)
            shown = (np.median(spread), np.quantile(spread, 0.9), spread.max(), weight.max())
            table.add_row(name, f"{angle}°", *(f"{v:.3g}" for v in shown), f"{np.median(ns):.0f}")
    Console(width=110).print(table)


def write_csv(path: Path, result: np.ndarray) -> None:
    names = [f"{material} {c}" for material in published_materials("sgd") for c in "RGB"]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["row", "sampler", "angle", "relative_std", "largest_weight", "ns"])
        for i, sampler in enumerate(SAMPLERS):
            for j, angle in enumerate(ANGLES):
                writer.writerows(
                    [n, sampler, angle, *row] for n, row in zip(names, result[i, j], strict=True)
                )


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=4096, help="samples a row and angle (4096)")
    parser.add_argument("--csv", type=Path, help="write every row here")
    args = parser.parse_args()
    result = measure(args.samples)
    print_table(result)
    if args.csv:
        write_csv(args.csv, result)


if __name__ == "__main__":
    main()
