"""Importing costs nothing that the caller did not ask for, and every public name is there."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

import jaxbrdf

HEAVY = ["optimistix", "lineax", "jaxopt", "h5py", "matplotlib", "rich", "typer", "fitting", "data_loaders"]


def modules_after(statement: str) -> set[str]:
    """The names in sys.modules of a fresh interpreter that has run the statement."""
    code = f"{statement}\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(json.loads(run.stdout.splitlines()[-1]))


@pytest.mark.parametrize("package", ["jaxbrdf", "fitting", "data_loaders"])
def test_a_package_alone_imports_neither_jax_nor_numpy(package):
    heavy = {"jax", "jaxlib", "numpy", "scipy", "equinox", *HEAVY} - {package}
    assert not modules_after(f"import {package}") & heavy


def test_a_model_imports_nothing_heavy_beyond_jax_and_equinox():
    """In place of a timed test: what makes an import slow is what it imports."""
    ground = modules_after("import jax, jax.numpy, equinox, jaxtyping, numpy.polynomial")
    extra = modules_after("import jaxbrdf; jaxbrdf.ShiftedGamma") - ground
    allowed = {"jaxbrdf", "lazy_loader", *sys.stdlib_module_names}
    assert {name.partition(".")[0] for name in extra} <= allowed


def test_all_optics_together_import_no_solver_file_format_or_picture():
    names = modules_after("import jaxbrdf; [getattr(jaxbrdf, name) for name in jaxbrdf.__all__]")
    assert not {name.partition(".")[0] for name in names} & set(HEAVY)


@pytest.mark.parametrize("package", ["jaxbrdf", "fitting", "data_loaders"])
def test_every_public_name_resolves(package):
    code = f"import {package} as p\nassert p.__all__\nfor name in p.__all__: getattr(p, name)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def test_the_stub_lists_what_it_imports():
    """__all__ of the stub and its import lines are kept by hand: they must agree."""
    tree = ast.parse(Path(jaxbrdf.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    lines = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    imported = {alias.asname or alias.name for line in lines for alias in line.names}
    assert imported == set(jaxbrdf.__all__)


def test_importing_leaves_jaxs_configuration_alone():
    code = (
        "import jax; before = dict(jax.config.values)\n"
        "import jaxbrdf; [getattr(jaxbrdf, name) for name in jaxbrdf.__all__]\n"
        "assert dict(jax.config.values) == before"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
