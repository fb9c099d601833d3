r"""Which formula do published parameters belong to? Candidates against the tables they were fitted to.

    python benchmarks/published_conventions.py FOLDER [--csv FILE] [MATERIAL ...]

Papers print numbers and leave out the norm of a lobe, its Fresnel term or the units. FOLDER holds MERL files
(*.binary). Each candidate f = k_d/π + k_s L is held against them below 80° with the published numbers; the
first of each model is what `data_loaders.published` builds.

    L2      √(Σ w (m − f)² / Σ w m²),   w = cos θ_i cos θ_o dω_i dω_o
    log     rms of log(1 + m cos θ_i) − log(1 + f cos θ_i), solid angles as weights
    nearer  share of the materials that are nearer to the first candidate in L2 than to this one
    factor  the published k_s over the k_s that fits the table best in L2, k_d being free too: 1 if the norm
            is right and the paper fitted the same data; median and quartiles over the rough materials, whose
            lobe the table resolves, alpha of Ward's model above 0.1
    of Ward's  for Ngan et al., the same over the mean factor of their two Ward models: what their data or
            their way to fit have to do with it cancels

Errors are medians over the materials of the median channel. Below the table: the published k_d over the one
that fits best, per channel, where Ngan's units show.
"""

import argparse
import csv
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from data_loaders import published_materials, published_parameters, read_merl
from jaxbrdf import merl_grid

LIMIT = np.cos(np.deg2rad(80))
STEP = np.s_[:, ::3, ::6]  # of θ_h, θ_d, φ_d
NGAN_TO_MERL = np.array([1.0, 1.15, 1.66])
WARD, DUER = "ngan-ward", "ngan-ward-duer"

Parameters = dict[str, np.ndarray]


class Pairs(NamedTuple):
    """The pairs below 80°; `in_plane` is wi·wo less cos θ_i cos θ_o, `deviation2` is ‖D_p‖²."""

    used: np.ndarray
    solid_angle: np.ndarray
    cos_i: np.ndarray
    cos_o: np.ndarray
    cos_h: np.ndarray
    cos_d: np.ndarray
    in_plane: np.ndarray
    deviation2: np.ndarray
    smooth_cos_d: np.ndarray


@cache
def pairs() -> Pairs:
    grid = merl_grid()
    wi, wo = (np.asarray(w)[STEP] for w in grid.directions())
    used = (wi[..., 2] > LIMIT) & (wo[..., 2] > LIMIT)
    solid_angle = np.broadcast_to(np.asarray(grid.measure()), grid.shape)[STEP][used]
    wi, wo = wi[used], wo[used]
    h = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
    in_plane = wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1]
    deviation2 = np.sum((wi + wo)[:, :2] ** 2, axis=-1)
    smooth_cos_d = np.sqrt(np.maximum(1 - np.sum((wi - wo)[:, :2] ** 2, axis=-1) / 4, 0))
    cosines = wi[:, 2], wo[:, 2], h[:, 2], np.sum(wi * h, axis=-1)
    return Pairs(used, solid_angle, *cosines, in_plane, deviation2, smooth_cos_d)


# The lobes L(parameters), (N,), at the pairs


def schlick(f0: np.ndarray, cos: np.ndarray) -> np.ndarray:
    return f0 + (1 - f0) * (1 - cos) ** 5


def exact(index: np.ndarray, cos: np.ndarray) -> np.ndarray:
    """Fresnel's term of a real index; all is reflected where an index below 1 says so."""
    squared = index**2 - 1 + cos**2
    u = np.sqrt(np.maximum(squared, 0))
    across, along = (cos - u) / (cos + u), (index**2 * cos - u) / (index**2 * cos + u)
    return np.where(squared > 0, (across**2 + along**2) / 2, 1)


def index_of(f0: np.ndarray) -> np.ndarray:
    return (1 + np.sqrt(f0)) / (1 - np.sqrt(f0))


def f0_of(index: np.ndarray) -> np.ndarray:
    return ((index - 1) / (index + 1)) ** 2


def gaussian(width: np.ndarray) -> np.ndarray:
    """exp(−tan²θ_h / width²) / width²."""
    return np.exp(-(1 / pairs().cos_h ** 2 - 1) / width**2) / width**2


def ward(row: Parameters, norm: float, power: float) -> np.ndarray:
    at = pairs()
    return gaussian(row["alpha"]) / (norm * (at.cos_i * at.cos_o) ** power)


def facets(m: np.ndarray, F: np.ndarray, norm: float, grooves: bool = True) -> np.ndarray:
    """F D G / (norm cos θ_i cos θ_o), D = exp(−tan²θ_h / m²) / (m² cos⁴θ_h)."""
    at = pairs()
    G = np.minimum(1, 2 * at.cos_h * np.minimum(at.cos_i, at.cos_o) / at.cos_d) if grooves else 1
    return F * gaussian(m) / at.cos_h**4 * G / (norm * at.cos_i * at.cos_o)


def ashikhmin_shirley(n: np.ndarray, F: np.ndarray, norm: np.ndarray) -> np.ndarray:
    at = pairs()
    return norm * at.cos_h**n * F / (at.cos_d * np.maximum(at.cos_i, at.cos_o))


def half_power(row: Parameters, more: float, over_cosine: bool = False) -> np.ndarray:
    at = pairs()
    return (row["n"] + more) / (2 * np.pi) * at.cos_h ** row["n"] / (at.cos_i if over_cosine else 1)


def mirror_power(row: Parameters) -> np.ndarray:
    at = pairs()
    return (row["n"] + 2) / (2 * np.pi) * np.maximum(at.cos_i * at.cos_o - at.in_plane, 0) ** row["n"]


def lafortune(row: Parameters, more: float, relative: bool = True) -> np.ndarray:
    at = pairs()
    largest = np.maximum(abs(row["Cxy"]), row["Cz"]) if relative else 1
    cosine = np.maximum(row["Cxy"] * at.in_plane + row["Cz"] * at.cos_i * at.cos_o, 0)
    return (row["n"] + more) / (2 * np.pi) * (cosine / largest) ** row["n"]


def abc(row: Parameters, norm: float) -> np.ndarray:
    at = pairs()
    G = np.minimum(1, 2 * at.cos_h * np.minimum(at.cos_i, at.cos_o) / at.cos_d)
    S = (1 + row["B"] * (1 - at.cos_h)) ** -row["C"]
    return exact(row["ior"], at.cos_d) * G * S / (norm * at.cos_i * at.cos_o)


def smooth(row: Parameters, norm: float, cos_d: str = "cos_d") -> np.ndarray:
    S = (1 + row["B"] * pairs().deviation2) ** -row["C"]
    return exact(row["ior"], getattr(pairs(), cos_d)) * S / norm


def phong_norm(row: Parameters, more: float, norm: float) -> np.ndarray:
    return (row["n"] + more) / (norm * np.pi)


Lobe = Callable[[Parameters], np.ndarray]
PI = np.pi

LOW_ASHIKHMIN_SHIRLEY: dict[str, Lobe] = {
    "(n+1)/8π, exact F of ior": lambda r: ashikhmin_shirley(r["n"], dielectric(r), phong_norm(r, 1, 8)),
    "(n+2)/8π": lambda r: ashikhmin_shirley(r["n"], dielectric(r), phong_norm(r, 2, 8)),
    "(n+1)/2π²": lambda r: ashikhmin_shirley(r["n"], dielectric(r), phong_norm(r, 1, 2 * PI)),
    "(n+1)/8π, Schlick's F": lambda r: ashikhmin_shirley(r["n"], as_schlick(r), phong_norm(r, 1, 8)),
}
LOW_COOK_TORRANCE: dict[str, Lobe] = {
    "1/π, exact F of ior": lambda r: facets(r["m"], dielectric(r), PI),
    "1/π²": lambda r: facets(r["m"], dielectric(r), PI**2),
    "1/4": lambda r: facets(r["m"], dielectric(r), 4),
    "1/4π": lambda r: facets(r["m"], dielectric(r), 4 * PI),
    "1/π, Schlick's F": lambda r: facets(r["m"], as_schlick(r), PI),
    "1/π, without G": lambda r: facets(r["m"], dielectric(r), PI, grooves=False),
}
CANDIDATES: dict[str, dict[str, Lobe]] = {
    WARD: {
        "1/4πα², 1/√(cos cos)": lambda r: ward(r, 4 * PI, 0.5),
        "1/πα²": lambda r: ward(r, PI, 0.5),
        "1/4α²": lambda r: ward(r, 4, 0.5),
        "1/4πα², 1/(cos cos)": lambda r: ward(r, 4 * PI, 1),
        "1/4πα², no cosine": lambda r: ward(r, 4 * PI, 0),
    },
    DUER: {
        "1/4πα², 1/(cos cos)": lambda r: ward(r, 4 * PI, 1),
        "1/πα²": lambda r: ward(r, PI, 1),
        "1/4πα², 1/√(cos cos)": lambda r: ward(r, 4 * PI, 0.5),
    },
    "ngan-blinn-phong": {
        "(n+2)/2π (n·h)^n": lambda r: half_power(r, 2),
        "(n+1)/2π (n·h)^n": lambda r: half_power(r, 1),
        "(n+2)/2π (n·h)^n / cos θ_i": lambda r: half_power(r, 2, over_cosine=True),
        "(n+2)/2π (r·wo)^n": mirror_power,
    },
    "ngan-lafortune": {
        "(n+2)/2π, over max C^n": lambda r: lafortune(r, 2),
        "(n+1)/2π, over max C^n": lambda r: lafortune(r, 1),
        "(n+2)/2π": lambda r: lafortune(r, 2, relative=False),
    },
    "ngan-ashikhmin-shirley": {
        "(n+1)/8π, Schlick's F": lambda r: ashikhmin_shirley(r["n"], from_f0(r), phong_norm(r, 1, 8)),
        "(n+2)/8π": lambda r: ashikhmin_shirley(r["n"], from_f0(r), phong_norm(r, 2, 8)),
        "(n+1)/2π²": lambda r: ashikhmin_shirley(r["n"], from_f0(r), phong_norm(r, 1, 2 * PI)),
        "(n+1)/8π, exact F": lambda r: ashikhmin_shirley(r["n"], exact_from_f0(r), phong_norm(r, 1, 8)),
    },
    "ngan-cook-torrance": {
        "1/4π, exact F of F0": lambda r: facets(r["m"], exact_from_f0(r), 4 * PI),
        "1/π²": lambda r: facets(r["m"], exact_from_f0(r), PI**2),
        "1/π": lambda r: facets(r["m"], exact_from_f0(r), PI),
        "1/4π, Schlick's F": lambda r: facets(r["m"], from_f0(r), 4 * PI),
        "1/π², Schlick's F": lambda r: facets(r["m"], from_f0(r), PI**2),
        "1/4π, F0 an index": lambda r: facets(r["m"], exact(r["F0"], pairs().cos_d), 4 * PI),
        "1/4π, without G": lambda r: facets(r["m"], exact_from_f0(r), 4 * PI, grooves=False),
    },
    "low-ashikhmin-shirley-e1": LOW_ASHIKHMIN_SHIRLEY,
    "low-ashikhmin-shirley-e2": LOW_ASHIKHMIN_SHIRLEY,
    "low-cook-torrance-e1": LOW_COOK_TORRANCE,
    "low-cook-torrance-e2": LOW_COOK_TORRANCE,
    "abc": {
        "1/π": lambda r: abc(r, PI),
        "1/4": lambda r: abc(r, 4),
        "1": lambda r: abc(r, 1),
    },
    "abc-smooth": {
        "1": lambda r: smooth(r, 1),
        "1/π": lambda r: smooth(r, PI),
        "1/4": lambda r: smooth(r, 4),
        "1, cos θ_d of the plane": lambda r: smooth(r, 1, "smooth_cos_d"),
    },
}


def dielectric(row: Parameters) -> np.ndarray:
    return exact(row["ior"], pairs().cos_d)


def as_schlick(row: Parameters) -> np.ndarray:
    return schlick(f0_of(row["ior"]), pairs().cos_d)


def from_f0(row: Parameters) -> np.ndarray:
    return schlick(row["F0"], pairs().cos_d)


def exact_from_f0(row: Parameters) -> np.ndarray:
    return exact(index_of(row["F0"]), pairs().cos_d)


# How near


class Score(NamedTuple):
    """Of one candidate and one material; `diffuse` per channel."""

    l2: float
    log: float
    factor: float
    diffuse: np.ndarray


def score(lobe: np.ndarray, k_d: np.ndarray, k_s: np.ndarray, m: np.ndarray) -> Score:
    """`lobe` (N,), published k_d and k_s (3,) and the table m (N, 3), as Ngan or MERL has the units."""
    at = pairs()
    w = (at.solid_angle * at.cos_i * at.cos_o)[:, None]
    f = k_d / np.pi + k_s * lobe[:, None]
    l2 = np.sqrt(np.sum(w * (m - f) ** 2, axis=0) / np.sum(w * m**2, axis=0))
    log = np.log1p(m * at.cos_i[:, None]) - np.log1p(f * at.cos_i[:, None])
    log = np.sqrt(at.solid_angle @ log**2 / at.solid_angle.sum())
    columns = np.stack([np.full_like(lobe, 1 / np.pi), lobe], axis=1)
    normal = columns.T @ (w * columns)
    best = np.linalg.lstsq(normal, columns.T @ (w * m), rcond=None)[0]
    with np.errstate(divide="ignore"):
        return Score(np.median(l2), np.median(log), np.median(k_s / best[1]), k_d / best[0])


def scores_of(m: np.ndarray, material: str, wanted: list[str]) -> dict[tuple[str, str], Score]:
    """By model and candidate, m (N, 3) being the material's table at the pairs."""
    found = {}
    for model in wanted:
        row = published_parameters(model, material)
        units = NGAN_TO_MERL if model.startswith("ngan") else 1
        k_d, k_s = (row[a] if a in row else row[b] for a, b in (("kd", "kD"), ("ks", "A")))
        for name, lobe in CANDIDATES[model].items():
            found[model, name] = score(lobe(row), units * k_d, units * k_s, m)
    return found


Scores = dict[tuple[str, str], dict[str, Score]]


def all_scores(files: list[Path]) -> Scores:
    """By model and candidate, then by material."""
    found: Scores = {(model, name): {} for model, names in CANDIDATES.items() for name in names}
    for file in track(files, description="materials", console=Console(stderr=True)):
        wanted = [model for model in CANDIDATES if file.stem in published_materials(model)]
        m = np.asarray(read_merl(file).values)[STEP][pairs().used]
        for key, one in scores_of(m, file.stem, wanted).items():
            found[key][file.stem] = one
    return found


def rough(materials: list[str]) -> list[str]:
    known = set(published_materials(WARD))
    return [m for m in materials if m in known and published_parameters(WARD, m)["alpha"] > 0.1]


def print_table(scores: Scores) -> None:
    table = Table("model", "candidate", "materials", "L2", "log", "nearer", "factor", "of Ward's")
    wards = [scores[model, next(iter(CANDIDATES[model]))] for model in (WARD, DUER)]
    for model, names in CANDIDATES.items():
        first = scores[model, next(iter(names))]
        for name in names:
            rows = scores[model, name]
            factors = {m: rows[m].factor for m in rough(list(rows))}
            relative = [f / np.mean([ward[m].factor for ward in wards]) for m, f in factors.items()]
            table.add_row(
                *(model, name, str(len(rows))),
                f"{np.median([s.l2 for s in rows.values()]):.3f}",
                f"{np.median([s.log for s in rows.values()]):.4f}",
                f"{np.mean([first[m].l2 < s.l2 for m, s in rows.items()]):.0%}" if rows is not first else "",
                quartiles(list(factors.values())),
                quartiles(relative) if model.startswith("ngan") else "",
            )
        table.add_section()
    Console(width=160).print(table)


def quartiles(values: list[float]) -> str:
    low, middle, high = np.percentile(values, [25, 50, 75]) if values else [np.nan] * 3
    return f"{middle:.3g} ({low:.3g} to {high:.3g})"


def print_units(scores: Scores) -> None:
    """k_d as published, without the factors that bring Ngan's numbers to MERL's units, over the best k_d."""
    for model, names in CANDIDATES.items():
        ratios = np.array([one.diffuse for one in scores[model, next(iter(names))].values()])
        units = NGAN_TO_MERL if model.startswith("ngan") else 1
        middle = np.median(ratios / units, axis=0)
        print(f"{model}: published k_d / best k_d: " + ", ".join(f"{r:.3f}" for r in middle))


def write_csv(path: Path, scores: Scores) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["model", "candidate", "material", "l2", "log", "factor"])
        for (model, name), rows in scores.items():
            writer.writerows([model, name, m, one.l2, one.log, one.factor] for m, one in rows.items())


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder of MERL files")
    parser.add_argument("materials", nargs="*", help="only these")
    parser.add_argument("--csv", type=Path, help="write every material's errors here")
    args = parser.parse_args()
    known = set(published_materials("abc"))
    files = [f for f in sorted(args.folder.glob("*.binary")) if f.stem in (args.materials or known)]
    if not files:
        parser.error(f"no MERL files (*.binary) of these names in {args.folder}")
    scores = all_scores(files)
    print_table(scores)
    print_units(scores)
    if args.csv:
        write_csv(args.csv, scores)


if __name__ == "__main__":
    main()
