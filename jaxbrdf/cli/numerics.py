"""How the commands compute: in double precision, with compiled programs kept for the next call."""

import os
from pathlib import Path

import jax
from platformdirs import user_cache_path


def prepare() -> None:
    """To be called once, before a command's first number.

    Compilation takes most of the time of a first call; the next one finds its programs in the user's cache
    folder (or in JAX_COMPILATION_CACHE_DIR). Where that cannot be written, it compiles again.
    """
    jax.config.update("jax_enable_x64", True)
    folder = user_cache_path("jaxbrdf", appauthor=False) / "programs"
    chosen = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    if chosen is None and _writable(folder):
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
