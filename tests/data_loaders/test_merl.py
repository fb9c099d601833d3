"""MERL files: the layout against numpy, bit-exact round trips, slices by their pages, and bad files named."""

import os
import shutil
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_loaders import DataError, read_brdf, read_merl, read_merl_slices, write_merl
from jaxbrdf import HalfDifferenceGrid, MeasuredBRDF, merl_grid

HEADER, SIZE = 12, 12 + 8 * 3 * 90 * 90 * 180
SCALE = np.array([1.0, 1.15, 1.66]) / 1500
READERS = [read_merl, read_merl_slices, read_brdf]
VERY_FEW = settings(max_examples=8, deadline=None)


def holes(path, size, dimensions=(90, 90, 180)):
    """A file of a given header and size that takes no room: everything else is zero."""
    with open(path, "wb") as file:
        file.write(np.array(dimensions, "<i4").tobytes())
        file.truncate(size)
    return path


def fault(reader, path) -> DataError:
    with pytest.raises(DataError) as caught:
        reader(path)
    text = str(caught.value)
    assert text == f"{path}: expected {caught.value.expected}, found {caught.value.found}"
    assert "\n" not in text
    return caught.value


# Reading


def test_read_merl_gives_the_table_channels_last(known_file, table):
    measured = read_merl(known_file)
    assert measured.raw.shape == (90, 90, 180, 3)
    np.testing.assert_array_equal(measured.raw, np.moveaxis(table, 0, -1))
    np.testing.assert_array_equal(measured.scale, SCALE)
    assert measured.name == "known.stuff"


def test_values_are_in_per_steradian_and_nan_where_invalid(known_file, table):
    values = read_merl(str(known_file)).values
    expected = np.where(table >= 0, table, np.nan) * SCALE[:, None, None, None]
    np.testing.assert_allclose(values, np.moveaxis(expected, 0, -1), rtol=1e-15)


def test_the_table_stays_on_the_disk(known_file):
    read_merl(known_file)  # what is imported and compiled on first use is not counted
    tracemalloc.start()
    measured = read_merl(known_file)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert isinstance(measured.raw.base, np.memmap)
    assert not measured.raw.flags.writeable
    assert peak < 2e6


def test_read_brdf_knows_merl_by_content_and_by_suffix(known_file, tmp_path):
    other = tmp_path / "material.dat"
    os.link(known_file, other)
    assert read_brdf(other).name == "material"
    assert "450" in fault(read_brdf, holes(tmp_path / "x.BINARY", SIZE, (450, 90, 180))).found


@pytest.mark.parametrize("content", [b"", b"# a table\n1 2 3\n", bytes(range(40))])
def test_read_brdf_lists_what_it_understands(tmp_path, content):
    path = tmp_path / "material.dat"
    path.write_bytes(content)
    assert "MERL (.binary)" in fault(read_brdf, path).expected


# Slices


def test_slices_are_those_of_the_whole_table(known_file):
    whole, alone = read_merl(known_file).slices(), read_merl_slices(known_file)
    for field in ("theta_h", "m_h", "theta_d", "m_d", "theta_h_mirror"):
        np.testing.assert_array_equal(getattr(alone, field), getattr(whole, field), strict=True)


def test_slices_are_means_over_the_valid_samples(known_file, table):
    slices, valid = read_merl_slices(known_file), table >= 0
    with np.errstate(invalid="ignore"):  # 0 / 0 where nothing is valid
        mean = (table * valid).sum(axis=-1) / valid.sum(axis=-1) * SCALE[:, None, None]
    assert np.isnan(slices.m_h[30, 1])
    np.testing.assert_allclose(slices.m_h, mean[:, :, 0].T, rtol=1e-13)
    np.testing.assert_allclose(slices.m_d, mean[:, 0, :].T, rtol=1e-13)
    np.testing.assert_allclose(slices.theta_h, np.pi / 2 * ((np.arange(90) + 0.5) / 90) ** 2)
    np.testing.assert_allclose(slices.theta_d, np.deg2rad(np.arange(90) + 0.5))
    assert slices.theta_h_mirror == slices.theta_h[0]


def test_only_the_slices_are_looked_at(known_file, table, tmp_path):
    expected = read_merl_slices(known_file)
    path = shutil.copyfile(known_file, tmp_path / "poisoned.binary")
    poisoned = np.memmap(path, "<f8", mode="r+", offset=HEADER, shape=table.shape)
    poisoned[:, 1:, 1:] = np.nan
    poisoned.flush()
    slices = read_merl_slices(path)
    np.testing.assert_array_equal(slices.m_h, expected.m_h)
    np.testing.assert_array_equal(slices.m_d, expected.m_d)
    assert f"NaN or infinity in {3 * 89 * 89 * 180} of" in fault(read_merl, path).found


# Writing


def test_what_is_read_is_written_bit_for_bit(known_file, tmp_path):
    write_merl(tmp_path / "again.binary", read_merl(known_file))
    assert (tmp_path / "again.binary").read_bytes() == known_file.read_bytes()
    assert os.listdir(tmp_path) == ["again.binary"]


def test_a_file_may_be_written_onto_itself(known_file, tmp_path):
    path = shutil.copyfile(known_file, tmp_path / "same.binary")
    measured = read_merl(path)
    write_merl(path, measured)
    assert path.read_bytes() == known_file.read_bytes()
    assert float(measured.raw[3, 7, 3, 1]) == 0.0  # the old mapping still stands


def test_another_scale_is_rescaled(table, tmp_path):
    raw = np.moveaxis(np.where(table >= 0, table, np.nan), 0, -1)
    measured = MeasuredBRDF(raw, np.array([1.0, 1.0, 1.0]), merl_grid())
    write_merl(tmp_path / "scaled.binary", measured)
    back = read_merl(tmp_path / "scaled.binary")
    np.testing.assert_allclose(back.values, measured.values, rtol=1e-15)
    np.testing.assert_array_equal(np.unique(back.raw[back.raw < 0]), [-1])


def test_reflectance_that_merl_cannot_hold_is_refused(known_file, tmp_path):
    measured, path = read_merl(known_file), tmp_path / "refused.binary"
    grid = merl_grid()
    halved = HalfDifferenceGrid(grid.theta_h / 2, *(getattr(grid, f) for f in list(grid.__dict__)[1:]))
    with pytest.raises(ValueError, match="another grid"):
        write_merl(path, MeasuredBRDF(measured.raw, measured.scale, halved))
    with pytest.raises(ValueError, match="3 channels"):
        write_merl(path, MeasuredBRDF(measured.raw[..., :2], measured.scale[:2], grid))
    infinite = np.array(measured.raw)
    infinite[4, 5, 6, 2] = np.inf
    with pytest.raises(ValueError, match="infinite"):
        write_merl(path, MeasuredBRDF(infinite, measured.scale, grid))
    assert os.listdir(tmp_path) == []


def test_an_interrupted_write_leaves_the_old_file(known_file, tmp_path, monkeypatch):
    path = tmp_path / "old.binary"
    path.write_text("old")
    monkeypatch.setattr("data_loaders.merl._samples", lambda raw, ratio: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_merl(path, read_merl(known_file))
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["old.binary"]


# Bad files


@pytest.mark.parametrize("reader", READERS)
def test_missing_file_and_folder(reader, tmp_path):
    assert fault(reader, tmp_path / "missing.binary").found == "the error “No such file or directory”"
    assert fault(reader, tmp_path).found == "a folder"


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes in its file system")
def test_pipe_is_refused_and_not_waited_for(reader, tmp_path):
    os.mkfifo(tmp_path / "pipe.binary")
    assert "pipe" in fault(reader, tmp_path / "pipe.binary").found


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything")
def test_no_permission(known_file, tmp_path):
    path = shutil.copyfile(known_file, tmp_path / "secret.binary")
    path.chmod(0)
    assert "ermission" in fault(read_merl, path).found


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    "size", [12, 13, 19, 20, 4096, SIZE // 3, SIZE - 8, SIZE - 1, SIZE + 1, SIZE + 8, 2**33]
)
def test_wrong_size(reader, size, tmp_path):
    error = fault(reader, holes(tmp_path / "cut.binary", size))
    assert str(SIZE) in error.expected
    assert f"{size} bytes ({abs(size - SIZE)} too" in error.found


@pytest.mark.parametrize("reader", [read_merl, read_merl_slices])
@pytest.mark.parametrize("size", range(12))
def test_shorter_than_its_header(reader, size, known_file, tmp_path):
    path = tmp_path / "stub.binary"
    path.write_bytes(known_file.read_bytes()[:size])
    assert fault(reader, path).found.startswith("a" if size else "an empty file")


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    "dimensions",
    [(90, 90, 360), (0, 90, 180), (-90, -90, 180), (10**4, 10**4, 10**4), (2**31 - 1,) * 3, (1, 1, 1)],
)
def test_wrong_dimensions_are_said_and_not_allocated(reader, dimensions, tmp_path):
    path = holes(tmp_path / "odd.binary", SIZE, dimensions)
    tracemalloc.start()
    error = fault(reader, path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "90 × 90 × 180" in error.expected
    assert " × ".join(map(str, dimensions)) in error.found
    assert peak < 1e6


@pytest.mark.parametrize("text", ["90 90 180\n0.1 0.2 0.3\n", "θ_h θ_d φ_d\n", "x"])
def test_text_file(text, tmp_path):
    path = tmp_path / "table.binary"
    path.write_text(text, encoding="utf-8")
    for reader in READERS:
        assert repr(text.strip().splitlines()[0]) in fault(reader, path).found


def test_nothing_valid(tmp_path):
    path = tmp_path / "void.binary"
    with open(path, "wb") as file:
        file.write(np.array([90, 90, 180], "<i4").tobytes())
        np.full((3, 90, 90, 180), -1.0).tofile(file)
    for reader in READERS:
        error = fault(reader, path)
        assert "valid" in error.expected
        assert "negative" in error.found


@VERY_FEW
@given(
    places=st.sets(st.integers(0, (SIZE - HEADER) // 8 - 1), min_size=1, max_size=20),
    bits=st.sampled_from([0x7FF8 << 48, 0x7FF0 << 48, 0xFFF0 << 48, (0x7FF0 << 48) + 1, 0xFFFFFFFFFFFFFFFF]),
)
def test_numbers_that_are_none_are_counted(scratch_file, places, bits):
    words = np.memmap(scratch_file, "<u8", mode="r+", offset=HEADER)
    order = sorted(places)
    sound = words[order].copy()
    words[order] = bits
    try:
        assert f"NaN or infinity in {len(places)} of" in fault(read_merl, scratch_file).found
    finally:
        words[order] = sound


@VERY_FEW
@given(channel=st.integers(0, 2), node=st.integers(0, 89), phi=st.integers(0, 179), mirror=st.booleans())
def test_nan_in_a_slice_is_found_by_the_reader_of_slices(scratch_file, table, channel, node, phi, mirror):
    numbers = np.memmap(scratch_file, "<f8", mode="r+", offset=HEADER, shape=table.shape)
    place = (channel, 0, node, phi) if mirror else (channel, node, 0, phi)
    sound = numbers[place]
    numbers[place] = np.nan
    try:
        assert "NaN or infinity in" in fault(read_merl_slices, scratch_file).found
    finally:
        numbers[place] = sound


@settings(max_examples=40, deadline=None)
@given(head=st.binary(max_size=40))
def test_any_beginning_is_data_or_an_error_in_words(tmp_path_factory, head):
    path = tmp_path_factory.mktemp("any") / "any.binary"
    path.write_bytes(head)
    for reader in READERS:
        fault(reader, path)


# Against the reconstruction of the database


def test_reconstructed_material(merl_file):
    path = merl_file("gold-metallic-paint")
    measured, slices = read_merl(path), read_merl_slices(path)
    assert measured.name == "gold-metallic-paint"
    np.testing.assert_array_equal(measured.slices().m_h, slices.m_h)
    assert (slices.m_h[0] > slices.m_h[45]).all()  # a lobe
    assert np.isfinite(slices.m_d[:80]).all()
