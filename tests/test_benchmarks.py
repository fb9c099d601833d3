"""The benchmark scripts: what they print, on made-up numbers; their runs are too long for a test."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import jaxbrdf as jb

SCRIPTS = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.fixture(autouse=True)
def as_run(monkeypatch):
    """A script that is run finds those beside it."""
    monkeypatch.syspath_prepend(SCRIPTS)


def load(name: str):
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("script", sorted(SCRIPTS.glob("*.py")), ids=lambda path: path.stem)
def test_every_script_says_how_it_is_run_and_what_it_found(script):
    assert f"    python benchmarks/{script.name}" in load(script.stem).__doc__
    assert f"## {script.name}: " in (SCRIPTS / "README.md").read_text(encoding="utf-8")


def test_every_reflectance_is_timed():
    timed = " ".join(load("evaluate").MODELS)
    parts = {"AshikhminShirleyLobe", "AshikhminShirleyDiffuse", "CoupledDiffuse"}
    kinds = {name for name in dir(jb) if isinstance(getattr(jb, name), type)}
    kinds = {name for name in kinds if issubclass(getattr(jb, name), jb.AbstractBRDF)}
    general = {"AbstractBRDF", "AbstractSum", "Sum", "Scaled"}
    assert [name for name in sorted(kinds - general - parts) if name not in timed] == []


def test_merl_error_counts_materials_and_channels(capsys, tmp_path):
    script = load("merl_error")
    ones = np.ones((2, 2, 3))  # materials, measures, channels
    errors = {"published": ones, "slices": 2 * ones, "slices+linear": ones.copy(), "full": ones / 2}
    errors["slices+linear"][0, 0, 1] = 3.0  # one channel's L2 grows, and its material is above the published
    script.print_table(["a", "b"], script.per_material(errors))
    script.print_summary(errors, dict.fromkeys(script.RECIPES, 1.0))
    script.write_csv(tmp_path / "errors.csv", ["a", "b"], errors)
    lines = {
        cells[1].strip(): cells
        for line in capsys.readouterr().out.splitlines()
        if (cells := line.split("│"))[1:]
    }
    assert [c.strip() for c in lines["slices"][2:4]] == ["0 of 2", "0 of 2"]
    assert [c.strip() for c in lines["slices+linear"][2:4]] == ["1 of 2", "2 of 2"]
    assert lines["slices+linear"][6].strip() == "1 of 6"
    assert lines["full"][6].strip() == "0 of 6"
    assert len((tmp_path / "errors.csv").read_text().splitlines()) == 1 + 4 * 2 * 3


def test_merl_models_counts_materials(capsys, tmp_path):
    script = load("merl_models")

    def row(material, model, loss, l2):
        errors = dict.fromkeys(script.ERRORS, f"{l2}")
        return {"material": material, "model": model, "loss": loss, "seconds": "", "status": "", **errors}

    rows = [row(m, "sgd", "own", x) for m, x in (("a", 1.0), ("b", 0.05))]
    rows += [row(m, "beckmann", "l2", 0.9) for m in ("a", "b")]
    script.write(tmp_path / "rows.csv", rows)
    errors = script.Errors(rows, ["a", "b", "missing"])
    script.print_models(errors)
    script.print_claims(errors)
    script.plot(errors, tmp_path / "errors.png")
    out = capsys.readouterr().out
    (claim,) = [line for line in out.splitlines() if "our sgd below our Beckmann" in line]
    assert [cell.strip() for cell in claim.split("│")[2:6]] == ["normalized_l2", "1 of 2", "0.583", "1"]
    assert len((tmp_path / "rows.csv").read_text().splitlines()) == 5
