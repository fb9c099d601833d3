"""Height maps from numpy's files, ours, and real profilometers' files against a reading by hand."""

import struct
import sys
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest

from data_loaders import DataError, read_heightfield, scan_files, write_heightfield
from jaxbrdf import Heightfield

Z = np.arange(12.0).reshape(3, 4) ** 1.5
MAPS = [
    "Hamby252_Barrel1_Bullet1_Land1.x3p",
    "metropro-1.dat",
    "mnt-2.mnt",
    "opd-1.opd",
    "x3p-2.x3p",
]


def test_ours_comes_back_bit_for_bit(tmp_path):
    mask = Z > 2
    for heightfield in (Heightfield(Z, 0.1, 1 / 3), Heightfield(Z, 0.1, 1 / 3, mask)):
        write_heightfield(tmp_path / "map.h5", heightfield, source="scan.opd")
        back = read_heightfield(tmp_path / "map.h5")
        np.testing.assert_array_equal(back.z, heightfield.z)
        assert (back.dx, back.dy) == (0.1, 1 / 3)
        np.testing.assert_array_equal(back.valid, heightfield.valid)


def test_numpy_files(tmp_path):
    holes = Z.copy()
    holes[1, 2] = np.nan
    np.save(tmp_path / "map.npy", holes)
    found = read_heightfield(tmp_path / "map.npy", unit="nm", pixel=(200, 300))
    assert (found.dx, found.dy) == (200, 300)  # a pixel is in µm whatever the heights are in
    np.testing.assert_array_equal(found.valid, np.isfinite(holes))
    np.testing.assert_allclose(np.diff(np.asarray(found.z)[0]), np.diff(Z[0]) / 1000)
    assert np.mean(np.asarray(found.z)[np.isfinite(holes)]) == pytest.approx(0, abs=1e-15)
    np.savez(tmp_path / "map.npz", z=Z, dx=0.5, mask=Z > 1)
    found = read_heightfield(tmp_path / "map.npz")
    assert (found.dx, found.dy) == (0.5, 0.5)
    np.testing.assert_array_equal(found.mask, Z > 1)


def by_hand_x3p(path):
    """Heights (ny, nx) and pixel sizes, metres, of an ISO 25178-72 file."""
    with zipfile.ZipFile(path) as archive:
        root = ElementTree.fromstring(archive.read("main.xml"))

        def text(name):
            return next(e.text for e in root.iter() if e.tag.rpartition("}")[2] == name)

        axes = [e for e in root.iter() if e.tag.rpartition("}")[2] in ("CX", "CY")]
        steps = [float(next(e.text for e in axis if e.tag == "Increment")) for axis in axes]
        raw = archive.read(text("PointDataLink"))
    kinds = {"D": "<f8", "F": "<f4"}
    kind = next(e.text for e in root.iter("CZ").__next__().iter("DataType"))
    return np.frombuffer(raw, kinds[kind]).reshape(int(text("SizeY")), int(text("SizeX"))), *steps


@pytest.mark.parametrize("name", [MAPS[0], MAPS[4]])
def test_x3p_is_what_is_in_the_archive(shared_data, name):
    path = shared_data / "surfaces" / name
    z, dx, dy = by_hand_x3p(path)
    found = read_heightfield(path)
    assert found.z.shape == z.shape
    assert found.dx == pytest.approx(1e6 * dx, rel=2e-3)
    assert found.dy == pytest.approx(1e6 * dy, rel=2e-3)
    known = np.isfinite(z)
    np.testing.assert_array_equal(found.valid, known)
    heights = 1e6 * z
    np.testing.assert_allclose(
        np.asarray(found.z)[known],
        (heights - heights[known].mean())[known],
        atol=1e-9 * np.ptp(heights[known]),
    )


def test_metropro_is_what_is_in_the_file(shared_data):
    """Zygo's binary format: big-endian, phases as 32-bit integers in units of wavelength · S · O / R."""
    path = shared_data / "surfaces" / "metropro-1.dat"
    raw = path.read_bytes()
    header = struct.unpack(">I", raw[6:10])[0]
    intensity = struct.unpack(">I", raw[60:64])[0]
    width, height = struct.unpack(">2H", raw[68:72])
    scale, wavelength = struct.unpack(">2f", raw[164:172])
    obliquity, lateral = struct.unpack(">f", raw[176:180])[0], struct.unpack(">f", raw[184:188])[0]
    resolution = {0: 4096, 1: 32768, 2: 131072}[struct.unpack(">H", raw[218:220])[0]]
    start = header + intensity
    phases = np.frombuffer(raw[start : start + 4 * width * height], ">i4").reshape(height, width)
    z = 1e6 * phases * (wavelength * scale * obliquity / resolution)
    found = read_heightfield(path)
    assert found.dx == pytest.approx(1e6 * lateral, rel=1e-6)
    known = np.asarray(found.valid)
    np.testing.assert_allclose(np.asarray(found.z)[known], (z - z[known].mean())[known], atol=1e-6)


def test_all_real_maps_are_plausible(shared_data):
    """Pixels of .1 to 3 µm, heights within .5 mm, and as much missing as their descriptions say."""
    missing = {"mnt-2.mnt": 0.037, "x3p-2.x3p": 0.0}
    for name in MAPS:
        found = read_heightfield(shared_data / "surfaces" / name)
        assert 0.05 < min(found.dx, found.dy) <= max(found.dx, found.dy) < 3, name
        valid = np.asarray(found.valid)
        assert np.ptp(np.asarray(found.z)[valid]) < 500, name
        if name in missing:
            assert 1 - valid.mean() == pytest.approx(missing[name], abs=2e-3), name
    land = read_heightfield(shared_data / "surfaces" / MAPS[0])
    slopes = [np.nanstd(np.diff(np.where(land.valid, land.z, np.nan), axis=axis)) for axis in (0, 1)]
    assert max(slopes) > 2 * min(slopes)  # striated


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("share", [0, 0.1, 0.6, 0.99])
def test_a_file_cut_short_is_a_data_error(shared_data, tmp_path, name, share):
    whole = (shared_data / "surfaces" / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(DataError, match=name):
        read_heightfield(tmp_path / name)


def test_bad_contents_are_explained(tmp_path):
    def message(name, *arrays, **named):
        path = tmp_path / name
        np.save(path, *arrays) if arrays else np.savez(path, **named)
        with pytest.raises(DataError) as caught:
            read_heightfield(path)
        return str(caught.value)

    assert "pixel=(dx, dy)" in message("a.npy", Z)
    assert "an array z of heights" in message("b.npz", heights=Z)
    assert "2 heights are NaN or infinite" in message("c.npz", z=np.where(Z > 30, np.inf, Z), dx=1)
    assert "no height was measured" in message("d.npz", z=np.full((3, 3), np.nan), dx=1)
    assert "at least 2" in message("e.npz", z=Z[:1], dx=1)
    assert "greater than 0; found 0" in message("f.npz", z=Z, dx=0)
    assert "the shape of z" in message("g.npz", z=Z, dx=1, mask=Z.T > 1)
    assert "an array of <U1" in message("h.npz", z=np.full((3, 3), "a"), dx=1)
    assert "one number each" in message("i.npz", z=Z, dx=[1, 2])


def test_what_is_no_height_map_is_explained(tmp_path):
    for name, content in {"a.npy": b"", "b.npz": b"PK", "c.sur": b"\0" * 99, "d.txt": b"hello"}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DataError, match=name):
            read_heightfield(tmp_path / name)
    with pytest.raises(DataError, match="folder"):
        read_heightfield(tmp_path)
    with pytest.raises(ValueError, match="unknown unit 'furlong'"):
        read_heightfield(tmp_path / "d.txt", unit="furlong")


def test_a_damaged_file_of_ours_is_a_data_error(tmp_path):
    path = tmp_path / "map.h5"
    write_heightfield(path, Heightfield(Z, 1, 1))
    whole = path.read_bytes()
    at = whole.index(Z.tobytes())
    path.write_bytes(whole[:at] + b"\1" + whole[at + 1 :])
    with pytest.raises(DataError, match=r"map\.h5"):
        read_heightfield(path)


def test_a_channel_is_chosen_by_name_or_number(shared_data):
    path = shared_data / "surfaces" / "opd-1.opd"
    np.testing.assert_array_equal(
        read_heightfield(path, channel="Raw").z, read_heightfield(path, channel=0).z
    )
    with pytest.raises(DataError, match="the channels Raw"):
        read_heightfield(path, channel="Cooked")


def test_without_the_library_its_name_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    (tmp_path / "a.opd").write_bytes(b"\1" * 100)
    with pytest.raises(DataError, match=r"pip install 'jaxbrdf\[scans\]'"):
        read_heightfield(tmp_path / "a.opd")


def test_a_folder_stands_for_its_scans(tmp_path):
    for name in ("b.OPD", "a.x3p", "notes.md"):
        (tmp_path / name).touch()
    assert [p.name for p in scan_files([tmp_path, "elsewhere.opd"])] == ["a.x3p", "b.OPD", "elsewhere.opd"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="no file with the suffix"):
        scan_files([tmp_path / "empty"])
