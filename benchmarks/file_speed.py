"""How fast are files read, written and evaluated? MERL, RGL and text formats, each against a rival.

    python benchmarks/file_speed.py [--repeat N] [--rgl FILE.bsdf] [--merl FILE.binary] [--csv FILE]

Without files of your own it makes them: a model written in each format. Shown are milliseconds, the fastest
of `--repeat` runs with the files in the system's cache, and the ratio to the rival of the row: for MERL one
pass over the bytes by numpy (`fromfile`, then a sum), for text numpy's `loadtxt` and `savetxt`, for RGL
tables Mitsuba 3's plugin `measured` at the same million pairs of directions (llvm_ad_rgb, single precision,
both; compilation apart). Mitsuba takes the LLVM that DRJIT_LIBLLVM_PATH names; without it that row is empty.
"""

import argparse
import csv
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from evaluate import best_of, directions, mitsuba_is_there, theirs
from rich.console import Console
from rich.table import Table

import data_loaders as dl
import jaxbrdf as jb

PAIRS = 1_000_000
LINES = 100_000
MODEL = jb.Lambertian(jnp.array([0.3, 0.2, 0.1])) + 0.2 * jb.Microfacet(
    jb.TrowbridgeReitz(0.1), jb.Schlick(0.04), jb.HeightCorrelated()
)


class Row(NamedTuple):
    """One comparison, in seconds; None where the rival is missing."""

    what: str
    ours: float
    rival: str
    theirs: float | None


def merl(path: Path, folder: Path, repeat: int) -> Iterator[Row]:
    table, copy = dl.read_merl(path), folder / "copy.binary"
    values = np.array(table.raw)

    def one_pass():
        return np.fromfile(path, "<f8", offset=12).sum()

    def plain_write():
        copy.write_bytes(np.moveaxis(values, -1, 0).astype("<f8").tobytes())

    once = best_of(repeat, one_pass)
    yield Row("MERL, slices", best_of(repeat, lambda: dl.read_merl_slices(path)), "one pass", once)
    yield Row("MERL, whole, checked", best_of(repeat, lambda: dl.read_merl(path)), "one pass", once)
    ours = best_of(repeat, lambda: dl.write_merl(copy, table))
    yield Row("MERL, written", ours, "tobytes", best_of(repeat, plain_write))


def text(folder: Path, repeat: int) -> Iterator[Row]:
    rng = np.random.default_rng(0)
    angles = rng.uniform(0, 1.5, (4, LINES))
    samples = jb.MeasuredSamples(*angles, rng.uniform(0, 1, (LINES, 3)), np.ones(LINES))
    numbers = np.column_stack([*angles, samples.values])
    for suffix, read, write, comma in (
        ("csv", dl.read_csv, dl.write_csv, ","),
        ("alta", dl.read_alta, dl.write_alta, " "),
    ):
        path, plain = folder / f"ours.{suffix}", folder / f"plain.{suffix}"
        ours = best_of(repeat, lambda write=write, path=path: write(path, samples))
        theirs = best_of(
            repeat, lambda plain=plain, comma=comma: np.savetxt(plain, numbers, "%.17g", delimiter=comma)
        )
        yield Row(f"{suffix.upper()}, {LINES:,} lines written", ours, "savetxt", theirs)
        ours = best_of(repeat, lambda read=read, path=path: read(path))
        theirs = best_of(repeat, lambda plain=plain, comma=comma: np.loadtxt(plain, delimiter=comma))
        yield Row(f"{suffix.upper()}, {LINES:,} lines read", ours, "loadtxt", theirs)


def rgl(path: Path, repeat: int) -> Iterator[Row]:
    yield Row("RGL, read", best_of(repeat, lambda: dl.read_rgl(path)), "", None)
    brdf = jax.tree.map(jnp.asarray, dl.read_rgl(path).anonymous)
    wi, wo = directions(PAIRS)
    evaluate = eqx.filter_jit(lambda brdf, wi, wo: brdf(wi, wo))
    placed = jnp.array(wi, np.float32), jnp.array(wo, np.float32)
    ours = best_of(repeat, lambda: evaluate(brdf, *placed).block_until_ready())
    yield Row(f"RGL, {PAIRS:,} pairs", ours, "Mitsuba", mitsuba(path, wi, wo, repeat))


def mitsuba(path: Path, wi: np.ndarray, wo: np.ndarray, repeat: int) -> float | None:
    """Seconds of the plugin's `eval`; None where there is no Mitsuba or no LLVM."""
    if not mitsuba_is_there():
        return None
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    return theirs({"type": "measured", "filename": str(path)}, wi, wo, repeat) * len(wi) / 1e9


def print_table(rows: list[Row]) -> None:
    table = Table("", "ms", "rival", "its ms", "ratio")
    for row in rows:
        theirs = [f"{1e3 * row.theirs:.1f}", f"{row.ours / row.theirs:.2f}"] if row.theirs else ["", ""]
        table.add_row(row.what, f"{1e3 * row.ours:.1f}", row.rival, *theirs)
    Console().print(table)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--rgl", type=Path, help="an RGL file, instead of one made here")
    parser.add_argument("--merl", type=Path, help="a MERL file, instead of one made here")
    parser.add_argument("--csv", type=Path, help="write the numbers here")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = args.merl or folder / "made.binary", args.rgl or folder / "made.bsdf"
        for path, given in zip(paths, (args.merl, args.rgl), strict=True):
            if given is None:
                dl.write_brdf(path, MODEL)
        rows = [
            *merl(paths[0], folder, args.repeat),
            *rgl(paths[1], args.repeat),
            *text(folder, args.repeat),
        ]
    print_table(rows)
    if args.csv:
        with args.csv.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(Row._fields)
            writer.writerows(rows)


if __name__ == "__main__":
    main()
