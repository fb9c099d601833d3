r"""How fast is evaluation? Every reflectance at ten million pairs of directions, in both precisions.

    python benchmarks/evaluate.py [--pairs N] [--repeat N] [--csv FILE] [MODEL ...]

Each model is jitted and evaluated at random pairs above the horizon, a million at a time; the first million,
which compiles, is timed apart. Shown are nanoseconds a pair (the fastest of `--repeat` runs), the ratio to
the Lambertian reflectance of the same precision, and the seconds of compilation. Where Mitsuba 3 has the
model (its mono variant, vectorised through LLVM, single precision; its value holds the cosine besides), it
evaluates the same directions in the same run, and the ratio of our single precision to it is shown, as is:
with directions (N, 3), and apart: as Mitsuba has them, three arrays x, y and z. The columns stay empty where
mitsuba is missing. Mitsuba takes the LLVM that DRJIT_LIBLLVM_PATH names, which must
be 16 or newer for its rough conductor. Some models whose projected area is an integral are shown with it
tabulated besides. What sums over facets at every pair gets fewer pairs, see FEWER.
"""

import argparse
import csv
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import jaxbrdf as jb

BLOCK = 1_000_000
COPPER = (0.2, 3.9)  # η and κ
METAL = jb.Conductor(*COPPER)
GGX = jb.TrowbridgeReitz(0.2)
SGD = jb.ShiftedGamma(0.1, 0.6)
SGD_MASKING = jb.ShiftedGammaShadowing(2.6, 1e-7, 47.8)
BRUSHED = jb.GaussianMicrofacets(0.1, 0.3)


def facets(ndf: jb.AbstractNDF, shadowing: jb.AbstractShadowing | None = None) -> jb.Microfacet:
    return jb.Microfacet(ndf, METAL, shadowing or jb.Uncorrelated())


def measured() -> jb.MeasuredBRDF:
    """A table of the size of MERL's."""
    return jb.MeasuredBRDF(
        np.random.default_rng(0).uniform(size=(90, 90, 180, 1)), np.ones(1), jb.merl_grid()
    )


def adaptive() -> jb.AdaptiveBRDF:
    """Tables of the size of an isotropic RGL file's."""
    table = np.random.default_rng(0).uniform
    return jb.AdaptiveBRDF(
        theta_i=np.linspace(0, np.pi / 2, 8),
        phi_i=np.zeros(1),
        ndf=table(size=(2, 128)),
        sigma=table(size=(2, 128)),
        vndf=table(size=(1, 8, 128, 128)),
        luminance=table(size=(1, 8, 32, 32)),
        values=table(size=(1, 8, 32, 32, 1)),
    )


def free_form() -> jb.FreeFormBRDF:
    """Tables of the size that `fit_factors` makes of a MERL file."""
    grid, theta = jb.merl_grid(), np.linspace(0, np.pi / 2, 46)
    D = np.exp(-20 * np.tan(grid.theta_h) ** 2)
    return jb.FreeFormBRDF(0.1, grid.theta_h, D, grid.theta_d, np.ones(90), theta, np.cos(theta) ** 0.1)


def kirchhoff() -> jb.KirchhoffBRDF:
    tables = np.random.default_rng(0).uniform(size=(3, 257, 257))
    return jb.KirchhoffBRDF(tables, np.array([0.4, 0.6, 0.9]), 0.55, METAL)


def tabulated_ndf() -> jb.TabulatedNDF:
    """A table of 257 × 257, as of a measured surface."""
    x, y = np.meshgrid(np.linspace(-1, 1, 257), np.linspace(-1, 1, 257))
    return jb.TabulatedNDF(np.exp(-20 * (x**2 + 3 * y**2)))


MODELS: dict[str, Callable[[], jb.AbstractBRDF]] = {
    "Lambertian": lambda: jb.Lambertian(0.5),
    "OrenNayar": lambda: jb.OrenNayar(0.5, 0.3),
    "Phong": lambda: jb.Phong(50.0),
    "BlinnPhongBRDF": lambda: jb.BlinnPhongBRDF(50.0),
    "Lafortune": lambda: jb.Lafortune(20.0, -1.0),
    "Ward": lambda: jb.Ward(0.1, 0.3),
    "WardDuer": lambda: jb.WardDuer(0.1, 0.3),
    "AshikhminShirley": lambda: jb.AshikhminShirley(0.4, 0.05, 1000.0, 20.0),
    "ABC": lambda: jb.ABC(32.7, 706.0, 1.95, 5.44),
    "SmoothABC": lambda: jb.SmoothABC(46.0, 484.0, 1.33, 3.41),
    "RoughMetal": lambda: jb.RoughMetal(3.0, METAL),
    "MeasuredBRDF": measured,
    "AdaptiveBRDF": adaptive,
    "FreeFormBRDF": free_form,
    "KirchhoffBRDF": kirchhoff,
    "KirchhoffBRDF, table of σ": lambda: replace(
        kirchhoff(), ndf=jb.tabulate_projected_area(kirchhoff().mean_ndf)
    ),
    "Microfacet, GGX, correlated": lambda: facets(GGX, jb.HeightCorrelated()),
    "Microfacet, GGX": lambda: facets(GGX),
    "Microfacet, Beckmann": lambda: facets(jb.Beckmann(0.2)),
    "Microfacet, V-cavity": lambda: facets(jb.Beckmann(0.2), jb.VCavity()),
    "Microfacet, Ellipsoid": lambda: facets(jb.Ellipsoid(0.1, 0.3, 0.1, 0.1, 0.5)),
    "Microfacet, BlinnPhong": lambda: facets(jb.BlinnPhong(50.0)),
    "Microfacet, BlinnPhong, table of σ": lambda: facets(jb.tabulate_projected_area(jb.BlinnPhong(50.0))),
    "Microfacet, StudentT": lambda: facets(jb.StudentT(0.2, 3.0)),
    "Microfacet, StudentT, table of σ": lambda: facets(jb.tabulate_projected_area(jb.StudentT(0.2, 3.0))),
    "Microfacet, Exponential": lambda: facets(jb.Exponential(0.2)),
    "Microfacet, Velvet": lambda: facets(jb.Velvet(0.5)),
    "Microfacet, Gaussian": lambda: facets(BRUSHED),
    "Microfacet, Gaussian, table of σ": lambda: facets(jb.tabulate_projected_area(BRUSHED)),
    "Microfacet, VGrooves": lambda: facets(jb.VGrooves(0.7, 0.1)),
    "GeneratedBRDF, Gaussian": lambda: jb.GeneratedBRDF(BRUSHED, 0.05, 0.4),
    "GeneratedMetal, Gaussian": lambda: jb.GeneratedMetal(BRUSHED, 0.9),
    "ShiftedGammaBRDF": lambda: jb.ShiftedGammaBRDF(0.1, 0.3, 0.1, 0.6, 0.5, 0.1),
    "CookTorrance, ShiftedGamma, table of σ": lambda: jb.CookTorrance(
        0.1, 0.3, jb.tabulate_projected_area(SGD), jb.LinearSchlick(0.5, 0.1)
    ),
    "ShiftedGammaBRDF, closed masking": lambda: jb.ShiftedGammaBRDF(
        0.1, 0.3, 0.1, 0.6, 0.5, 0.1, SGD_MASKING
    ),
    "Microfacet, AnisotropicPhong": lambda: facets(jb.AnisotropicPhong(100.0, 20.0)),
    "Microfacet, TabulatedNDF": lambda: facets(jb.tabulate_projected_area(tabulated_ndf())),
    "FacetScattering": lambda: jb.FacetScattering(jb.Beckmann(0.5), jb.Lambertian(0.5)),
}
FEWER = {  # the share of the pairs for what is a sum over facets at each pair
    "FacetScattering": 1e-3,
    "KirchhoffBRDF": 1e-3,
    "Microfacet, AnisotropicPhong": 1e-3,
}

COLUMNS = ("model", "compile float32", "float32", "compile float64", "float64", "mitsuba", "apart")
MITSUBA = {  # what the same model is there
    "Lambertian": {"type": "diffuse", "reflectance": 0.5},
    "Microfacet, GGX": {"distribution": "ggx"},
    "Microfacet, Beckmann": {"distribution": "beckmann"},
}


def directions(pairs: int) -> tuple[np.ndarray, np.ndarray]:
    """(pairs, 3) each, even over the solid angle above the horizon, in double precision."""
    rng = np.random.default_rng(1)

    def half():
        cos, phi = rng.uniform(1e-3, 1, pairs), rng.uniform(-np.pi, np.pi, pairs)
        sin = np.sqrt(1 - cos**2)
        return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)

    return half(), half()


def best_of(repeat: int, run: Callable[[], None]) -> float:
    seconds = []
    for _ in range(repeat):
        begin = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def ours(
    brdf: jb.AbstractBRDF, wi: np.ndarray, wo: np.ndarray, dtype: type, repeat: int, apart: bool = False
) -> tuple[float, float]:
    """(seconds to compile, nanoseconds a pair); with components `apart` in memory or side by side."""
    brdf = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), brdf)
    turn = np.transpose if apart else np.asarray
    blocks = [
        tuple(jnp.array(turn(w[i : i + BLOCK]), dtype) for w in (wi, wo)) for i in range(0, len(wi), BLOCK)
    ]
    evaluate = eqx.filter_jit(lambda brdf, wi, wo: brdf(wi.T, wo.T) if apart else brdf(wi, wo))

    def run(blocks=blocks):
        for i, o in blocks:
            evaluate(brdf, i, o).block_until_ready()

    first = best_of(1, lambda: run(blocks[:1]))
    warm = best_of(repeat, run)
    return first - warm / len(blocks), 1e9 * warm / len(wi)


def theirs(entry: dict, wi: np.ndarray, wo: np.ndarray, repeat: int) -> float:
    """Nanoseconds a pair of Mitsuba's `eval`."""
    import drjit as dr
    import mitsuba as mi

    metal = {"type": "roughconductor", "alpha": 0.2, "eta": COPPER[0], "k": COPPER[1], **entry}
    bsdf = mi.load_dict(entry if "type" in entry else metal)
    context, blocks = mi.BSDFContext(), []
    for i in range(0, len(wi), BLOCK):
        interaction = dr.zeros(mi.SurfaceInteraction3f, len(wi[i : i + BLOCK]))
        interaction.wi = mi.Vector3f(np.float32(wi[i : i + BLOCK]).T)
        blocks.append((interaction, mi.Vector3f(np.float32(wo[i : i + BLOCK]).T)))
    dr.eval(blocks)

    def run():
        for interaction, direction in blocks:
            dr.eval(bsdf.eval(context, interaction, direction))
            dr.sync_thread()

    run()  # compiles
    return 1e9 * best_of(repeat, run) / len(wi)


def mitsuba_is_there() -> bool:
    try:
        import mitsuba

        mitsuba.set_variant("llvm_ad_mono")
    except ImportError:
        return False
    import drjit

    return drjit.detail.llvm_version() >= (16,)  # an older one cannot compile the rough conductor


def measure(names: list[str], pairs: int, repeat: int) -> list[dict]:
    wi, wo = directions(pairs)
    there, rows = mitsuba_is_there(), []
    for name in track(names, description="models", console=Console(stderr=True)):
        row, brdf = {"model": name}, MODELS[name]()
        for dtype in (np.float32, np.float64):
            n = int(pairs * FEWER.get(name, 1))
            row[f"compile {dtype.__name__}"], row[dtype.__name__] = ours(brdf, wi[:n], wo[:n], dtype, repeat)
        if there and name in MITSUBA:
            row["mitsuba"] = theirs(MITSUBA[name], wi, wo, repeat)
            row["apart"] = ours(brdf, wi, wo, np.float32, repeat, apart=True)[1]
        rows.append(row)
    return rows


def print_table(rows: list[dict]) -> None:
    table = Table(
        "model",
        "ns f32",
        "× Lambertian",
        "ns f64",
        "× Lambertian",
        "Mitsuba ns",
        "× Mitsuba, apart",
        "compile f32, f64 / s",
    )
    for row in rows:
        single, double, mitsuba = row["float32"], row["float64"], row.get("mitsuba")
        table.add_row(
            row["model"],
            f"{single:.1f}",
            f"{single / rows[0]['float32']:.1f}",
            f"{double:.1f}",
            f"{double / rows[0]['float64']:.1f}",
            f"{mitsuba:.1f}" if mitsuba else "",
            f"{single / mitsuba:.1f} {row['apart'] / mitsuba:.1f}" if mitsuba else "",
            f"{row['compile float32']:.2f} {row['compile float64']:.2f}",
        )
    Console(width=140).print(table)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", nargs="*", help="only these, by the beginning of their names")
    parser.add_argument("--pairs", type=int, default=10_000_000)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--csv", type=Path, help="write the numbers here")
    args = parser.parse_args()
    wanted = tuple(args.models) or ("",)
    names = [n for n in MODELS if n == "Lambertian" or n.startswith(wanted)]
    rows = measure(names, args.pairs, args.repeat)
    print_table(rows)
    if args.csv:
        with args.csv.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
