"""What the text formats share: any file is read or refused in words, in little memory."""

import os
import re
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from data_loaders import DataError, read_alta, read_cornell, read_csv, read_minidiff
from data_loaders.alta import is_alta
from data_loaders.cornell import is_cornell
from data_loaders.csv_table import is_csv
from data_loaders.merl import is_merl
from data_loaders.minidiff import is_minidiff

ALTA = (
    b'# tape\n#SAMPLE "x"\n#DIM 3 2\n#VS 1\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n#PARAM_OUT INV_STERADIAN\n'
)
CSV = b"# name: x\n# lamp\ntheta_i,phi_i_deg,theta_o,phi_o,weight,465nm,0.525um\n"
MINIDIFF = b"LAB_NAME x\n\nNUM_POINTS 3\nVARS theta_i,phi_i,theta_s,465nm,525nm\n\n"
SMALL = {
    "Cornell": b"# paint\r\n2\r\n# wls\r\n400 500\r\n\r\n" + b"0.1 0 0.2 3.14 0.5 0.25\r\n" * 3,
    "Mini-Diff": MINIDIFF + b"0.1,3.14,0.2,0,0.5,-1e-3\n" * 3,
    "ALTA": ALTA + b"0.3\t0.1\t-0.2\t0.5\t0.25\t0.1\n" * 3,
    "CSV": CSV + b"0.1,90,0.2,3.14,1,0.5,0.25\n" * 3,
}
READERS = {"Cornell": read_cornell, "Mini-Diff": read_minidiff, "ALTA": read_alta, "CSV": read_csv}
KNOWN = {"Cornell": is_cornell, "Mini-Diff": is_minidiff, "ALTA": is_alta, "CSV": is_csv, "MERL": is_merl}
REAL = {
    "cornell/garnet_red.brdf": "Cornell",
    "cornell/krylon_blue.brdf": "Cornell",
    "minidiff/C1_White.astm": "Mini-Diff",
    "minidiff/C8_Silver.astm": "Mini-Diff",
    "minidiff/C10_Copper.astm": "Mini-Diff",
    "minidiff/Metal_Blue.astm": "Mini-Diff",
    "retro/pink-felt-1d.alta": "ALTA",
    "retro/retro-gray-tape.dat": "ALTA",
}
DAMAGED = [path for path in REAL if path.startswith(("cornell/garnet", "minidiff/C1_", "retro/"))]
every_format = pytest.mark.parametrize("name", SMALL)


def outcome(name, path) -> DataError | None:
    """None where a sound record is read, else the error, which must be in words and on one line."""
    try:
        measured = READERS[name](path)
    except DataError as caught:
        error = caught
    else:
        check_sound(measured)
        return None
    assert str(error) == f"{path}: expected {error.expected}, found {error.found}"
    assert "\n" not in str(error)
    assert len(str(error)) < 1000
    return error


def check_sound(measured) -> None:
    n, channels = measured.values.shape
    assert n * channels > 0
    for field in ("theta_i", "phi_i", "theta_o", "phi_o", "values", "weights"):
        assert np.isfinite(getattr(measured, field)).all()
    assert measured.wavelengths is None or (measured.wavelengths > 0).all()
    assert (measured.weights >= 0).all()
    assert all(isinstance(line, str) and "\n" not in line for line in measured.origin)


def refused(name, path) -> DataError:
    error = outcome(name, path)
    assert error is not None
    return error


# Recognition


@pytest.mark.parametrize("cut", [4096, 400])
def test_each_real_file_is_recognised_by_its_own_format_alone(shared_data, cut):
    for path, name in REAL.items():
        head = (shared_data / path).read_bytes()[:cut]
        assert [known for known, begins in KNOWN.items() if begins(head)] == [name], path


@every_format
def test_each_small_file_is_recognised_by_its_own_format_alone(name):
    assert [known for known, begins in KNOWN.items() if begins(SMALL[name])] == [name]


@pytest.mark.parametrize(
    "head",
    [
        b"",
        b"\x89HDF\r\n\x1a\n",
        bytes(range(256)),
        b"# nothing\n",
        b"90 90 180\n",
        b"31\n",
        b"0.1 0.2 0.3\n0.1 0.2 0.3\n",
        b"a,b,c\n1,2,3\n",
        b"theta_i\n",
        b"# DIM 1 3\n0.1 0.2\n",
        b"wavelength,n,k\n400,1,2\n",
        b"\xff\xfe#\x00D\x00",
    ],
)
def test_other_files_are_recognised_by_none(head):
    assert not any(begins(head) for begins in KNOWN.values())


@settings(max_examples=40, deadline=None)
@given(
    head=st.binary(max_size=60) | st.text("#0123456789 ,.\nthea_iopVARSDIM\t", max_size=60).map(str.encode)
)
def test_recognition_never_fails(head):
    for begins in KNOWN.values():
        assert begins(head) in (True, False)


# Files that are none


@every_format
def test_missing_file_folder_and_pipe(name, tmp_path):
    assert "No such file" in refused(name, tmp_path / "missing").found
    assert refused(name, tmp_path).found == "a folder"
    os.mkfifo(tmp_path / "pipe")
    assert "pipe" in refused(name, tmp_path / "pipe").found


@every_format
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything")
def test_no_permission(name, tmp_path):
    path = tmp_path / "secret"
    path.write_bytes(SMALL[name])
    path.chmod(0)
    assert "ermission" in refused(name, path).found


@every_format
@pytest.mark.parametrize(
    "content", [b"", b"\n\n \t\n", b"#\n", bytes(1000), b"\x89HDF\r\n\x1a\n", b"\xff" * 99]
)
def test_files_without_content(name, content, tmp_path):
    path = tmp_path / "none"
    path.write_bytes(content)
    refused(name, path)


@every_format
def test_files_of_another_format(name, tmp_path):
    for other, content in SMALL.items():
        path = tmp_path / "other"
        path.write_bytes(content)
        assert (outcome(name, path) is None) == (name == other)


# Damage


@every_format
def test_cut_short_anywhere(name, tmp_path):
    content, path = SMALL[name], tmp_path / "cut"
    for size in range(len(content) - 40):
        path.write_bytes(content[:size])
        outcome(name, path)
    if name == "Mini-Diff":
        refused(name, path)


TOKENS = b'nan,-inf,1e999,1e308,-1,x,1_0,0x1p3,\0,",\xc3,\x1c,\xe2\x80\xa8,\r, ,#,\n'.split(b",")
TOKENS += [b"", b",", b"9" * 400, b"#VS 2\n", b"#DIM 1 1\n", b"VARS theta_i\n"]
damages = st.lists(
    st.tuples(
        st.sampled_from(["flip", "cut", "insert", "delete line", "double line", "zero"]),
        st.floats(0, 1),
        st.integers(0, 7),
        st.sampled_from(TOKENS),
    ),
    min_size=1,
    max_size=3,
)


def damaged(content: bytes, how, where: float, bit: int, token: bytes) -> bytes:
    """The content with a bit turned, cut, with a token put in, or with a line too few or too many."""
    at = int(where * (len(content) - 1)) if content else 0
    lines = content.splitlines(keepends=True)
    line = int(where * (len(lines) - 1)) if lines else 0
    return {
        "flip": lambda: content[:at] + bytes(b ^ 1 << bit for b in content[at : at + 1]) + content[at + 1 :],
        "cut": lambda: content[:at],
        "insert": lambda: content[:at] + token + content[at:],
        "zero": lambda: content[:at] + bytes(len(content[at : at + 8])) + content[at + 8 :],
        "delete line": lambda: b"".join(lines[:line] + lines[line + 1 :]),
        "double line": lambda: b"".join(lines[: line + 1] + lines[line:]),
    }[how]()


@every_format
@settings(max_examples=80, deadline=None)
@given(damage=damages)
def test_damaged_small_files(tmp_path_factory, name, damage):
    content = SMALL[name]
    for change in damage:
        content = damaged(content, *change)
    path = tmp_path_factory.mktemp("small") / "damaged"
    path.write_bytes(content)
    outcome(name, path)


@pytest.mark.parametrize("real", DAMAGED)
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(damage=damages, header=st.booleans())
def test_damaged_real_files(shared_data, tmp_path_factory, real, damage, header):
    content = (shared_data / real).read_bytes()
    head, tail = (content[:600], content[600:]) if header else (content, b"")
    for change in damage:
        head = damaged(head, *change)
    path = tmp_path_factory.mktemp("real") / "damaged"
    path.write_bytes(head + tail)
    outcome(REAL[real], path)


# Memory


def peak(name, path) -> tuple[int, DataError | None]:
    tracemalloc.start()
    found = outcome(name, path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most, found


@every_format
def test_memory_follows_the_size_of_the_file(name, tmp_path):
    content = SMALL[name].replace(b"NUM_POINTS 3", b"NUM_POINTS 5000")
    row = content.splitlines(keepends=True)[-1]
    (tmp_path / "long").write_bytes(content[: -3 * len(row)] + row * 5_000)
    outcome(name, tmp_path / "long")  # what is imported on first use is not counted
    most, error = peak(name, tmp_path / "long")
    assert error is None
    assert most < 12 * 5_000 * len(row)


@every_format
@pytest.mark.parametrize("filler", [b"#K\n", b"KEY x\n", b"9 ", b"9,", b"a"])
def test_endless_headers_and_lines_are_given_up(name, filler, tmp_path):
    size = 200_000
    (tmp_path / "endless").write_bytes(filler * (size // len(filler)))
    most, error = peak(name, tmp_path / "endless")
    assert error is not None
    assert most < 60 * size


@every_format
def test_a_line_of_many_megabytes_is_not_read(name, tmp_path):
    with open(tmp_path / "hole", "wb") as file:
        file.truncate(2**33)
    most, error = peak(name, tmp_path / "hole")
    assert error is not None
    assert most < 2**26


@every_format
@pytest.mark.parametrize("number", [b"1000000000000", b"9" * 30, b"9" * 5000, b"-5"])
def test_counts_that_no_file_holds(name, number, tmp_path):
    """Whatever number of the header is replaced: nothing is allocated for what is only announced."""
    header = len(SMALL[name]) - 3 * len(SMALL[name].splitlines(keepends=True)[-1])
    path = tmp_path / "count"
    for place in re.finditer(rb"\d+", SMALL[name][:header]):
        path.write_bytes(SMALL[name][: place.start()] + number + SMALL[name][place.end() :])
        most, _ = peak(name, path)
        assert most < 2e6
