"""Tabulated distributions on the disk."""

import h5py
import numpy as np
import pytest

from data_loaders import DataError, read_about, read_ndf, write_heightfield, write_ndf
from jaxbrdf import Beckmann, Heightfield, TabulatedNDF


@pytest.mark.parametrize("shape", [(5, 5), (3, 5, 5)])
def test_a_table_comes_back_bit_for_bit(tmp_path, shape):
    values = np.random.default_rng(0).random(shape)
    write_ndf(tmp_path / "n.h5", TabulatedNDF(values), ["a.opd"], {"method": "filtered", "sigma": 1.5})
    np.testing.assert_array_equal(read_ndf(tmp_path / "n.h5").values, values)
    about = read_about(tmp_path / "n.h5")
    assert (about["method"], about["sigma"], about["unit"], about["source"]) == (
        "filtered",
        1.5,
        "1/sr",
        ("a.opd",),
    )


def test_a_window_comes_back_bit_for_bit(tmp_path):
    ndf = TabulatedNDF(np.ones((5, 5), np.float32), (0.1, 1 / 3))
    write_ndf(tmp_path / "n.h5", ndf)
    found = read_ndf(tmp_path / "n.h5")
    assert found.extent == (0.1, 1 / 3)
    assert found.values.dtype == np.float32
    assert "extent" in str(read_about(tmp_path / "n.h5")["layout"])


def test_a_table_written_before_there_were_windows_is_of_the_whole_disk(tmp_path):
    write_ndf(tmp_path / "n.h5", TabulatedNDF(np.ones((5, 5)), (0.5, 0.5)))
    with h5py.File(tmp_path / "n.h5", "r+") as file:
        del file["ndf"].attrs["extent"]
    assert read_ndf(tmp_path / "n.h5").extent == (1.0, 1.0)


@pytest.mark.parametrize("extent", [(0.5, 1.5), (0.5, 0.5, 0.5), "wide", 0.5])
def test_a_window_that_is_none_is_damage(tmp_path, extent):
    write_ndf(tmp_path / "n.h5", TabulatedNDF(np.ones((5, 5))))
    with h5py.File(tmp_path / "n.h5", "r+") as file:
        file["ndf"].attrs["extent"] = np.bytes_(extent) if isinstance(extent, str) else extent
    with pytest.raises(DataError, match="arrays that belong together"):
        read_ndf(tmp_path / "n.h5")


def test_anything_else_is_refused(tmp_path):
    with pytest.raises(ValueError, match="found a Beckmann"):
        write_ndf(tmp_path / "n.h5", Beckmann(0.1))
    write_heightfield(tmp_path / "map.h5", Heightfield(np.eye(3), 1, 1))
    with pytest.raises(DataError, match="jaxbrdf height map"):
        read_ndf(tmp_path / "map.h5")
    write_ndf(tmp_path / "n.h5", TabulatedNDF(np.ones((9, 9))))
    whole = (tmp_path / "n.h5").read_bytes()
    for share in (0, 0.3, 0.9):
        (tmp_path / "n.h5").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(DataError, match=r"n\.h5"):
            read_ndf(tmp_path / "n.h5")
