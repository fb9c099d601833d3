"""All formats by one name: told apart by content, written from any record, and read again."""

from dataclasses import replace

import equinox as eqx
import h5py
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from data_loaders import (
    DataError,
    published,
    read_brdf,
    recognise,
    save_fit,
    to_rgb,
    write_alta,
    write_brdf,
    write_csv,
    write_hdf5,
    write_rgl,
)

GGX = jb.Lambertian(0.3) + 0.2 * jb.Microfacet(
    jb.TrowbridgeReitz(0.3), jb.Schlick(0.04), jb.HeightCorrelated()
)
WRITTEN = [".binary", ".bsdf", ".h5", ".alta", ".csv"]
HELD = {"samples": {".h5", ".alta", ".csv"}, "table": {".h5"}, "adaptive": {".h5"}, "model": {".h5"}}
CORNELL = "# Cornell\n# num wls\n1\n# wls\n550\n# theta i\n0.5 0.0 0.25 3.1 0.1\n"
MINIDIFF = "SAMPLE_NAME paint\nNUM_POINTS 1\nVARS theta_i,phi_i,theta_s,465nm,525nm\n0.5,3.14,0.2,0,1,2\n"


def small_table():
    h, d, p = (np.arange(n + 1) / n for n in (45, 18, 12))
    edges = np.pi / 2 * h**2, np.pi / 2 * d, np.pi * p
    grid = jb.HalfDifferenceGrid(*((e[1:] + e[:-1]) / 2 for e in edges), *edges)
    return jb.as_table(GGX, grid)


def some_samples(channels=1, **about):
    """At 1500 pairs, each channel a little brighter than the one before."""
    whole = jb.as_samples(GGX)
    some = np.random.default_rng(8).permutation(
        np.flatnonzero(np.maximum(whole.theta_i, whole.theta_o) < 1.4)
    )[:1500]
    angles = {name: getattr(whole, name)[some] for name in ("theta_i", "phi_i", "theta_o", "phi_o")}
    values = whole.values[some] * np.linspace(1, 1.5, channels)
    return jb.MeasuredSamples(**angles, values=values, weights=np.ones(len(some)), **about)


@pytest.fixture(scope="module")
def records():
    return {
        "samples": some_samples(name="paint", origin=("by hand",)),
        "table": small_table(),
        "adaptive": jb.as_adaptive(GGX),
        "model": GGX,
    }


def spectral(**about):
    return some_samples(5, wavelengths=np.array([0.4, 0.45, 0.55, 0.62, 0.7]), **about)


def same(a, b):
    """The same class and bits, whatever the names."""
    bare = [replace(r, name="", origin=()) if hasattr(r, "origin") else r for r in (a, b)]
    return bool(eqx.tree_equal(*bare, typematch=True))


# Recognised


def fit(model):
    nothing = np.zeros(())
    whole, matrix = nothing.astype(int), np.zeros((0, 0))
    return jb.FitResult(model, whole, nothing, whole, matrix, np.zeros(0), (), "", ())


@pytest.fixture(scope="module")
def files(tmp_path_factory, known_file):
    """A path for each format."""
    folder = tmp_path_factory.mktemp("formats")
    samples = some_samples()
    tensors = jb.AdaptiveBRDF(
        theta_i=np.float32([0, 1]),
        phi_i=np.zeros(1, np.float32),
        ndf=np.ones((2, 2), np.float32),
        sigma=np.ones((2, 2), np.float32),
        vndf=np.ones((1, 2, 2, 2), np.float32),
        luminance=np.ones((1, 2, 2, 2), np.float32),
        values=np.ones((1, 2, 2, 2, 3), np.float32),
    )
    write_rgl(folder / "RGL", tensors)
    write_hdf5(folder / "HDF5", samples)
    write_alta(folder / "ALTA", samples)
    write_csv(folder / "CSV", samples)
    (folder / "Mini-Diff").write_text(MINIDIFF)
    (folder / "Cornell").write_text(CORNELL)
    return {"MERL": known_file} | {path.name: path for path in folder.iterdir()}


KINDS = {
    "MERL": jb.MeasuredBRDF,
    "RGL": jb.AdaptiveBRDF,
    "HDF5": jb.MeasuredSamples,
    "ALTA": jb.MeasuredSamples,
    "CSV": jb.MeasuredSamples,
    "Mini-Diff": jb.MeasuredSamples,
    "Cornell": jb.MeasuredSamples,
}


@pytest.mark.parametrize("name", KINDS)
def test_content_tells_the_format_whatever_the_suffix(name, files, tmp_path):
    for suffix in ("", ".dat", ".binary", ".bsdf", ".h5", ".csv", ".alta", ".astm", ".brdf"):
        path = tmp_path / f"file{suffix}"
        path.symlink_to(files[name])
        assert recognise(path).name == name
        assert recognise(str(path)).name == name
    assert type(read_brdf(path)) is KINDS[name]


@pytest.mark.parametrize(
    ("suffix", "name"),
    [(".binary", "MERL"), (".BSDF", "RGL"), (".hdf5", "HDF5"), (".csv", "CSV"), (".astm", "Mini-Diff")],
)
def test_where_content_says_nothing_the_suffix_does(suffix, name, tmp_path):
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(b"")
    assert recognise(path).name == name
    with pytest.raises(DataError, match=f"{path}: expected "):
        read_brdf(path)


def test_an_unknown_file(tmp_path):
    path = tmp_path / "what.dat"
    path.write_bytes(b"\0\1\2")
    with pytest.raises(DataError, match=r"MERL \(\.binary\), RGL .*Cornell \(\.brdf\), found a binary file"):
        recognise(path)
    for missing in (tmp_path / "missing.csv", tmp_path):
        with pytest.raises(DataError):
            read_brdf(missing)


# HDF5


def test_hdf5_gives_back_what_was_stored(records, tmp_path):
    path = tmp_path / "x.h5"
    for record in (*records.values(), spectral(name="µ"), jb.Microfacet(jb.Beckmann(0.2), jb.Schlick(0.1))):
        assert write_brdf(path, record) is record
        back = read_brdf(path)
        assert bool(eqx.tree_equal(back, record, typematch=True))
        save_fit(path, fit(record))
        assert recognise(path).name == "HDF5"
        if isinstance(record, jb.AbstractBRDF):
            assert bool(eqx.tree_equal(read_brdf(path), record, typematch=True))


def test_hdf5_of_something_else(tmp_path):
    path = tmp_path / "x.h5"
    save_fit(path, fit(jb.TabulatedNDF(np.ones((9, 9)))))
    with pytest.raises(DataError, match="expected a fitted reflectance, found a fitted TabulatedNDF"):
        read_brdf(path)
    save_fit(path, fit(some_samples()))
    with pytest.raises(DataError, match="found a fitted MeasuredSamples"):
        read_brdf(path)
    write_hdf5(path, jb.Phong(2.0))
    with h5py.File(path, "r+") as file:
        file["reflectance"].attrs["class"] = np.bytes_("BlinnPhong")
    with pytest.raises(DataError, match="a reflectance, found a BlinnPhong"):
        read_brdf(path)
    with h5py.File(path, "w") as file:
        file["numbers"] = np.arange(3)
    with pytest.raises(DataError, match="an HDF5 file of another kind"):
        read_brdf(path)


def test_hdf5_of_arrays_that_do_not_belong_together(tmp_path):
    path = tmp_path / "x.h5"
    record = some_samples()
    object.__setattr__(record, "theta_i", record.theta_i[:-1])
    write_hdf5(path, record)
    with pytest.raises(DataError, match="arrays that belong together"):
        read_brdf(path)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A record, the bytes of its file, and a place for damaged copies."""
    path = tmp_path_factory.mktemp("damage") / "x.h5"
    record = some_samples(2)
    record = replace(
        record,
        **{n: getattr(record, n)[:20] for n in ("theta_i", "phi_i", "theta_o", "phi_o", "values", "weights")},
    )
    write_hdf5(path, record)
    return record, path.read_bytes(), path


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_damage_is_an_error_or_harmless(stored, data):
    """Bytes changed, or the end cut off."""
    record, content, path = stored
    place = st.integers(0, len(content) - 1)
    damaged = bytearray(content)
    for where, bits in data.draw(st.dictionaries(place, st.integers(1, 255), max_size=4)).items():
        damaged[where] ^= bits
    path.write_bytes(damaged[: data.draw(st.just(len(content)) | place)])
    try:
        found = read_brdf(path)
    except DataError:
        return
    assert bool(eqx.tree_equal(found, record, typematch=True))


# Written and read again

# The most that may be lost of each record: relative L2 and median
LOST = {
    ("samples", ".binary"): (0.01, 1e-3),
    ("samples", ".bsdf"): (0.13, 0.01),
    ("table", ".binary"): (1e-3, 1e-4),
    ("table", ".bsdf"): (0.1, 0.01),
    ("adaptive", ".binary"): (0.02, 0.005),
    ("model", ".binary"): (3e-4, 3e-5),
    ("model", ".bsdf"): (0.03, 0.005),
}


@pytest.mark.parametrize("suffix", WRITTEN)
@pytest.mark.parametrize("kind", HELD)
def test_any_record_in_any_format(kind, suffix, records, tmp_path):
    path, source = tmp_path / f"x{suffix}", records[kind]
    written = write_brdf(path, source)
    back = read_brdf(path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert (written is source) == (suffix in HELD[kind])
    if suffix == ".binary":
        assert_allclose(back.values, written.values, rtol=1e-14)
    else:
        assert same(back, written)
    if suffix in {".binary", ".bsdf"}:
        assert back.values.shape[-1] == 3
        assert_array_equal(back.values[..., 1:].astype(np.float32), back.values[..., :2].astype(np.float32))
    error = jb.resampling_error(source, back)
    l2, median = LOST.get((kind, suffix), (1e-6, 1e-6))  # single precision
    assert error.pairs > 500
    assert (error.relative_l2 <= l2).all()
    assert (error.median <= median).all()


def test_names_and_origin_are_kept(tmp_path):
    source = some_samples(3, name="blue paint", origin=("by hand", "in the dark"))
    for suffix in WRITTEN[1:]:
        write_brdf(tmp_path / f"x{suffix}", source)
        back = read_brdf(tmp_path / f"x{suffix}")
        assert back.origin == source.origin
        assert back.name == ("x" if suffix == ".bsdf" else source.name)


def test_spectra(tmp_path):
    source = spectral()
    with pytest.raises(ValueError, match="R, G and B"):
        write_brdf(tmp_path / "x.binary", source)
    with pytest.raises(ValueError, match="R, G and B"):
        write_brdf(tmp_path / "x.binary", some_samples(3, wavelengths=np.array([0.465, 0.525, 0.63])))
    for suffix in WRITTEN[1:]:
        write_brdf(tmp_path / f"x{suffix}", source)
        assert_allclose(read_brdf(tmp_path / f"x{suffix}").wavelengths, source.wavelengths, rtol=1e-6)
    for suffix in WRITTEN:
        path = tmp_path / f"x{suffix}"
        written = write_brdf(path, to_rgb(source))
        assert written.wavelengths is None
        back = read_brdf(path)
        assert back.wavelengths is None
        error = jb.resampling_error(to_rgb(source), back)
        assert error.median.shape == (3,)
        assert error.median.max() < 0.01


def test_colour_of_grey_and_of_models(tmp_path):
    for source, suffix in ((some_samples(), ".csv"), (jb.as_samples(GGX), ".alta")):
        written = write_brdf(tmp_path / f"x{suffix}", to_rgb(source))
        assert_array_equal(written.values, source.values * np.ones(3))
    brown = jb.Lambertian(jnp.array([0.5, 0.4, 0.3]))
    assert write_brdf(tmp_path / "x.h5", to_rgb(brown)) is brown
    write_brdf(tmp_path / "x.binary", brown)
    back = read_brdf(tmp_path / "x.binary")
    assert_allclose(back.values[0, 0, 0], np.array([0.5, 0.4, 0.3]) / np.pi, rtol=1e-12)
    with pytest.raises(ValueError, match="R, G and B"):
        write_brdf(tmp_path / "x.binary", jb.Lambertian(jnp.array([0.5, 0.4])))


def test_a_published_material(tmp_path):
    gold = published("ngan-ward", "gold-metallic-paint")
    for suffix in (".bsdf", ".binary"):
        write_brdf(tmp_path / f"gold{suffix}", gold)
        back = read_brdf(tmp_path / f"gold{suffix}")
        error = jb.resampling_error(gold, back)
        assert back.name == "gold"
        assert (error.relative_l2 < 0.01).all()
        assert (error.median < 0.01).all()


# Refused


@pytest.mark.parametrize("suffix", ["", ".dat", ".astm", ".brdf", ".h5x"])
def test_what_is_not_written(suffix, tmp_path):
    listed = r"MERL \(\.binary\), RGL \(\.bsdf\), HDF5 \(\.h5, \.hdf5\), ALTA \(\.alta\), CSV \(\.csv\)"
    with pytest.raises(DataError, match=f"{listed}, found {suffix or 'none'}"):
        write_brdf(tmp_path / f"x{suffix}", some_samples())
    assert not list(tmp_path.iterdir())


class Private(jb.AbstractBRDF):
    """A model that is not on jaxbrdf's face."""

    def _reflectance(self, wi, wo):
        return 1.0 * wi[..., 2] * wo[..., 2]


REFUSED = {
    "MERL of spectra": (".binary", spectral, ValueError),
    "MERL of azimuths": (".binary", lambda: jb.Ward(0.1, 0.3), ValueError),
    "RGL of unnamed channels": (".bsdf", lambda: jb.Lambertian(jnp.ones(5) / 9), ValueError),
    "a private model": (".h5", Private, ValueError),
    "weights": (".alta", lambda: replace(some_samples(), weights=np.arange(1500.0)), ValueError),
    "NaN": (".csv", lambda: replace(some_samples(), values=np.full((1500, 1), np.nan)), ValueError),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_a_format_cannot_hold_leaves_the_old_file(kind, tmp_path):
    suffix, make, error = REFUSED[kind]
    path = tmp_path / f"x{suffix}"
    path.write_bytes(b"old")
    with pytest.raises(error):
        write_brdf(path, make())
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    path.unlink()
    with pytest.raises(error):
        write_brdf(path, make())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".bsdf", ".h5", ".alta", ".csv"])
def test_a_place_that_is_not_there(suffix, tmp_path):
    with pytest.raises(DataError):
        write_brdf(tmp_path / "nowhere" / f"x{suffix}", some_samples(3))


# Real files

REAL = [
    *(("cornell", f"{name}.brdf") for name in ("garnet_red", "krylon_blue")),
    *(("minidiff", f"{name}.astm") for name in ("C1_White", "C8_Silver", "C10_Copper", "Metal_Blue")),
    *(("retro", name) for name in ("pink-felt-1d.alta", "retro-gray-tape.dat")),
    *(
        ("rgl", f"{name}_rgb.bsdf")
        for name in ("chm_orange", "ilm_solo_m_68", "irid_flake_paint1", "paper_white", "satin_rosaline")
    ),
]


@pytest.mark.parametrize(("folder", "name"), REAL)
def test_real_files_in_formats_that_hold_them(folder, name, shared_data, tmp_path):
    source = read_brdf(shared_data / folder / name)
    exact = [".h5", ".hdf5"] + [".csv", ".alta"] * isinstance(source, jb.MeasuredSamples)
    for suffix in exact + [".bsdf"] * (folder == "rgl"):
        path = tmp_path / f"{source.name}{suffix}"
        assert write_brdf(path, source) is source
        back = read_brdf(path)
        assert bool(eqx.tree_equal(back, source, typematch=True)), (suffix, back, source)


RESAMPLED = {
    ("cornell/garnet_red.brdf", ".binary"): (0.01, 0.07),
    ("cornell/garnet_red.brdf", ".bsdf"): (0.15, 0.18),
    ("minidiff/C8_Silver.astm", ".binary"): (0.04, 0.03),
    ("minidiff/C8_Silver.astm", ".bsdf"): (0.045, 0.04),
    ("retro/pink-felt-1d.alta", ".binary"): (0.01, 0.01),
    ("retro/pink-felt-1d.alta", ".bsdf"): (0.02, 0.01),
    ("rgl/paper_white_rgb.bsdf", ".binary"): (0.04, 0.015),
    ("rgl/chm_orange_rgb.bsdf", ".binary"): (0.4, 0.25),
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "suffix"), RESAMPLED)
def test_real_files_resampled(name, suffix, shared_data, tmp_path):
    source = read_brdf(shared_data / name)
    path = tmp_path / f"x{suffix}"
    write_brdf(path, to_rgb(source))
    error = jb.resampling_error(to_rgb(source), read_brdf(path))
    l2, median = RESAMPLED[name, suffix]
    assert error.pairs > 50
    assert error.relative_l2.max() < l2
    assert error.median.max() < median


def test_mitsuba_reads_what_is_written(records, tmp_path):
    """And evaluates it like the model that it was made of."""
    from tests.data_loaders.test_rgl import pairs, theirs

    path = tmp_path / "x.bsdf"
    write_brdf(path, records["model"])
    wi, wo = pairs(400)
    f, _ = theirs(path, wi, wo, None, tmp_path)
    steep = np.minimum(wi[:, 2], wo[:, 2]) > np.cos(np.radians(75))
    expected = np.asarray(GGX(wi, wo) * wo[:, 2])[:, None] * np.ones(3)
    off = np.linalg.norm((f - expected)[steep]) / np.linalg.norm(expected[steep])
    assert off < 0.05
