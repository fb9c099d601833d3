"""The commands' precision and their cache of compiled programs."""

from pathlib import Path

import jax
import pytest

from jaxbrdf.cli import numerics


@pytest.fixture
def untouched():
    """No cache was chosen before; afterwards it is as it was."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    yield
    jax.config.update("jax_compilation_cache_dir", before)


def test_programs_are_kept_in_the_users_cache(untouched, monkeypatch, tmp_path):
    monkeypatch.setattr(numerics, "user_cache_path", lambda *_, **__: tmp_path / "jaxbrdf")
    numerics.prepare()
    assert jax.config.read("jax_enable_x64")
    assert Path(jax.config.jax_compilation_cache_dir) == tmp_path / "jaxbrdf" / "programs"


def test_where_that_cannot_be_they_are_not(untouched, monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setattr(numerics, "user_cache_path", lambda *_, **__: tmp_path / "file")
    numerics.prepare()
    assert jax.config.jax_compilation_cache_dir is None


def test_a_cache_that_was_chosen_stays(untouched, tmp_path):
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    numerics.prepare()
    assert jax.config.jax_compilation_cache_dir == str(tmp_path)
