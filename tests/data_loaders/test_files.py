"""Replacing a file whole or not at all, and errors that name the file."""

import os
import pickle
import stat

import pytest

from data_loaders import DataError
from data_loaders.files import describe, read_head, replacing


def test_the_new_file_appears_only_when_complete(tmp_path):
    path = tmp_path / "result"
    path.write_text("old")
    with replacing(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["result"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_failure_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "result"
    path.write_text("old")

    def half_write():
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        half_write()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["result"]


def test_a_new_file_has_the_usual_permissions(tmp_path):
    (tmp_path / "usual").write_text("")
    with replacing(tmp_path / "new") as temporary:
        temporary.write_text("")
    modes = {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("usual", "new")}
    assert len(modes) == 1


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "file").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    with replacing(tmp_path / "link") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "new"


def test_errors_of_the_system_name_the_target(tmp_path):
    missing = tmp_path / "missing" / "result"
    with pytest.raises(DataError, match="No such file") as caught, replacing(missing) as temporary:
        temporary.write_text("new")
    assert caught.value.path == missing
    with pytest.raises(DataError, match="directory"), replacing(tmp_path) as temporary:
        temporary.write_text("new")
    assert os.listdir(tmp_path) == []


def test_an_error_survives_the_way_between_processes():
    error = pickle.loads(pickle.dumps(DataError("a/b.binary", "one thing", "another")))
    assert str(error) == "a/b.binary: expected one thing, found another"


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (b"", "an empty file"),
        (b"\x89HDF\r\n\x1a\n\0\0", "an HDF5 file"),
        (b"\n#DIM 1 3\n", "a text file beginning '#DIM 1 3'"),
        (b"\0\1\2", "a binary file beginning with the bytes 00 01 02"),
    ],
)
def test_files_are_described_by_their_first_bytes(head, words):
    assert describe(head) == words


def test_read_head_reads_no_more_than_asked(tmp_path):
    (tmp_path / "file").write_bytes(bytes(100))
    assert read_head(tmp_path / "file", 10) == bytes(10)
