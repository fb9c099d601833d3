"""What every test shares: double precision, strict shapes, checked annotations, and data if at hand."""

import gc
import importlib.util
import os
import sys
from pathlib import Path

import jax
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

# The gate tries the same examples every time; at one's desk every run tries new ones.
settings.register_profile("gate", derandomize=True, print_blob=True)
if os.environ.get("CI"):
    settings.load_profile("gate")

if str(ROOT) not in sys.path:  # `from tests.references import …`, however pytest was started
    sys.path.insert(0, str(ROOT))

# Every annotated call of the packages is checked for shape and dtype; must precede their first import.
install_import_hook(["jaxbrdf", "fitting", "data_loaders"], "beartype.beartype")


@pytest.fixture(autouse=True, scope="module")
def few_memory_maps():
    """Compiled programs keep memory maps, of which Linux lets a process have 65,530: forgotten in time."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_bytes().splitlines()) > 20_000:
        jax.clear_caches()
        gc.collect()


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory):
    """Commands that are tested leave nothing in the user's cache folder."""
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of measurements and published numbers beside the project; skips where it is absent."""
    path = SHARED / "data"
    if not path.is_dir():
        pytest.skip(f"no measurements at hand: {path.name}/ is looked for in ../{SHARED.name} of the project")
    return path


@pytest.fixture(scope="session")
def merl_file(shared_data, tmp_path_factory):
    """A function from a material's name to the path of its reconstructed MERL file, written on first use."""
    tool = SHARED / "tools" / "make_merl.py"
    if not tool.is_file():
        pytest.skip("no tool to reconstruct MERL files: tools/make_merl.py is looked for beside the data")
    import numpy as np

    spec = importlib.util.spec_from_file_location("make_merl", tool)
    assert spec is not None
    assert spec.loader is not None
    make_merl = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make_merl)
    with np.load(shared_data / "merl" / "merl_nbrdf_weights.npz") as archive:
        weights = dict(archive)
    names = [str(name) for name in weights["names"]]
    folder = tmp_path_factory.mktemp("merl")

    def write(name: str) -> Path:
        path = folder / f"{name}.binary"
        if not path.exists():
            make_merl.write(path, make_merl.table(weights, names.index(name)))
        return path

    return write


@pytest.fixture(scope="session")
def merl_material(merl_file):
    """A function from a material's name to its reconstructed MeasuredBRDF, as read_merl gives it."""
    from data_loaders import read_merl

    return lambda name: read_merl(merl_file(name))
