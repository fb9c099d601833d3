"""Fits on the disk: bit-exact round trips, provenance, and damage that is noticed and never a traceback."""

import os
from datetime import UTC, datetime, timedelta
from importlib.metadata import version

import equinox as eqx
import h5py
import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_loaders import DataError, load_fit, save_fit
from jaxbrdf import (
    AbstractBRDF,
    FitResult,
    FitStatus,
    Lambertian,
    ShiftedGamma,
    ShiftedGammaBRDF,
    ShiftedGammaShadowing,
    Sum,
    TabulatedNDF,
    smith_G1,
    spherical,
)

PARAMETERS = ("rho_d", "rho_s", "alpha", "p", "f0", "f1")


def fit(model, shape, names=("gold",), dtype=np.float64):
    rng = np.random.default_rng(len(shape))
    residuals = rng.normal(size=(*shape, 180)).astype(dtype)
    residuals[..., 3] = np.nan
    return FitResult(
        model=model,
        status=np.full(shape, FitStatus.CONVERGED),
        cost=rng.random(shape).astype(dtype) if shape else np.asarray(0.25, dtype),
        steps=np.full(shape, 17, np.int32),
        covariance=rng.normal(size=(*shape, 6, 6)).astype(dtype),
        residuals=residuals,
        parameters=PARAMETERS,
        recipe="slices+linear",
        names=names,
    )


def shifted_gamma(shape, dtype=np.float64, **others):
    numbers = np.random.default_rng(3).random((6, *shape)).astype(dtype)
    return ShiftedGammaBRDF(*(np.nextafter(n, 2, dtype=dtype) for n in numbers), **others)


def resaved(path, result, **options):
    save_fit(path, result, **options)
    return load_fit(path)


def assert_same(loaded, result):
    """The same classes, texts, shapes, types and bits."""
    assert jax.tree.structure(loaded) == jax.tree.structure(result)
    for ours, theirs in zip(jax.tree.leaves(loaded), jax.tree.leaves(result), strict=True):
        assert ours.dtype == theirs.dtype
        assert ours.shape == theirs.shape
        assert np.asarray(ours).tobytes() == np.asarray(theirs).tobytes()


RESULTS = {
    "grey": lambda: fit(shifted_gamma(()), (), names=()),
    "RGB": lambda: fit(shifted_gamma((3,)), (3,)),
    "batch": lambda: fit(shifted_gamma((2, 3)), (2, 3), names=("gold", "weiße Farbe ")),
    "float32": lambda: fit(shifted_gamma((3,), np.float32), (3,), dtype=np.float32),
    "nested": lambda: fit(
        Lambertian(np.ones(3)) + shifted_gamma((3,), shadowing=ShiftedGammaShadowing(1.0, 2.0, 3.0)), (3,)
    ),
    "table": lambda: fit(TabulatedNDF(np.random.default_rng(1).random((9, 9))), ()),
    "empty tuple": lambda: fit(Sum(()), (3,)),
    "odd name": lambda: fit(shifted_gamma((1,)), (1,), names=("caf\udce9",)),  # bytes that are no UTF-8
}


@pytest.mark.parametrize("kind", RESULTS)
def test_round_trip_is_bit_exact(kind, tmp_path):
    result = RESULTS[kind]()
    assert_same(resaved(tmp_path / "fit.h5", result), result)


def test_a_loaded_model_is_a_model(tmp_path):
    result = fit(TabulatedNDF(np.ones((9, 9))), ())
    loaded = resaved(tmp_path / "fit.h5", result)
    w = spherical(np.array([0.1, 0.4]), np.zeros(2))
    np.testing.assert_array_equal(
        eqx.filter_jit(smith_G1)(loaded.model, w), eqx.filter_jit(smith_G1)(result.model, w)
    )


def test_double_precision_is_kept_where_jax_works_in_single(tmp_path):
    result = RESULTS["RGB"]()
    save_fit(tmp_path / "fit.h5", result)
    with jax.enable_x64(False):
        loaded = load_fit(tmp_path / "fit.h5")
    assert_same(loaded, result)


def test_a_hundred_thousand_fits(tmp_path):
    B = 100_000
    model, whole, real = ShiftedGamma(np.ones(B), np.zeros(B)), np.zeros(B, int), np.zeros(B)
    names = tuple(f"patch {k}" for k in range(B))
    result = FitResult(model, whole, real, whole, np.zeros((B, 0, 0)), np.zeros((B, 0)), (), "", names)
    assert_same(resaved(tmp_path / "fit.h5", result), result)


def test_provenance(tmp_path):
    for source, names in [
        ("a.binary", [b"a.binary"]),
        ([tmp_path, "b"], [bytes(tmp_path), b"b"]),
        (None, []),
    ]:
        save_fit(tmp_path / "fit.h5", RESULTS["RGB"](), source=source)
        with h5py.File(tmp_path / "fit.h5") as file:
            assert file.attrs["source"].tolist() == names
            assert file.attrs["format_version"] == 1
            for package in ("jaxbrdf", "jax", "numpy", "optimistix"):
                assert file.attrs[package].decode() == version(package)
            age = datetime.now(UTC) - datetime.fromisoformat(file.attrs["created"].decode())
            assert timedelta(0) <= age < timedelta(minutes=5)


class Private(AbstractBRDF):
    """A model that is not on jaxbrdf's face."""

    def _reflectance(self, wi, wo):
        return 1.0


def test_what_cannot_be_stored_is_refused(tmp_path):
    refused = [(Private(), "Private is not"), (Lambertian(0.5) + Private(), "Private is not")]
    for model, words in refused:
        with pytest.raises(ValueError, match=words):
            save_fit(tmp_path / "fit.h5", fit(model, ()))
    assert os.listdir(tmp_path) == []


# Writing is all or nothing


@pytest.mark.parametrize("error", [OSError("no space left"), KeyboardInterrupt()])
def test_an_interrupted_write_leaves_the_old_fit(error, tmp_path, monkeypatch):
    path, old = tmp_path / "fit.h5", RESULTS["RGB"]()
    save_fit(path, old)

    def fail(array):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr("data_loaders.hdf5_record._crc", fail)
        with pytest.raises(DataError if isinstance(error, OSError) else KeyboardInterrupt):
            save_fit(path, RESULTS["batch"]())
    assert_same(load_fit(path), old)
    assert os.listdir(tmp_path) == ["fit.h5"]


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(DataError, match="a place that can be written"):
        save_fit(tmp_path / "missing" / "fit.h5", RESULTS["RGB"]())


# Bad files


def fault(path) -> str:
    with pytest.raises(DataError) as caught:
        load_fit(path)
    assert str(caught.value).startswith(f"{path}: expected ")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture
def saved(tmp_path):
    save_fit(tmp_path / "fit.h5", RESULTS["nested"]())
    return tmp_path / "fit.h5"


def test_not_a_record(tmp_path):
    path = tmp_path / "fit.h5"
    assert "No such file" in fault(path)
    assert "a folder" in fault(tmp_path)
    for content, words in [(b"", "an empty file"), (b"{}", "a text file"), (bytes(99), "a binary file")]:
        path.write_bytes(content)
        assert words in fault(path)
    with h5py.File(path, "w") as file:
        file["numbers"] = np.arange(3)
    assert "another kind" in fault(path)


def replaced(path, **dataset):
    """A change of a file: one dataset or group in another's place; a removal where nothing is given."""

    def change(file):
        del file[path]
        if dataset:
            file.create_dataset(path, **dataset)

    return change


def without(path, attribute):
    return lambda file: file[path].attrs.pop(attribute)


def model_for_fit(file):
    file.move("result/model", "model")
    replaced("result")(file)
    file.move("model", "result")


def circle(file):
    replaced("result/model")(file)
    file["result/model"] = file["result"]


def patched(path, change) -> str:
    with h5py.File(path, "r+") as file:
        change(file)
    return fault(path)


PATCHES = {
    "version": (lambda file: file.attrs.modify("format_version", 2), "version 2"),
    "no version": (without("/", "format_version"), "damage"),
    "no class": (without("result/model", "class"), "'class'"),
    "no text": (without("result", "parameters"), "'parameters'"),
    "no checksum": (without("result/cost", "crc32"), "damage"),
    "no result": (replaced("result"), "'result'"),
    "no field": (replaced("result/model/terms/1/alpha"), "'alpha'"),
    "no item": (replaced("result/model/terms/1"), "'1'"),
    "text for numbers": (replaced("result/cost", data="one"), "/result/cost"),
    "declared only": (
        replaced("result/cost", shape=(10**6, 10**6), dtype=float, chunks=True),
        "/result/cost",
    ),
    "other numbers": (lambda file: file["result/cost"].write_direct(np.ones(3)), "other numbers"),
    "no fit": (model_for_fit, "found a Sum"),
    "circle": (circle, "recursion"),
}


@pytest.mark.parametrize("kind", PATCHES)
def test_a_changed_record(kind, saved):
    change, words = PATCHES[kind]
    assert words in patched(saved, change)


@pytest.mark.parametrize(
    "name",
    [
        "Nothing",
        "AbstractBRDF",
        "FitStatus",
        "half_vector",
        "__path__",
        "eqx",
        "os.system",
        "jaxbrdf.Sum",
        "",
    ],
)
def test_only_public_models_are_made(name, saved):
    def rename(file):
        file["result/model"].attrs["class"] = np.bytes_(name)

    assert f"the unknown class {name!r}" in patched(saved, rename)


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """A result, its record's bytes, and a place for damaged copies."""
    path = tmp_path_factory.mktemp("damage") / "fit.h5"
    result = RESULTS["batch"]()
    save_fit(path, result, source="gold.binary")
    return result, path.read_bytes(), path.with_name("copy.h5")


def test_cut_short(record):
    _, content, path = record
    for length in [*range(0, len(content), 997), len(content) - 1]:
        path.write_bytes(content[:length])
        fault(path)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_flipped_bytes_are_noticed_or_harmless(record, data):
    result, content, path = record
    place = st.integers(0, len(content) - 1)
    changes = data.draw(st.dictionaries(place, st.integers(1, 255), min_size=1, max_size=4))
    damaged = bytearray(content)
    for where, bits in changes.items():
        damaged[where] ^= bits
    path.write_bytes(damaged)
    try:
        loaded = load_fit(path)
    except DataError:
        return
    assert_same(loaded, result)
