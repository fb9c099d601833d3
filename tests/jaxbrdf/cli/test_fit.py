"""`jaxbrdf fit` around a fit and a score that cost nothing; the real ones run in test_demo.py."""

import json
import os

import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from data_loaders import load_fit
from jaxbrdf import FitResult, ShiftedGammaBRDF
from jaxbrdf.cli import demo, fit
from jaxbrdf.cli.main import app

SUFFIXES = ("h5", "json", "png")


def constant_fit(measured, recipe):
    """The same numbers for every material, in a batch as a real fit gives it."""
    shape = (len(measured), 3)
    numbers = (jnp.full(shape, x) for x in (0.1, 0.5, 0.2, 0.7, 0.05, 0.01))
    return FitResult(
        model=ShiftedGammaBRDF(*numbers),
        status=np.zeros(shape, int),
        cost=np.zeros(shape),
        steps=np.ones(shape, int),
        covariance=np.full((*shape, 2, 2), np.nan),
        residuals=np.zeros((*shape, 5)),
        parameters=("alpha", "p"),
        recipe=recipe,
        names=tuple(m.name for m in measured),
    )


def constant_score(model, measured):
    names = ("normalized_l2", "normalized_l2_below_80", "log_error_below_80")
    return {name: [0.5, 0.25, float("nan")] for name in names}


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Two readable files, 35 MB each."""
    folder = tmp_path_factory.mktemp("stand-ins")
    return [demo.write_stand_in(name, folder) for name in ("nickel", "red-plastic")]


@pytest.fixture
def bad(tmp_path):
    path = tmp_path / "bad.binary"
    path.write_bytes(b"no MERL file")
    return path


@pytest.fixture
def fits(monkeypatch):
    """Put the free fit and score in place; the list grows by the names of each call's materials."""
    calls = []

    def counting(measured, recipe):
        calls.append([m.name for m in measured])
        return constant_fit(measured, recipe)

    monkeypatch.setitem(fit.MODELS, "shifted-gamma", counting)
    monkeypatch.setattr(fit, "score", constant_score)
    return calls


def jaxbrdf_fit(*arguments):
    result = CliRunner().invoke(app, ["fit", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def outputs_of(*stems, suffixes=SUFFIXES):
    return sorted(f"{stem}.{suffix}" for stem in stems for suffix in suffixes)


def test_each_material_gets_a_fit_a_document_and_a_picture(good, fits, tmp_path):
    result = jaxbrdf_fit(good[0], "--out", tmp_path / "out")
    assert result.exit_code == 0
    assert names_in(tmp_path / "out") == outputs_of("abc-nickel")
    assert (tmp_path / "out" / "abc-nickel.png").read_bytes().startswith(b"\x89PNG")
    assert load_fit(tmp_path / "out" / "abc-nickel.h5").recipe == "slices+linear"


def test_the_table_has_a_row_for_each_channel(good, fits, tmp_path):
    result = jaxbrdf_fit(*good, "--out", tmp_path, "--no-pictures")
    rows = [line.split() for line in result.stdout.splitlines() if "converged" in line]
    assert [row[0] for row in rows] == ["abc-nickel", "G", "B", "abc-red-plastic", "G", "B"]
    assert rows[1] == ["G", "0.1", "0.5", "0.2", "0.7", "0.05", "0.01", "0.25", "0.25", "converged"]
    assert names_in(tmp_path) == outputs_of("abc-nickel", "abc-red-plastic", suffixes=("h5", "json"))


def test_json_is_all_there_is_on_standard_output(good, bad, fits, tmp_path):
    result = jaxbrdf_fit(*good, bad, "--out", tmp_path / "out", "--json", "--no-pictures", "--recipe", "full")
    nickel, plastic, failed = json.loads(result.stdout)
    assert nickel["normalized_l2"] == [0.5, 0.25, None]
    assert nickel["recipe"] == "full"
    assert nickel["files"]["fit"] == str(tmp_path / "out" / "abc-nickel.h5")
    assert (plastic["name"], failed["name"]) == ("abc-red-plastic", "bad")
    assert "expected" in failed["error"]


def test_a_bad_file_is_status_1_and_the_good_one_is_done(good, bad, fits, tmp_path):
    result = jaxbrdf_fit(bad, good[0], "--out", tmp_path / "out", "--no-pictures")
    assert result.exit_code == 1
    assert f"{bad}: expected" in result.stderr
    assert names_in(tmp_path / "out") == outputs_of("abc-nickel", suffixes=("h5", "json"))


def test_nothing_readable_is_status_2_and_makes_no_folder(bad, fits, tmp_path):
    result = jaxbrdf_fit(bad, tmp_path / "absent.binary", tmp_path, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert [line.partition(": expected")[0] for line in result.stderr.splitlines()] == [
        str(path) for path in (bad, tmp_path / "absent.binary", tmp_path)
    ]
    assert not (tmp_path / "out").exists()
    assert fits == []


def test_an_output_folder_keeps_what_is_in_it(good, bad, fits, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    jaxbrdf_fit(good[0], bad, "--out", tmp_path, "--no-pictures")
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert names_in(tmp_path) == ["abc-nickel.h5", "abc-nickel.json", "bad.binary", "notes.txt"]


@pytest.fixture
def again(good, fits, tmp_path):
    """A function that fits the first file again into the same folder; the first time has been."""

    def run(*options):
        fits.clear()
        return jaxbrdf_fit(good[0], "--out", tmp_path, "--no-pictures", *options)

    run()
    return run


def test_a_finished_fit_is_kept_and_shown(again, fits):
    result = again()
    assert fits == []
    assert result.exit_code == 0
    assert "abc-nickel" in result.stdout
    assert "kept" in result.stdout
    assert "--force" in result.stderr
    assert json.loads(again("--json").stdout)[0]["kept"]


def test_force_another_recipe_and_a_newer_file_are_fitted_again(again, good, fits):
    again("--force")
    assert fits == [["abc-nickel"]]
    again("--recipe", "slices")
    assert fits == [["abc-nickel"]]
    again("--recipe", "slices")
    assert fits == []
    os.utime(good[0])
    again("--recipe", "slices")
    assert fits == [["abc-nickel"]]


def test_a_damaged_result_and_another_file_of_that_name_are_fitted_again(again, good, fits, tmp_path):
    (tmp_path / "abc-nickel.h5").write_bytes(b"")
    again()
    assert fits == [["abc-nickel"]]
    (tmp_path / "elsewhere").mkdir()
    twin = tmp_path / "elsewhere" / good[0].name
    twin.symlink_to(good[1])
    fits.clear()
    jaxbrdf_fit(twin, "--out", tmp_path, "--no-pictures")
    assert fits == [["abc-nickel"]]


def test_missing_pictures_are_made(again, fits, good, tmp_path):
    jaxbrdf_fit(good[0], "--out", tmp_path)
    assert (tmp_path / "abc-nickel.png").exists()


@pytest.mark.parametrize("interrupted", ["figure", "fit"])
def test_an_interrupt_leaves_whole_files_and_status_130(good, fits, tmp_path, monkeypatch, interrupted):
    """Ctrl-C while the second material's picture, or its fit, is being written."""
    save = {"figure": "matplotlib.figure.Figure.savefig", "fit": "jaxbrdf.cli.fit.save_fit"}[interrupted]
    module, _, name = save.rpartition(".")
    original = fit.save_fit if interrupted == "fit" else fit.pictures.Figure.savefig
    calls = []

    def second_time_interrupted(*arguments, **options):
        calls.append(arguments)
        original(*arguments, **options)
        if len(calls) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(f"{module}.{name}", second_time_interrupted)
    result = jaxbrdf_fit(*good, "--out", tmp_path)
    assert result.exit_code == 130
    assert "interrupted: 1 of 2" in result.stderr
    assert "abc-nickel" in result.stdout
    assert set(outputs_of("abc-nickel")) <= set(names_in(tmp_path))
    assert set(names_in(tmp_path)) <= set(outputs_of("abc-nickel", "abc-red-plastic"))
    assert "abc-red-plastic.json" not in names_in(tmp_path)


def test_what_makes_no_sense_is_refused_before_any_work(good, fits, tmp_path):
    (tmp_path / "file").touch()
    twin = tmp_path / good[0].name
    for arguments, message in [
        ((good[0], "--out", tmp_path / "file"), "is a file"),
        ((good[0], twin, "--out", tmp_path), "would all be named 'abc-nickel'"),
        ((good[0], "--out", tmp_path, "--model", "ggx"), "there are: shifted-gamma"),
        ((tmp_path / "x.json", "--out", tmp_path), "overwrite"),
    ]:
        result = jaxbrdf_fit(*arguments)
        assert result.exit_code == 2
        assert message in result.stderr
    assert fits == []
    assert names_in(tmp_path) == ["file"]
