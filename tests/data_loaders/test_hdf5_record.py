"""Records of any public class: static fields of all kinds that there are."""

import h5py
import numpy as np
import pytest

from data_loaders import DataError
from data_loaders.hdf5_record import Kind, read_record, write_record
from jaxbrdf import Heightfield, MeasuredSignature, PatchNDFs, patch_ndfs

KIND = Kind("a test", "record")


def resaved(path, record):
    write_record(path, KIND, record)
    return read_record(path, KIND)


def test_static_tuples_of_numbers_come_back_as_they_were(tmp_path):
    z = np.random.default_rng(0).random((20, 30))
    patches = patch_ndfs(Heightfield(z, 0.1, 0.3), (1.0, 2.0), cells=7)
    found = resaved(tmp_path / "patches.h5", patches)
    assert isinstance(found, PatchNDFs)
    for name in ("shape", "size", "stride", "pixel"):
        assert repr(getattr(found, name)) == repr(getattr(patches, name))  # whole numbers stay whole
    assert found.tables.extent == patches.tables.extent
    np.testing.assert_array_equal(found.values, patches.values)
    np.testing.assert_array_equal(found.counts, patches.counts)
    signature = MeasuredSignature(np.linspace(0, 0.1, 7), np.linspace(1, 0, 7))
    assert resaved(tmp_path / "signature.h5", signature) == signature


def test_a_field_without_a_default_must_be_there(tmp_path):
    patches = patch_ndfs(Heightfield(np.eye(8), 1.0, 1.0), 4.0, cells=3)
    write_record(tmp_path / "patches.h5", KIND, patches)
    with h5py.File(tmp_path / "patches.h5", "r+") as file:
        del file["record"].attrs["stride"]
    with pytest.raises(DataError, match="the attribute 'stride' of /record"):
        read_record(tmp_path / "patches.h5", KIND)
