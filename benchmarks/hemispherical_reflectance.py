r"""How much light do brushed mirror facets reflect in all? Ashikhmin's generator against Ward's model.

    python benchmarks/hemispherical_reflectance.py [--csv FILE] [--figure FILE]

Redraws Fig. 6 of Ashikhmin et al. 2000 (--figure): the directional hemispherical reflectance

    R(θ_i) = ∫ f(wi, wo) cos θ_o dω_o

of perfect mirrors, F = 1, with Gaussian slopes of width 0.1 along x and 0.2 along y, for light in either of
these planes. A flat mirror has 1 at every angle.

    new model       eq. 26 with f_0 = 1 and no diffuse term: it loses what facets reflect to other facets
    table           the same from `tabulate_reflectance`, which the diffuse term is made of
    with diffuse    eq. 30 with ρ_d = 1: what the facets leave over is scattered, and all light comes back
    Ward            Ward 1992, eq. 5a, ρ_s = 1: falls off, and grows without bound at the very horizon

Reflectances are integrated over slopes of the half vector, 1,000 × 1,000 midpoints to 6.4 widths each way.
The second table counts, of 10 × 20 directions, those from which the slanted velvet of section 6.4 with
f_0 = 1 reflects more light than it gets: with the paper's cos θ / σ for the share of facets that are seen,
which exceeds 1 for this distribution, and with that share at most 1, as everywhere in jaxbrdf.
"""

import argparse
import csv
import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

import jaxbrdf as jb
from jaxbrdf.brdf.generated import CoupledDiffuse, tabulate_reflectance
from jaxbrdf.directions import cos_theta
from jaxbrdf.ndf.base import from_slopes

SIGMA = (0.1, 0.2)
DEGREES = np.array([*range(0, 85, 5), 85, 87, 88, 89, 89.5, 89.9])
SHOWN = (0, 20, 40, 60, 70, 80, 85, 89, 89.9)
AZIMUTHS = (0, 90)


def slope_nodes(n: int = 1000, widths: float = 6.4) -> tuple[jax.Array, jax.Array]:
    """Half vectors (n², 3) and their solid angles: midpoints in t_x/σ_x and t_y/σ_y, dh = cos³θ_h dt_x dt_y.

    Only those where more than e^−40 is left of the Gaussian: the others do not reflect.
    """
    t = (np.arange(n) + 0.5) / n * 2 * widths - widths
    s_x, s_y = np.meshgrid(t, t)
    near = s_x**2 + s_y**2 < 40
    h = from_slopes(jnp.asarray(SIGMA[0] * s_x[near]), jnp.asarray(SIGMA[1] * s_y[near]))
    return h, h[:, 2] ** 3 * SIGMA[0] * SIGMA[1] * (2 * widths / n) ** 2


@eqx.filter_jit
def reflectance(brdf: jb.AbstractBRDF, w: jax.Array) -> jax.Array:
    """R of a lobe in the half vector, for directions (n, 3)."""
    h, d_omega = slope_nodes()

    def one(w):
        facing = jnp.maximum(jb.dot(h, w), 0)
        wo = jb.reflect(w, h)
        return jnp.sum(brdf(w, wo) * jnp.maximum(cos_theta(wo), 0) * 4 * facing * d_omega)

    return jax.lax.map(one, w)


class Unclipped(jb.AbstractShadowing):
    """Ashikhmin's ratio cos θ / σ in either direction, which may exceed 1."""

    def _shadow(self, ndf, wi, wo):
        return cos_theta(wi) / ndf.projected_area(wi) * cos_theta(wo) / ndf.projected_area(wo)


def directions(degrees: np.ndarray) -> jax.Array:
    """Of light, (azimuths, angles, 3)."""
    return jb.spherical(np.radians(degrees)[None, :], np.radians(AZIMUTHS)[:, None])


def curves() -> dict[str, np.ndarray]:
    """R of each model, (azimuths, angles)."""
    ndf = jb.tabulate_projected_area(jb.GaussianMicrofacets(*SIGMA), (129, 384))
    table = tabulate_reflectance(ndf, facets=2**15)
    w = directions(DEGREES)
    flat = w.reshape(-1, 3)
    new = reflectance(jb.Microfacet(ndf, jb.Constant(1.0)), flat).reshape(w.shape[:2])
    diffuse = CoupledDiffuse(table, 1.0, 1.0)
    return {
        "new model": np.asarray(new),
        "table": np.asarray(table(1.0, w)),
        "with diffuse": np.asarray(new + diffuse_reflectance(diffuse, w)),
        "Ward": np.asarray(reflectance(jb.Ward(*SIGMA), flat)).reshape(w.shape[:2]),
    }


def diffuse_reflectance(diffuse: jb.AbstractBRDF, w: jax.Array) -> jax.Array:
    wo, d_omega = jb.hemisphere(96, 192)
    return diffuse(w[..., None, :], wo) @ (cos_theta(wo) * d_omega)


def count_excess(shadowing: jb.AbstractShadowing) -> tuple[int, float]:
    """Of 10 × 20 directions, those of which slanted velvet reflects more than 1, and the largest R."""
    theta, phi = np.radians(np.arange(10) * 9.0), np.radians(np.arange(20) * 18.0)
    velvet = jb.SlantedVelvet(math.radians(40), 0.5)
    R = tabulate_reflectance(velvet, shadowing)(1.0, jb.spherical(theta[:, None], phi[None, :]))
    return int(np.sum(R > 1)), float(jnp.max(R))


def print_curves(results: dict[str, np.ndarray]) -> None:
    table = Table("θ_i", *(f"{name}, φ = {phi}°" for name in results for phi in AZIMUTHS))
    for degrees in SHOWN:
        column = int(np.flatnonzero(degrees == DEGREES)[0])
        table.add_row(f"{degrees:g}°", *(f"{R[i, column]:.3f}" for R in results.values() for i in (0, 1)))
    Console(width=150).print(table)


def print_excess() -> None:
    table = Table("shadowing", "of 200 directions above 1", "largest R", title="slanted velvet, f_0 = 1")
    for name, shadowing in (("cos θ / σ", Unclipped()), ("at most 1", jb.Uncorrelated())):
        count, largest = count_excess(shadowing)
        table.add_row(name, str(count), f"{largest:.3f}")
    Console(width=100).print(table)


def write_csv(path: Path, results: dict[str, np.ndarray]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["phi_degrees", "theta_degrees", *(name.replace(" ", "_") for name in results)])
        for i, phi in enumerate(AZIMUTHS):
            for j, theta in enumerate(DEGREES):
                writer.writerow([phi, theta, *(R[i, j] for R in results.values())])


def draw(path: Path, results: dict[str, np.ndarray]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4), layout="constrained")
    for name, color in (("new model", "C0"), ("with diffuse", "0.6"), ("Ward", "C3")):
        for R, phi, line in zip(results[name], AZIMUTHS, ("-", "--"), strict=True):
            axes.plot(DEGREES, R, color=color, linestyle=line, label=f"{name}, φ = {phi}°")
    axes.set(
        xlabel="angle of incidence / degree", ylabel="hemispherical reflectance", xlim=(0, 90), ylim=(0, 1.1)
    )
    axes.legend(loc="lower left", fontsize=8)
    figure.savefig(path, dpi=90, pil_kwargs={"optimize": True})


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--csv", type=Path, help="write all curves here")
    parser.add_argument("--figure", type=Path, help="write the picture here")
    args = parser.parse_args()
    results = curves()
    print_curves(results)
    print_excess()
    if args.csv:
        write_csv(args.csv, results)
    if args.figure:
        draw(args.figure, results)


if __name__ == "__main__":
    main()
