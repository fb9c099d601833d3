"""Maps of distributions in HDF5: bit for bit, and damage is noticed."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbrdf as jb
from data_loaders import DataError, read_about, read_ndf_maps, write_ndf, write_ndf_maps

RNG = np.random.default_rng(0)


def made(rows, columns, name):
    images = [jnp.asarray(RNG.uniform(0.1, 0.4, (rows, columns))) for _ in range(5)]
    status, cost = RNG.integers(0, 3, (rows, columns)), RNG.random((rows, columns))
    counts = RNG.integers(0, 900, (rows, columns))
    return jb.NDFMap(jb.Ellipsoid(*images), (5.0, 8.0), name, (10.0, 10.0), status, cost, counts)


@pytest.fixture(scope="module")
def maps():
    """Of two scans, and a synthesised one, of which nothing else is known."""
    texture = jb.NDFMap(jb.TrowbridgeReitz(jnp.full((2, 2), 0.1), jnp.full((2, 2), 0.3)), (1.0, 1.0))
    return [made(3, 4, "a"), made(1, 6, "b"), texture]


def test_maps_come_back_bit_for_bit(maps, tmp_path):
    path = tmp_path / "maps.h5"
    write_ndf_maps(path, maps, ["a.x3p", "b.x3p"], {"patch": 10.0, "loss": "likelihood"})
    again = read_ndf_maps(path)
    assert [item.name for item in again] == ["a", "b", ""]
    for one, other in zip(maps, again, strict=True):
        assert type(other.ndf) is type(one.ndf)
        assert (other.step, other.size, other.names) == (one.step, one.size, one.names)
        for part in ("status", "cost", "counts"):
            np.testing.assert_array_equal(getattr(one, part), getattr(other, part))
        for name in one.names:
            np.testing.assert_array_equal(getattr(one.ndf, name), getattr(other.ndf, name))
        np.testing.assert_array_equal(one.success, other.success)
    about = read_about(path)
    assert (about["source"], about["patch"], about["loss"]) == (("a.x3p", "b.x3p"), 10.0, "likelihood")


def test_a_shortened_file_is_noticed(maps, tmp_path):
    path = tmp_path / "maps.h5"
    write_ndf_maps(path, maps)
    whole = path.read_bytes()
    for share in (0.1, 0.5, 0.9, 0.999):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(DataError, match=r"maps\.h5"):
            read_ndf_maps(path)


def test_other_files_are_refused(tmp_path):
    write_ndf(tmp_path / "table.h5", jb.TabulatedNDF(np.ones((5, 5))))
    with pytest.raises(DataError, match="maps of distributions"):
        read_ndf_maps(tmp_path / "table.h5")
    with pytest.raises(ValueError, match="Ellipsoid"):
        write_ndf_maps(tmp_path / "x.h5", [jb.Ellipsoid(*[jnp.ones((1, 1))] * 5)])
    assert not (tmp_path / "x.h5").exists()
