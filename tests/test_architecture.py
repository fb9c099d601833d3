"""The house plan as a test: who may import whom, and what the wheel holds."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ["jaxbrdf", "fitting", "data_loaders"]


@pytest.fixture(scope="module")
def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def lint(folder, *arguments):
    command = "from importlinter.cli import lint_imports_command as run; run()"
    return subprocess.run(
        [sys.executable, "-c", command, "--no-cache", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_import_contracts_are_kept():
    """Optics know no solver and no file, fitting and data_loaders never meet, no circles in the optics."""
    run = lint(ROOT)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "0 broken" in run.stdout


def test_a_broken_contract_is_found(tmp_path, project):
    """The same contracts over a house in which the optics read a file."""
    for package in PACKAGES:
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").touch()
    for contract in project["tool"]["importlinter"]["contracts"]:
        for module in contract.get("source_modules", []) + contract.get("forbidden_modules", []):
            if "." in module:
                (tmp_path / Path(*module.split("."))).with_suffix(".py").touch()
    (tmp_path / "jaxbrdf" / "metrics.py").write_text("import data_loaders\n")
    (tmp_path / ".importlinter").write_text(
        "[importlinter]\nroot_packages =\n    jaxbrdf\n    fitting\n    data_loaders\n"
        "[importlinter:contract:1]\nname = optics\ntype = forbidden\n"
        "source_modules =\n    jaxbrdf.metrics\nforbidden_modules =\n    data_loaders\n"
    )
    run = lint(tmp_path)
    assert run.returncode != 0
    assert "1 broken" in run.stdout


def test_every_module_of_the_optics_is_under_contract(project):
    """A new module must be named among the optics, so that the contracts hold for it too."""
    optics = project["tool"]["importlinter"]["contracts"][0]["source_modules"]
    modules = {
        path.stem
        for path in (ROOT / "jaxbrdf").iterdir()
        if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    assert {f"jaxbrdf.{name}" for name in modules - {"__init__", "cli"}} == set(optics)


def test_the_wheel_ships_exactly_three_packages(project):
    assert project["tool"]["hatch"]["build"]["targets"]["wheel"] == {"packages": PACKAGES}
    for package in PACKAGES:
        assert (ROOT / package / "__init__.py").is_file()


def test_packages_are_typed_for_their_users():
    assert (ROOT / "jaxbrdf" / "py.typed").is_file()
