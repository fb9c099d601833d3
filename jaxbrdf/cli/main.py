"""The command `jaxbrdf`: names, options and help.

Only signatures live here. Each command's work is a module of its own, imported when the command is
called: `--help` answers at once and imports neither JAX nor numpy nor matplotlib.
"""

from collections.abc import Callable
from enum import StrEnum
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


class Recipe(StrEnum):
    """What a fit minimises."""

    slices = "slices"
    slices_linear = "slices+linear"
    full = "full"


Out = Annotated[
    Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for the results; made if missing.")
]
Json = Annotated[
    bool, typer.Option("--json", help="Write one JSON document to standard output, and nothing else.")
]
Pictures = Annotated[bool, typer.Option("--pictures/--no-pictures", help="Draw NAME.png for each material.")]
Scans = Annotated[
    list[Path],
    typer.Argument(metavar="SCANS", help="Height maps of profilometers, or folders of them: one data set."),
]
Sigma = Annotated[
    float | None,
    typer.Option(metavar="UM", help="Radius of the filter, µm. [default: 1, or 1.5 pixels if more]"),
]
Level = Annotated[
    str,
    typer.Option(metavar="FORM", help="Form taken off each scan: **none**, **plane** or **quadratic**."),
]
RejectOutliers = Annotated[
    bool, typer.Option("--reject-outliers", help="Mask spikes out before anything else.")
]
Unit = Annotated[
    str | None,
    typer.Option(metavar="UNIT", help="Unit of heights where a file does not say it: um, nm, …."),
]
Pixel = Annotated[
    float | None, typer.Option(metavar="UM", help="Pixel size where a file does not say it, µm.")
]
Picture = Annotated[bool, typer.Option("--picture/--no-picture", help="Draw FILE.png.")]


def main() -> None:
    """Entry point of the console script."""
    app(prog_name="jaxbrdf")


def _print_version(wanted: bool) -> bool:
    if wanted:
        typer.echo(f"jaxbrdf {installed_version('jaxbrdf')}")
        raise typer.Exit
    return wanted


@app.callback()
def describe(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and stop."),
    ] = False,
) -> None:
    """Fit compact reflectance models to measured BRDFs.

    Exit status: 0 all good; 1 some file failed and the others are done; 2 no file could be used, or the
    arguments are wrong; 130 interrupted, with what was finished in place.
    """


@app.command()
def fit(
    files: Annotated[list[Path], typer.Argument(metavar="FILES", help="Measured BRDFs, e.g. MERL *.binary.")],
    out: Out,
    model: Annotated[
        str, typer.Option(metavar="NAME", help="Model to fit: shifted-gamma.")
    ] = "shifted-gamma",
    recipe: Annotated[
        Recipe,
        typer.Option(
            metavar="RECIPE",
            help="**slices**: the two slices of the published procedure; **slices+linear**: then the linear "
            "coefficients on the table; **full**: then every parameter on the whole table.",
        ),
    ] = Recipe.slices_linear,
    json: Json = False,
    pictures: Pictures = True,
    force: Annotated[
        bool, typer.Option("--force", help="Fit again what an earlier run has finished.")
    ] = False,
) -> None:
    """Fit a reflectance model to each measured BRDF.

    For every file NAME.* the folder gets NAME.h5 (the fit), NAME.json (its parameters and errors) and
    NAME.png (measurement against fit). A table of all fits goes to standard output.

    A file that cannot be read is reported and the others go on. Run again after an interrupt, the command
    keeps what is finished: same file, same model and recipe, results newer than the file.

    **Examples**

    jaxbrdf fit nickel.binary --out fits

    jaxbrdf fit merl/*.binary --out fits --recipe full --no-pictures

    jaxbrdf fit nickel.binary --out fits --json | python -m json.tool
    """
    from jaxbrdf.cli.fit import FitTask, run

    task = FitTask(out, model, recipe.value, with_pictures=pictures, force=force)
    _exit_with(lambda: run(files, task, as_json=json))


@app.command()
def compare(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILES", help="Measured BRDFs in any format, or published MODEL:MATERIAL."),
    ],
    models: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="Models, with commas between: lambertian, lafortune, ward, ashikhmin-shirley, beckmann, "
            "ggx, student-t, abc, sgd-slices, sgd-linear, sgd, sgd+lobe, free-form.",
        ),
    ] = "lambertian,ward,beckmann,ggx,student-t,abc,sgd,sgd+lobe,free-form",
    loss: Annotated[
        str,
        typer.Option(
            metavar="LOSS",
            help="What fits minimise: **l2**, **log**, **cube_root**, **log_ratio**, or **image**: of these "
            "the one whose lit sphere looks closest. The recipes of sgd have their own.",
        ),
    ] = "l2",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="DIR", help="Keep NAME.json, NAME.png and a summary here; made if missing."
        ),
    ] = None,
    json: Json = False,
    force: Annotated[
        bool, typer.Option("--force", help="Compare again what an earlier run has finished.")
    ] = False,
) -> None:
    """Fit many models to each measured BRDF and compare their errors.

    The table gives, as means over the channels, the normalized L2, log and cube-root errors over directions
    below 80°, the mean difference ΔE in CIE Lab of a lit sphere, how many numbers the model takes for a
    channel, and seconds. 'free-form' is no model: tables of D, F and G1, the bound of what facets can reach.

    With --out results are kept as they come, and the same command goes on after an interrupt: NAME.json,
    NAME.png (lobes and lit spheres), comparison.csv and, of several files, comparison.png.

    **Examples**

    jaxbrdf compare nickel.binary

    jaxbrdf compare merl/*.binary --models ggx,abc,sgd --out comparison

    jaxbrdf compare garnet.bsdf --loss image --json
    """
    from jaxbrdf.cli.compare import run

    names = [name.strip() for name in models.split(",") if name.strip()]
    _exit_with(lambda: run(files, names, loss, out, as_json=json, force=force))


@app.command()
def check(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILES",
            help="Fits (NAME.h5), measured BRDFs (*.binary), or published MODEL:MATERIAL.",
        ),
    ],
    json: Json = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw the albedos against incidence.")
    ] = None,
) -> None:
    """Check reflectances: negative values, reciprocity, energy, and whether samples fit.

    Albedo is the share of the light that is reflected in all; above 1, a reflectance creates energy. What is
    found is no error: the exit status tells of files that could not be read, and of nothing else.

    **Examples**

    jaxbrdf check fits/nickel.h5 nickel.binary

    jaxbrdf check sgd:chrome abc:chrome --plot albedo.png

    jaxbrdf check fits/*.h5 --json > checks.json
    """
    from jaxbrdf.cli.check import run

    _exit_with(lambda: run(files, as_json=json, plot=plot))


@app.command()
def convert(
    source: Annotated[
        Path, typer.Argument(metavar="IN", help="A reflectance in any format, or published MODEL:MATERIAL.")
    ],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="What to write: .binary (MERL), .bsdf (RGL), .h5 (HDF5), .alta (ALTA) or .csv.",
        ),
    ],
    rgb: Annotated[
        bool, typer.Option("--rgb", help="Make R, G and B of a spectrum, under daylight.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace OUT if it is there.")] = False,
    json: Json = False,
) -> None:
    """Convert a reflectance to another format, and say what that changed.

    Read are MERL, RGL, ALTA, Mini-Diff, Cornell, CSV and our HDF5, recognised by their content. What a format
    holds as it is comes back bit for bit; anything else is resampled, and the error is measured on what was
    written.

    **Examples**

    jaxbrdf convert chrome.binary chrome.bsdf

    jaxbrdf convert garnet_red.brdf garnet_red.binary --rgb

    jaxbrdf convert sgd:chrome chrome.csv
    """
    from jaxbrdf.cli.convert import run

    _exit_with(lambda: run(source, target, rgb=rgb, force=force, as_json=json))


@app.command()
def show(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILES", help="Reflectances in any format, or published MODEL:MATERIAL."),
    ],
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png",
            help="Draw slices, lobes and the image slice of one file; with --factors, its factors.",
        ),
    ] = None,
    factors: Annotated[
        bool,
        typer.Option(
            "--factors",
            help="Read the distribution D and the Fresnel term F off the data, and fit them: shifted gamma, "
            "GGX, Beckmann, and the free form that bounds what facets can do.",
        ),
    ] = False,
    json: Json = False,
) -> None:
    """Show what is in a file: format, directions, range, units, invalid samples, albedo.

    **Examples**

    jaxbrdf show chrome.binary

    jaxbrdf show C8_Silver.astm --plot silver.png

    jaxbrdf show *.bsdf --json

    jaxbrdf show brass.binary --factors --plot factors.png
    """
    from jaxbrdf.cli.show import run

    _exit_with(lambda: run(files, as_json=json, plot=plot, with_factors=factors))


@app.command()
def ndf(
    scans: Scans,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE.h5", help="The table; its picture beside it.")
    ],
    method: Annotated[
        str,
        typer.Option(
            metavar="METHOD",
            help="**filtered**: normals of planes fitted around each point; **facet**: those of the facets; "
            "**kirchhoff**: diffraction at --wavelength.",
        ),
    ] = "filtered",
    sigma: Sigma = None,
    wavelength: Annotated[
        float, typer.Option(metavar="UM", help="Effective wavelength of kirchhoff, µm.")
    ] = 0.555,
    patch: Annotated[
        float, typer.Option(metavar="UM", help="Side of the patches in which light is coherent, µm.")
    ] = 70.0,
    level: Level = "plane",
    reject_outliers: RejectOutliers = False,
    size: Annotated[int, typer.Option(metavar="N", help="Cells of the table along the disk, odd.")] = 1025,
    unit: Unit = None,
    pixel: Pixel = None,
    picture: Picture = True,
    force: Annotated[bool, typer.Option("--force", help="Replace FILE.h5 if it is there.")] = False,
    json: Json = False,
) -> None:
    """Estimate the distribution of normals of measured height maps.

    All scans together make one table of D over the unit disk, in 1/sr, written as HDF5. An ellipsoid, GGX and
    Beckmann are fitted to it; the picture has the disk and slices across and along. Files that cannot be read
    are reported, and the others go on; after an interrupt nothing is written.

    **Examples**

    jaxbrdf ndf land.x3p --out land.h5

    jaxbrdf ndf steel/ --method kirchhoff --wavelength 0.555 --out steel.h5

    jaxbrdf ndf wafer.opd --level quadratic --reject-outliers --out wafer.h5 --json
    """
    from jaxbrdf.cli.ndf import Options, run
    from jaxbrdf.cli.scans import Treatment

    treatment = Treatment(level, not reject_outliers, unit, pixel)
    options = Options(method, sigma, wavelength, patch, size, treatment)
    _exit_with(lambda: run(scans, out, options, as_json=json, picture=picture, force=force))


@app.command()
def patches(
    scans: Scans,
    size: Annotated[float, typer.Option(metavar="UM", help="Side of the patches, µm.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE.h5", help="The maps; their picture beside them.")
    ],
    stride: Annotated[
        float | None, typer.Option(metavar="UM", help="From patch to patch, µm. [default: side by side]")
    ] = None,
    loss: Annotated[
        str,
        typer.Option(metavar="LOSS", help="What fits minimise: **likelihood** of the normals, or **l2**."),
    ] = "likelihood",
    cells: Annotated[int, typer.Option(metavar="N", help="Cells of each patch's table along a side.")] = 65,
    sigma: Sigma = None,
    level: Level = "plane",
    reject_outliers: RejectOutliers = False,
    unit: Unit = None,
    pixel: Pixel = None,
    picture: Picture = True,
    force: Annotated[bool, typer.Option("--force", help="Begin anew if FILE.h5 is there.")] = False,
    json: Json = False,
) -> None:
    """Map how the distribution of normals varies over surfaces: an ellipsoid for each patch.

    Each scan gives images of the five parameters (roughness alpha_x, alpha_y; skew theta_x, theta_y;
    orientation theta_z), written to one HDF5 file as scan after scan is finished. The picture has some
    patches' distributions, with the fits over them, and the images. After an interrupt the same command goes
    on.

    KL is by how much the log-likelihood of each normal is lower under the fit than under the table itself;
    L2 is the relative error of `jaxbrdf ndf`.

    **Examples**

    jaxbrdf patches land.x3p --size 60 --out land-maps.h5

    jaxbrdf patches steel/ --size 53 --stride 26 --level quadratic --out steel-maps.h5 --json
    """
    from jaxbrdf.cli.patches import Options, run
    from jaxbrdf.cli.scans import Treatment

    treatment = Treatment(level, not reject_outliers, unit, pixel)
    options = Options(size, stride, sigma, loss, cells, treatment)
    _exit_with(lambda: run(scans, out, options, as_json=json, picture=picture, force=force))


@app.command()
def texture(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILES",
            help="Maps that `jaxbrdf patches` wrote: one file; or two of strips, along x and along y.",
        ),
    ],
    shape: Annotated[tuple[int, int], typer.Option(metavar="H W", help="Rows and columns of the texture.")],
    seed: Annotated[int, typer.Option(metavar="N", help="Another number, another texture.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE.h5", help="Where to. [default: beside the maps, as NAME.texture.h5]"
        ),
    ] = None,
    scan: Annotated[
        str | None, typer.Option(metavar="NAME", help="The scan to imitate. [default: that of most patches]")
    ] = None,
    separable: Annotated[
        bool, typer.Option("--separable", help="A spectrum that is a product of one along x and one along y.")
    ] = False,
    independent: Annotated[
        bool, typer.Option("--independent", help="Parameters that vary independently of each other.")
    ] = False,
    marginals: Annotated[
        bool,
        typer.Option(
            "--marginals/--normal", help="Distribute each parameter's values as in the maps, or normally."
        ),
    ] = True,
    picture: Picture = True,
    force: Annotated[bool, typer.Option("--force", help="Replace the texture if it is there.")] = False,
    json: Json = False,
) -> None:
    """Synthesise a surface of any size whose parameters vary as measured ones do.

    The spectrum of a map is kept, its phases are drawn anew. Two files, of strips along x and along y,
    are extended to a surface as in Dong et al. 2015. The table compares mean, spread, and how alike
    neighbours are.

    **Examples**

    jaxbrdf texture land-maps.h5 --shape 512 512

    jaxbrdf texture land-maps.h5 --shape 256 1024 --seed 7 --normal --out land-texture.h5

    jaxbrdf texture along.h5 across.h5 --shape 1024 1024 --out steel.h5
    """
    from jaxbrdf.cli.texture import Options, run

    options = Options(shape, seed, scan, separable, not independent, marginals)
    _exit_with(lambda: run(files, out, options, as_json=json, picture=picture, force=force))


@app.command()
def demo(out: Out = Path("jaxbrdf-demo")) -> None:
    """Fit three stand-in materials, to see what `jaxbrdf fit` does without a measurement at hand.

    The stand-ins are tables in MERL's layout, made on the spot from the ABC model parameters that Löw et
    al. published in 2012: not measurements.

    **Example**

    jaxbrdf demo --out jaxbrdf-demo
    """
    from jaxbrdf.cli.demo import run

    _exit_with(lambda: run(out))


def _exit_with(work: Callable[[], int]) -> None:
    """Do the work and exit with the status it returns; with 2 and a message where it refuses."""
    from jaxbrdf.cli.batch import Refused

    try:
        status = work()
    except Refused as refusal:
        typer.echo(f"jaxbrdf: {refusal}", err=True)
        status = 2
    raise typer.Exit(status)
