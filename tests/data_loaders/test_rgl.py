"""RGL files: bit-exact round trips, evaluation and sampling against Mitsuba 3's `measured`, and bad files."""

import struct
import subprocess
import sys
import tracemalloc
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from data_loaders import DataError, read_brdf, read_rgl, recognise, write_rgl
from data_loaders.tensor_file import read_tensors, write_tensors
from jaxbrdf import AdaptiveBRDF, albedo, spherical
from tests import references

RNG = np.random.default_rng(5)
REAL = ["chm_orange", "ilm_solo_m_68", "irid_flake_paint1", "paper_white", "satin_rosaline", "vch_silk_blue"]
TURN = np.pi


def made_up(phi_i=(0.0,), channels=3, jacobian=1, **about) -> AdaptiveBRDF:
    """Tables of numbers without a meaning, of small but different sizes."""
    P, T, K = len(phi_i), 4, 6

    def table(*shape, low=0.2):
        return RNG.uniform(low, 1, shape).astype(np.float32)

    ndf, sigma = table(5, 9), table(3, 7)
    if P <= 2:
        ndf, sigma = np.repeat(ndf[:1], 2, axis=0), np.repeat(sigma[:1], 2, axis=0)
    return AdaptiveBRDF(
        theta_i=np.linspace(0, np.pi / 2, T, dtype=np.float32) ** 1.0,
        phi_i=np.asarray(phi_i, np.float32),
        ndf=ndf,
        sigma=sigma,
        vndf=table(P, T, 8, 10, low=0),
        luminance=table(P, T, K, K),
        values=table(P, T, K, K, channels),
        jacobian=np.array([jacobian], np.uint8),
        **about,
    )


CASES = {
    "isotropic": made_up(),
    "without jacobian": made_up(jacobian=0),
    "all azimuths": made_up(np.linspace(-TURN, TURN, 9)),
    "half of the azimuths": made_up(np.linspace(-TURN, 0, 5)),
    "a quarter of the azimuths": made_up(np.linspace(-TURN, -TURN / 2, 4)),
    "spectral": made_up(channels=5, wavelengths=np.array([0.4, 0.45, 0.55, 0.62, 0.7])),
}
every_case = pytest.mark.parametrize("name", CASES)


@eqx.filter_jit
def ours(brdf, wi, wo):
    """f cos θ_o, and the density with which wo is drawn for a viewer at wi."""
    return brdf(wi, wo) * wo[..., 2:], brdf.pdf(wo, wi)


def pairs(n):
    """Both directions well above the horizon, half of them near the mirror direction."""
    wi = references.direction(np.arccos(RNG.uniform(0.05, 1, n)), RNG.uniform(-np.pi, np.pi, n))
    wo = references.direction(np.arccos(RNG.uniform(0.05, 1, n)), RNG.uniform(-np.pi, np.pi, n))
    wo[::2] = wi[::2] * [-1, -1, 1] + RNG.normal(0, 0.1, (len(wo[::2]), 3))
    wo /= np.linalg.norm(wo, axis=-1, keepdims=True)
    keep = wo[:, 2] > 0.02
    return wi[keep], wo[keep]


# Mitsuba runs in a process of its own: where scalar_rgb was in use before, its scalar_spectral errs.
THEIRS = """
import sys
import mitsuba
import numpy as np

path, given, found = sys.argv[1:]
given = np.load(given)
nanometres = (1000 * given["wavelengths"][:4]).tolist()
mitsuba.set_variant("scalar_spectral" if nanometres else "scalar_rgb")
bsdf, context = mitsuba.load_dict({"type": "measured", "filename": path}), mitsuba.BSDFContext()
surface = mitsuba.SurfaceInteraction3f()
if nanometres:
    surface.wavelengths = nanometres
f, pdf = [], []
for wi, wo in zip(given["wi"].tolist(), given["wo"].tolist()):
    surface.wi = wi
    f.append(np.array(bsdf.eval(context, surface, wo)))
    pdf.append(bsdf.pdf(context, surface, wo))
np.savez(found, f=f, pdf=pdf)
"""


def theirs(path, wi, wo, wavelengths, scratch):
    """The same numbers by Mitsuba, the first four of a spectrum."""
    pytest.importorskip("mitsuba")
    given, found = scratch / "given.npz", scratch / "found.npz"
    np.savez(given, wi=wi, wo=wo, wavelengths=() if wavelengths is None else wavelengths)
    subprocess.run([sys.executable, "-c", THEIRS, str(path), str(given), str(found)], check=True)
    with np.load(found) as result:
        return result["f"], result["pdf"]


def assert_like_mitsuba(brdf, path, n, scratch):
    wi, wo = pairs(n)
    f, pdf = (np.asarray(a) for a in ours(replace(brdf, name="", origin=()), wi, wo))
    f_there, pdf_there = theirs(path, wi, wo, brdf.wavelengths, scratch)
    f = f[:, : f_there.shape[1]]
    enough = f_there > 1e-3 * np.median(f_there)
    assert np.mean(enough) > 0.5
    assert_allclose(f[enough], f_there[enough], rtol=1e-3)
    assert_allclose(f, f_there, atol=1e-3 * np.max(np.abs(f_there)))
    assert_allclose(pdf, pdf_there, rtol=1e-3, atol=1e-3 * np.median(pdf_there))


@pytest.mark.parametrize("name", REAL)
def test_real_files_come_back_byte_for_byte_and_evaluate_like_mitsuba(name, shared_data, tmp_path):
    path = shared_data / "rgl" / f"{name}_rgb.bsdf"
    brdf = read_rgl(path)
    write_rgl(tmp_path / "again.bsdf", brdf)
    assert (tmp_path / "again.bsdf").read_bytes() == path.read_bytes()
    assert recognise(path).name == "RGL"
    assert_array_equal(read_brdf(path).values, brdf.values)
    assert_like_mitsuba(brdf, path, 500, tmp_path)


@every_case
def test_what_is_written_comes_back_and_mitsuba_reads_it(name, tmp_path):
    brdf = replace(CASES[name], name="made up", origin=("what it is", "and more, µ"))
    path = tmp_path / "made up.bsdf"
    write_rgl(path, brdf)
    back = read_rgl(path)
    assert eqx.tree_equal(back, brdf, rtol=1e-15, typematch=True), (back, brdf)
    assert_like_mitsuba(brdf, path, 300, tmp_path)


@every_case
def test_drawn_directions_have_the_density_that_pdf_states(name):
    """Both the share of samples in parts of the hemisphere and the albedo by importance sampling."""
    brdf = CASES[name]
    wo = np.asarray(spherical(0.6, 0.8))
    u = (np.stack(np.meshgrid(*2 * [np.arange(300)]), -1).reshape(-1, 2) + 0.5) / 300

    @eqx.filter_jit
    def drawn(brdf, u, wo):
        wi = brdf.sample(u, jnp.broadcast_to(wo, (len(u), 3)))
        return wi, brdf.pdf(wi, jnp.broadcast_to(wo, wi.shape)), brdf(wo[None], wi)

    wi, pdf, f = (np.asarray(a) for a in drawn(brdf, u, wo))
    above = wi[:, 2] > 1e-3
    estimate = np.mean(np.where(above[:, None], f * wi[:, 2:] / np.where(above, pdf, 1)[:, None], 0), axis=0)
    nodes, weights = about_normals(wo, 600)
    light = np.asarray(ours(brdf, np.broadcast_to(wo, nodes.shape), nodes)[0])
    density = np.asarray(ours(brdf, np.broadcast_to(wo, nodes.shape), nodes)[1])
    assert_allclose(estimate, weights @ light, rtol=5e-3)
    for part in (lambda w: w[:, 0] > 0.2, lambda w: w[:, 1] < 0.1, lambda w: w[:, 2] > 0.7):
        assert_allclose(np.mean(above & part(wi)), weights @ (density * part(nodes)), atol=5e-3)


def about_normals(w, n):
    """Where normals mirror w to, above the horizon, and the solid angles: n × n midpoints in √θ_m, φ_m."""
    x, phi = (np.stack(np.meshgrid(*2 * [np.arange(n)]), -1).reshape(-1, 2).T + 0.5) / n
    theta, phi = np.pi / 2 * x**2, 2 * np.pi * phi
    m = references.direction(theta, phi)
    mirrored = 2 * (m @ w)[:, None] * m - w
    solid_angle = 4 * np.abs(m @ w) * np.sin(theta) * np.pi * x * 2 * np.pi / n**2
    return np.where(mirrored[:, 2:] > 0, mirrored, [0.0, 0.0, 1.0]), solid_angle * (mirrored[:, 2] > 0)


def test_albedo_of_white_paper(shared_data):
    """White paper reflects most light and creates none; brighteners make it a little blue."""
    brdf = read_rgl(shared_data / "rgl" / "paper_white_rgb.bsdf")
    found = np.asarray(albedo(brdf, spherical(np.radians([10.0, 45.0]), 0.0)))
    assert np.all((found > 0.7) & (found < 1.0))
    assert np.all(found[:, 2] > found[:, 0])
    assert np.ptp(found) < 0.2


def test_gradients_are_finite():
    wi, wo = pairs(60)
    ends = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
    wi, wo = np.concatenate([wi, ends, ends]), np.concatenate([wo, ends, ends[::-1]])
    gradient = jax.grad(
        lambda w: jnp.sum(CASES["isotropic"](w / jnp.linalg.norm(w, axis=-1, keepdims=True), wo))
    )
    assert np.isfinite(gradient(jnp.asarray(wi))).all()


def test_tables_that_do_not_belong_together():
    with pytest.raises(ValueError, match="for 1 phi_i and 4 theta_i"):
        replace(CASES["isotropic"], luminance=CASES["isotropic"].luminance[:, :3])
    with pytest.raises(ValueError, match="wavelengths"):
        replace(CASES["isotropic"], wavelengths=np.array([0.5]))
    with pytest.raises(ValueError, match="5 channels without wavelengths"):
        write_rgl("never.bsdf", replace(CASES["spectral"], wavelengths=None))


# Bad files


@pytest.fixture(scope="module")
def tensors(tmp_path_factory):
    path = tmp_path_factory.mktemp("good") / "good.bsdf"
    write_rgl(path, CASES["spectral"])
    return read_tensors(path)


def outcome(path) -> AdaptiveBRDF | DataError:
    """What is read, or the error, which must be in words and on one line."""
    try:
        return read_rgl(path)
    except DataError as caught:
        error = caught
    assert str(error) == f"{path}: expected {error.expected}, found {error.found}"
    assert "\n" not in str(error)
    return error


def fault(path) -> DataError:
    error = outcome(path)
    assert isinstance(error, DataError)
    return error


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("ndf", lambda a: None, "'ndf'"),
        ("spectra", lambda a: None, "'rgb'"),
        ("wavelengths", lambda a: None, "'wavelengths'"),
        ("wavelengths", lambda a: a / 1000, "nanometres"),
        ("theta_i", lambda a: a * 57.3, "radians"),
        ("theta_i", lambda a: a[::-1], "increasing"),
        ("theta_i", lambda a: a[:-1], "belong together"),
        ("sigma", lambda a: a.astype(np.float64), "float32"),
        ("vndf", lambda a: a[0], "4 axes"),
        ("vndf", lambda a: a * np.nan, "finite"),
        ("spectra", lambda a: a * 0 - 1, "≥ 0"),
        ("luminance", lambda a: a[..., :1], "4 axes"),
        ("jacobian", lambda a: a.astype(np.float32), "jacobian"),
    ],
)
def test_wrong_tables(name, change, words, tensors, tmp_path):
    path = tmp_path / "bad.bsdf"
    changed = change(tensors[name])
    others = {key: value for key, value in tensors.items() if key != name}
    write_tensors(path, others if changed is None else {**others, name: changed})
    assert words in str(fault(path))


def test_other_files(tmp_path):
    path = tmp_path / "x.bsdf"
    for content, words in [
        (b"", "an empty file"),
        (b"Source Measured\n", "a text file"),
        (b"tensor_file\0\x02\0\0\0\0\0", "version 2.0"),
        (b"tensor_file\0\x01\0", "end of the file"),
        (b"tensor_file\0\x01\0\xff\xff\xff\xff", "4294967295"),
    ]:
        path.write_bytes(content)
        assert words in fault(path).found
        with pytest.raises(DataError):
            read_brdf(path)
    assert fault(tmp_path).found == "a folder"
    assert "No such file" in fault(tmp_path / "missing").found


@pytest.mark.parametrize("shape", [(10**6, 10**6), (2**63, 2**63), (0, 2**63)])
def test_a_header_that_announces_more_than_there_is(shape, tmp_path):
    path = tmp_path / "huge.bsdf"
    header = b"tensor_file\0\x01\0" + struct.pack("<I", 1) + struct.pack("<H", 3) + b"ndf"
    path.write_bytes(header + struct.pack("<HBQ2Q", 2, 10, 64, *shape))
    tracemalloc.start()
    fault(path)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_is_an_error_or_leaves_a_sound_record(data, tmp_path):
    """Bytes changed, most of them in the header, or the end cut off."""
    path = tmp_path / "damaged.bsdf"
    write_rgl(path, CASES["isotropic"])
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, 420) | st.integers(0, len(content) - 1))] = data.draw(
            st.integers(0, 255)
        )
    path.write_bytes(content[: data.draw(st.just(len(content)) | st.integers(0, len(content)))])
    found = outcome(path)
    if isinstance(found, AdaptiveBRDF):
        tables = [getattr(found, name) for name in ("theta_i", "ndf", "sigma", "vndf", "luminance", "values")]
        assert all(np.isfinite(table).all() for table in tables)
