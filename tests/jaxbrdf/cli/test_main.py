"""The command line itself: help at once, the version, wrong arguments."""

import subprocess
import sys

import pytest
from typer.testing import CliRunner

from jaxbrdf.cli.main import app

_HEAVY = ("jax", "jaxlib", "numpy", "scipy", "matplotlib", "optimistix", "equinox", "h5py")


@pytest.mark.parametrize(
    "arguments", [["--help"], ["fit", "--help"], ["check", "--help"], ["demo", "-h"], ["--version"]]
)
def test_help_imports_nothing_heavy(arguments):
    code = (
        "import sys; from jaxbrdf.cli.main import main\n"
        "try: main()\n"
        f"finally: print([m for m in {_HEAVY} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip()
    assert done.stderr.strip() == "[]"


def test_every_command_has_an_example():
    for command in ("fit", "check", "demo"):
        assert f"jaxbrdf {command} " in CliRunner().invoke(app, [command, "--help"]).output


def test_without_arguments_it_shows_its_help():
    assert "Usage" in CliRunner().invoke(app, []).output


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit"],
        ["fit", "a.binary"],
        ["fit", "--out", "x"],
        ["fit", "a.binary", "--out", "x", "--recipe", "cake"],
        ["fly"],
    ],
)
def test_wrong_arguments_are_status_2(arguments):
    assert CliRunner().invoke(app, arguments).exit_code == 2
