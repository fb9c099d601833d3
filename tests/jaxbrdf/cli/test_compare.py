"""`jaxbrdf compare`: the table, JSON, what is kept, and models that cannot be fitted."""

import csv
import json

import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from data_loaders import write_brdf
from jaxbrdf import Lambertian, MeasuredBRDF, Microfacet, Schlick, TrowbridgeReitz, normalized_l2
from jaxbrdf.cli.main import app
from tests.fitting.made import GRID, table

GLOSSY = Lambertian(jnp.array([0.2, 0.3, 0.4])) + 0.7 * Microfacet(TrowbridgeReitz(0.2), Schlick(0.3))


def run(*arguments):
    return CliRunner().invoke(app, ["compare", *map(str, arguments)])


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """Two materials, one of them with a channel that holds nothing, compared into a folder."""
    folder = tmp_path_factory.mktemp("compared")
    write_brdf(folder / "glossy.h5", table(GLOSSY))
    raw = np.array(table(GLOSSY).raw)
    raw[..., 1] = -1
    write_brdf(folder / "gap.h5", MeasuredBRDF(raw, np.ones(3), GRID))
    files = folder / "glossy.h5", folder / "gap.h5", folder / "missing.h5"
    result = run(*files, "--models", "lambertian,ggx", "--out", folder / "out", "--json")
    return folder, result


def test_each_fit_holds_its_errors(compared):
    _, result = compared
    assert result.exit_code == 1  # one file is missing, the others are done
    glossy, gap, missing = json.loads(result.stdout)
    assert "error" in missing
    lambertian, ggx = glossy["fits"]
    assert [fit["model"] for fit in glossy["fits"]] == ["lambertian", "ggx"]
    assert max(ggx["normalized_l2"]) < 1e-3 < min(lambertian["normalized_l2"])
    assert ggx["lab_difference"] < 0.5 < lambertian["lab_difference"]
    assert (lambertian["parameter_count"], ggx["parameter_count"]) == (1, 4)
    np.testing.assert_allclose(ggx["parameters"]["terms[0].albedo"], [0.2, 0.3, 0.4], rtol=1e-3)
    np.testing.assert_allclose(
        lambertian["normalized_l2"],
        normalized_l2(
            Lambertian(jnp.array(lambertian["parameters"]["albedo"])), table(GLOSSY), np.radians(80)
        ),
        rtol=1e-6,
    )
    assert gap["fits"][1]["status"] == ["converged", "too_few_samples", "converged"]
    assert gap["fits"][1]["normalized_l2"][1] is None


def test_results_are_kept_and_shown(compared):
    folder, _ = compared
    out = folder / "out"
    assert {path.name for path in out.iterdir()} == {
        "glossy.json", "glossy.png", "gap.json", "gap.png", "comparison.csv", "comparison.png",
    }  # fmt: skip
    rows = list(csv.DictReader((out / "comparison.csv").read_text().splitlines()))
    assert len(rows) == 12
    assert {row["model"] for row in rows} == {"lambertian", "ggx"}
    before = (out / "glossy.json").stat().st_mtime_ns
    again = run(folder / "glossy.h5", "--models", "lambertian,ggx", "--out", out)
    assert again.exit_code == 0
    assert "1 of 1 kept from an earlier run" in again.stderr
    assert (out / "glossy.json").stat().st_mtime_ns == before
    assert "L2<80°" in again.stdout
    assert "ggx" in again.stdout


def test_another_question_is_not_answered_from_the_folder(compared):
    folder, _ = compared
    result = run(
        folder / "glossy.h5", "--models", "lambertian", "--loss", "log", "--out", folder / "out", "--json"
    )
    (document,) = json.loads(result.stdout)
    assert [fit["recipe"] for fit in document["fits"]] == ["log"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--models", "ggx,cake"], "no such model ['cake']; there are: lambertian, lafortune"),
        (["--loss", "huber"], "no such loss; there are: l2, log"),
        (["--models", ""], "no such model"),
    ],
)
def test_nonsense_is_refused(compared, arguments, words):
    folder, _ = compared
    result = run(folder / "glossy.h5", *arguments)
    assert result.exit_code == 2
    assert words in result.stderr


def test_no_input_is_overwritten(tmp_path):
    write_brdf(tmp_path / "comparison.csv", table(Lambertian(0.2)))
    before = (tmp_path / "comparison.csv").read_bytes()
    result = run(tmp_path / "comparison.csv", "--models", "lambertian", "--out", tmp_path)
    assert result.exit_code == 2
    assert "would overwrite" in result.stderr
    assert (tmp_path / "comparison.csv").read_bytes() == before


def test_a_spectrum_is_refused_with_advice(tmp_path):
    spectrum = MeasuredBRDF(np.ones((*GRID.shape, 9)), np.ones(9), GRID, wavelengths=np.linspace(0.4, 0.7, 9))
    write_brdf(tmp_path / "spectrum.h5", spectrum)
    result = run(tmp_path / "spectrum.h5", "--models", "lambertian")
    assert result.exit_code == 2
    assert "--rgb" in result.stderr
