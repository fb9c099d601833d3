"""Tabulated distributions on the disk."""

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
