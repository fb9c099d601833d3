"""ALTA's files: each parameterisation against vectors written down here, real ones, round trips, bad ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from data_loaders import DataError, read_alta, write_alta
from jaxbrdf import MeasuredSamples

NORMAL = np.array([0.0, 0.0, 1.0])
FINITE = st.floats(allow_nan=False, allow_infinity=False)


def write(path, param_in, inputs, values=None, head=(), param_out="INV_STERADIAN"):
    """A file written by numpy alone."""
    inputs = np.atleast_2d(inputs)
    values = np.ones((len(inputs), 1)) if values is None else np.atleast_2d(values)
    lines = [f"#DIM {inputs.shape[1]} {values.shape[1]}", f"#PARAM_IN  {param_in}", f"#PARAM_OUT {param_out}"]
    with open(path, "w") as file:
        file.write("\n".join([*lines, *head]) + "\n")
        np.savetxt(file, np.hstack([inputs, values]), fmt="%.17g", delimiter="\t")
    return path


def fault(path) -> DataError:
    with pytest.raises(DataError) as caught:
        read_alta(path)
    assert "\n" not in str(caught.value)
    return caught.value


# Parameterisations: from a pair of vectors to the numbers, by what ALTA says that the numbers are


def dot(a, b):
    return (a * b).sum(axis=-1)


def half(light, view):
    h = light + view
    return h / np.linalg.norm(h, axis=-1, keepdims=True)


def theta(v):
    return np.arccos(np.clip(v[:, 2], -1, 1))


def phi(v):
    return np.arctan2(v[:, 1], v[:, 0])


def in_polar_plane(radius, azimuth):
    return radius * np.cos(azimuth), radius * np.sin(azimuth)


def rusin(light, view):
    """θ_h, φ_h, θ_d, φ_d of Rusinkiewicz, φ_d by the axes that the half vector's angles turn x and y to."""
    h = half(light, view)
    t, p = theta(h), phi(h)
    x = np.stack([np.cos(t) * np.cos(p), np.cos(t) * np.sin(p), -np.sin(t)], axis=-1)
    y = np.stack([-np.sin(p), np.cos(p), 0 * p], axis=-1)
    return t, p, np.arccos(np.clip(dot(h, view), -1, 1)), np.arctan2(dot(view, y), dot(view, x))


def stark(light, view, project):
    H, B = (light + view) / 2 * project, (light - view) / 2 * project
    h = np.hypot(H[:, 0], H[:, 1])
    return h, np.linalg.norm(B, axis=-1), phi((light - view) / 2) - phi((light + view) / 2)


def schlick(light, view):
    k = half(light * [-1, -1, 1], view)
    return theta(light), *in_polar_plane(theta(k), phi(k) - phi(light))


def retro(light, view):
    """The angle between light and view, and at the light the angle from the normal to the view."""
    apart = np.arccos(np.clip(dot(light, view), -1, 1))
    towards = NORMAL - light[:, 2:] * light
    towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    aside = np.cross(NORMAL, light)
    aside = aside / np.linalg.norm(aside, axis=-1, keepdims=True)
    return theta(light), *in_polar_plane(apart, np.arctan2(dot(view, aside), dot(view, towards)))


FORWARD = {
    "COS_TH": lambda l, v: (half(l, v)[:, 2],),
    "COS_TH_TD": lambda l, v: (half(l, v)[:, 2], dot(half(l, v), v)),
    "RUSIN_TH_TD": lambda l, v: (rusin(l, v)[0], rusin(l, v)[2]),
    "RUSIN_TH_PH_TD": lambda l, v: rusin(l, v)[:3],
    "RUSIN_TH_TD_PD": lambda l, v: [rusin(l, v)[k] for k in (0, 2, 3)],
    "RUSIN_TH_PH_TD_PD": rusin,
    "RUSIN_VH": lambda l, v: half(l, v).T,
    "ISOTROPIC_TV_TL_DPHI": lambda l, v: (theta(v), theta(l), phi(l) - phi(v)),
    "ISOTROPIC_TV_PROJ_DPHI": lambda l, v: in_polar_plane(theta(v), phi(v)),  # of a light at the normal
    "ISOTROPIC_TL_TV_PROJ_DPHI": lambda l, v: (theta(l), *in_polar_plane(theta(v), phi(v) - phi(l))),
    "SCHLICK_TL_TK_PROJ_DPHI": schlick,
    "RETRO_TL_TVL_PROJ_DPHI": retro,
    "STARK_2D": lambda l, v: stark(l, v, [1, 1, 1])[:2],
    "STARK_3D": lambda l, v: stark(l, v, [1, 1, 1]),
    "NEUMANN_2D": lambda l, v: stark(l, v, [1, 1, 0])[:2],
    "NEUMANN_3D": lambda l, v: stark(l, v, [1, 1, 0]),
    "SPHERICAL_TL_PL_TV_PV": lambda l, v: (theta(l), phi(l), theta(v), phi(v)),
    "CARTESIAN": lambda l, v: (*v.T, *l.T),
}
ABSOLUTE = ["RUSIN_TH_PH_TD_PD", "SPHERICAL_TL_PL_TV_PV", "CARTESIAN"]  # fix both directions
ISOTROPIC = [
    "RUSIN_TH_TD_PD",
    "ISOTROPIC_TV_TL_DPHI",
    "ISOTROPIC_TL_TV_PROJ_DPHI",
    "SCHLICK_TL_TK_PROJ_DPHI",
    "RETRO_TL_TVL_PROJ_DPHI",
    "STARK_3D",
    "NEUMANN_3D",
]  # fix them but for a turn about the normal


def pairs(count=300):
    """Light and view, anywhere on the upper hemisphere."""
    rng = np.random.default_rng(3)
    z, azimuth = rng.uniform(0.02, 1, (2, count)), rng.uniform(-np.pi, np.pi, (2, count))
    xy = np.sqrt(1 - z**2) * np.stack([np.cos(azimuth), np.sin(azimuth)])
    return np.stack([*xy, z], axis=-1)


def read_pairs(tmp_path, name):
    """The vectors that come of a file with the numbers of `pairs`, and those numbers."""
    numbers = np.stack(FORWARD[name](*pairs()), axis=-1)
    measured = read_alta(write(tmp_path / f"{name}.alta", name, numbers))
    return measured.wi, measured.wo, numbers


def wrap(angle):
    return np.abs((angle + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize("name", FORWARD)
def test_the_pair_that_is_read_has_the_numbers_of_the_file(tmp_path, name):
    light, view, numbers = read_pairs(tmp_path, name)
    again = np.stack(FORWARD[name](light, view), axis=-1)
    assert wrap(again - numbers).max() < 1e-6  # an arc cosine near 1 is no more exact


@pytest.mark.parametrize("name", ABSOLUTE)
def test_both_directions_come_back(tmp_path, name):
    light, view, _ = read_pairs(tmp_path, name)
    np.testing.assert_allclose(light, pairs()[0], atol=1e-7)
    np.testing.assert_allclose(view, pairs()[1], atol=1e-7)


@pytest.mark.parametrize("name", ISOTROPIC)
def test_both_directions_come_back_but_for_a_turn(tmp_path, name):
    light, view, _ = read_pairs(tmp_path, name)
    turned = [dot(a, b) for a, b in ((light, view), (light, NORMAL), (view, NORMAL))]
    expected = [dot(a, b) for a, b in (pairs(), (pairs()[0], NORMAL), (pairs()[1], NORMAL))]
    np.testing.assert_allclose(turned, expected, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "direction"),
    [
        ("COS_TH", lambda l, v: dot(l, v) - 1),
        ("RUSIN_VH", lambda l, v: dot(l, v) - 1),
        ("COS_TH_TD", lambda l, v: rusin(l, v)[3]),
        ("RUSIN_TH_PH_TD", lambda l, v: rusin(l, v)[3]),
        ("RUSIN_TH_TD", lambda l, v: rusin(l, v)[3] - np.pi / 2),
        ("ISOTROPIC_TV_PROJ_DPHI", lambda l, v: l[:, 2] - 1),
        ("STARK_2D", lambda l, v: l[:, 2] - v[:, 2]),
        ("NEUMANN_2D", lambda l, v: l[:, 2] - v[:, 2]),
    ],
)
def test_what_the_numbers_leave_open_is_where_alta_puts_it(tmp_path, name, direction):
    light, view, _ = read_pairs(tmp_path, name)
    np.testing.assert_allclose(direction(light, view), 0, atol=1e-6)


def test_equal_angles_are_exact(tmp_path):
    measured = read_alta(write(tmp_path / "a.alta", "ISOTROPIC_TV_TL_DPHI", [0.3, 0.1, 3.0]))
    angles = (measured.theta_i, measured.phi_i, measured.theta_o, measured.phi_o)
    np.testing.assert_array_equal(np.ravel(angles), [0.1, 3.0, 0.3, 0.0])


def test_a_pair_half_below_the_horizon_stays_and_is_not_valid(tmp_path):
    measured = read_alta(write(tmp_path / "h.alta", "RUSIN_TH_TD_PD", [[0.2, 0.1, 0.0], [1.2, 1.2, 0.0]]))
    np.testing.assert_array_equal(measured.valid, [[True], [False]])
    assert measured.theta_o[1] > np.pi / 2
    assert np.isfinite(measured.theta_o).all()


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("COS_TH", [1.01]),
        ("COS_TH_TD", [0.5, -1.2]),
        ("RUSIN_VH", [0.1, 0.1, 0.1]),
        ("CARTESIAN", [0, 0, 1, 0, 0, 1.01]),
        ("CARTESIAN", [0, 0, 0, 0, 0, 1]),
        ("STARK_2D", [0.8, 0.8]),
        ("NEUMANN_3D", [0.8, 0.8, 0.0]),
        ("SCHLICK_TL_TK_PROJ_DPHI", [0.1, 1.7e308, 1.7e308]),
    ],
)
def test_numbers_that_are_no_pair_are_refused(tmp_path, name, numbers):
    error = fault(write(tmp_path / "none.alta", name, [numbers]))
    assert error.expected == f"pairs of directions in {name}"
    assert error.found.startswith("none in row 1: ")


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("RUSIN_TH_TD", [20, 45]),
        ("SPHERICAL_TL_PL_TV_PV", [45, 0, 45, 180]),
        ("ISOTROPIC_TL_TV_PROJ_DPHI", [15, 10, 10]),
        ("RETRO_TL_TVL_PROJ_DPHI", [15, 10, 10]),
    ],
)
def test_degrees_are_refused(tmp_path, name, numbers):
    assert "(degrees?)" in fault(write(tmp_path / "degrees.alta", name, [numbers])).found


@pytest.mark.parametrize("name", ["", "COS_TLV", "ISOTROPIC_TV_TL", "STEREOGRAPHIC", "UNKNOWN_INPUT"])
def test_other_parameterisations_are_refused_and_the_known_listed(tmp_path, name):
    error = fault(write(tmp_path / "other.alta", name, [[0.1, 0.2]]))
    assert all(known in error.expected for known in FORWARD)


# Outputs, intervals, headers

ANGLES = [[0.1, 0.0, 0.5, 1.0], [0.2, 0.0, 1.0, 1.0], [0.2, 0.0, np.pi / 2, 1.0]]
SPHERICAL = "SPHERICAL_TL_PL_TV_PV"


def test_a_cosine_factor_is_divided_out(tmp_path):
    path = write(
        tmp_path / "c.alta", SPHERICAL, ANGLES, [[1.0], [2.0], [3.0]], param_out="INV_STERADIAN_COSINE_FACTOR"
    )
    measured = read_alta(path)
    np.testing.assert_allclose(measured.values[:2, 0], [1 / np.cos(0.5), 2 / np.cos(1.0)], rtol=1e-15)
    assert not measured.valid[2].any()
    assert "divided" in measured.origin[-1]


def test_xyz_becomes_linear_srgb(tmp_path):
    """Against the matrix made of the chromaticities of sRGB's primaries and of D65."""
    x, y = np.array([[0.64, 0.30, 0.15], [0.33, 0.60, 0.06]])
    primaries, white = np.stack([x / y, 1 + 0 * x, (1 - x - y) / y]), np.array([0.3127, 0.3290])
    XYZ_white = np.array([white[0] / white[1], 1, (1 - white.sum()) / white[1]])
    to_xyz = primaries * np.linalg.solve(primaries, XYZ_white)
    rgb = np.array([[1.0, 1, 1], [0.2, 0.5, 0.9], [0.9, 0.01, 0.3]])
    measured = read_alta(write(tmp_path / "x.alta", SPHERICAL, ANGLES, rgb @ to_xyz.T, param_out="XYZ_COLOR"))
    np.testing.assert_allclose(measured.values, rgb, atol=1e-3)  # the matrix is printed with four digits


@pytest.mark.parametrize("param_out", ["UNKNOWN_OUTPUT", ""])
def test_unsaid_outputs_are_taken_for_a_reflectance(tmp_path, param_out):
    measured = read_alta(write(tmp_path / "u.alta", SPHERICAL, ANGLES, param_out=param_out))
    np.testing.assert_array_equal(measured.values, np.ones((3, 1)))
    assert measured.origin == ("PARAM_OUT is not said: taken for 1/sr",)


@pytest.mark.parametrize(("param_out", "channels"), [("ENERGY", 1), ("RGB_COLOR", 2), ("XYZ_COLOR", 1)])
def test_other_outputs_are_refused(tmp_path, param_out, channels):
    values = np.ones((3, channels))
    assert fault(write(tmp_path / "e.alta", SPHERICAL, ANGLES, values, param_out=param_out))


VALUES = np.array([[0.5, 0.25], [1.0, 2.0], [3.0, 4.0]])
HALF = np.array([[0.1, 0.3], [0.2, 0.2], [0.4, 0.4]])


@pytest.mark.parametrize(
    ("vs", "extra", "width"),
    [
        (["#VS 1", "#VS 1"], HALF, [0.4, 0.4, 0.8]),
        (["#VS 1 1"], HALF, [0.4, 0.4, 0.8]),
        (["#VS 1"], HALF, [0.4, 0.4, 0.8]),
        (["#VS 1"], HALF[:, :1], [0.2, 0.4, 0.8]),
        (["#VS 0", "#VS 1"], HALF[:, 1:], [0.6, 0.4, 0.8]),
        (["#VS 2", "#VS 1"], np.c_[VALUES[:, :1] - 0.1, VALUES[:, :1] + 0.3, HALF[:, 1:]], [0.5, 0.4, 0.6]),
        (["#VS 0"], HALF[:, :0], None),
        (["#VS 1"], np.array([[0.1], [0.0], [0.2]]), None),
        (["#VS 1"], np.array([[0.1], [-0.1], [0.2]]), None),
        (["#VS 1"], np.array([[1e308], [1e308], [0.2]]), None),
        (["#VS 1"], np.array([[1e-300], [1e-300], [1e-300]]), [1, 1, 1]),
    ],
)
def test_intervals_become_weights(tmp_path, vs, extra, width):
    path = write(tmp_path / "v.alta", SPHERICAL, ANGLES, np.hstack([VALUES, extra]), head=vs)
    path.write_text(path.read_text().replace(f"#DIM 4 {2 + extra.shape[1]}", "#DIM 4 2"))
    measured = read_alta(path)
    np.testing.assert_array_equal(measured.values, VALUES)
    weights = np.ones(3) if width is None else 1 / np.square(width)
    np.testing.assert_allclose(measured.weights, weights / weights.mean(), rtol=1e-14)


def test_header(tmp_path):
    path = tmp_path / "header.alta"
    path.write_bytes(
        b"# made by hand\r\n#\r\n\r\n#ALTA HEADER BEGIN\r\n#SAMPLE \"a 'b' \xe9\"\r\n#URL  http://x  \r\n"
        b"#DIM 1 1\r\n#PARAM_IN COS_TH\r\n# \r\n#ALTA HEADER END\r\n#DIM 7 7\r\n\r\n# rows\r\n"
        b"0.5 1\r\n\r\n# in between\r\n 0.6\t2 # and after\r\n"
    )
    measured = read_alta(path)
    assert measured.name == "a 'b' é"
    assert measured.origin == ("made by hand", "URL  http://x  ", "", "PARAM_OUT is not said: taken for 1/sr")
    np.testing.assert_allclose(np.cos(measured.theta_i), [0.5, 0.6])
    np.testing.assert_array_equal(measured.values[:, 0], [1, 2])


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("#DIM 4 2", "", "no such line"),
        ("#DIM 4 2", "#DIM 4", "'4'"),
        ("#DIM 4 2", "#DIM 4 0", "'4 0'"),
        ("#DIM 4 2", "#DIM 4 -2", "'4 -2'"),
        ("#DIM 4 2", "#DIM 3 3", "#DIM 3"),
        ("#DIM 4 2", "#DIM 4 3", "6 in line"),
        ("#DIM 4 2", f"#DIM 4 {10**12}", "1000000000004"),
        ("#DIM 4 2", f"#DIM {10**12} 2", "#DIM 1000000000000"),
        ("#DIM 4 2", f"#DIM 4 {'9' * 5000}", "'4 999"),
        ("#VS 0", "#VS 3", "3"),
        ("#VS 0", "#VS 0 0 0", "0 0 0"),
        ("#VS 0", "#VS 1", "6 in line"),
        ("#VS 0", "#FORMAT binary", "binary"),
        ("#VS 0", "#WAVELENGTHS_UM 0.5", "1: 0.5"),
        ("#VS 0", "#WAVELENGTHS_UM 0.5 nan", "nan"),
        ("#VS 0", "#WAVELENGTHS_UM 0.5 0", "2: 0.5, 0"),
        ("#VS 0", "#WAVELENGTHS_UM red green", "red"),
        ("\t4\n", "\tnan\n", "nan in row 3, column 6"),
        ("\t4\n", "\t1e999\n", "inf in row 3"),
        ("\t4\n", "\tfour\n", "something else in line 7"),
        ("\t4\n", "\n", "5 in line 7"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, old, new, part):
    path = write(tmp_path / "wrong.alta", SPHERICAL, ANGLES, VALUES, head=["#VS 0"])
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert part in fault(path).found


# Real files


def test_retro_reflector(shared_data):
    """Light and view side by side where it shines back: nothing else in the file is half as bright."""
    path = shared_data / "retro" / "retro-gray-tape.dat"
    measured, rows = read_alta(path), np.loadtxt(path)
    np.testing.assert_array_equal(measured.values[:, 0], rows[:, 3])
    np.testing.assert_array_equal(measured.theta_i, rows[:, 0])
    np.testing.assert_allclose(measured.theta_o * np.cos(measured.phi_o), rows[:, 1], atol=1e-15)
    np.testing.assert_allclose(measured.theta_o * np.sin(measured.phi_o), rows[:, 2], atol=1e-15)
    brightest = np.argmax(measured.values[:, 0])
    np.testing.assert_allclose(measured.wi[brightest], measured.wo[brightest], atol=1e-12)
    assert measured.name == "Gray Tape"
    assert 'ORIGIN "retro-reflection BRDF measures from CEA"' in measured.origin


def test_felt_is_that_of_the_reconstructed_database(shared_data, merl_material):
    """A slice of MERL against the slice of its neural fit: 2 to 3 % apart, 10 % at 95 of 100."""
    felt = read_alta(shared_data / "retro" / "pink-felt-1d.alta")
    slices = merl_material("pink-felt").slices()
    within = slices.theta_h <= felt.theta_i.max()
    measured = np.stack([np.interp(slices.theta_h, felt.theta_i, c) for c in felt.values.T], axis=-1)
    apart = np.abs(slices.m_h / measured - 1)[within]
    assert np.median(apart) < 0.035
    assert np.quantile(apart, 0.95) < 0.12
    assert (felt.theta_i == felt.theta_o).all()
    assert felt.name == "pink-felt-1d"


# Writing

TEXTS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\r\n"), max_size=20)


def theta_values(n):
    return arrays(float, n, elements=st.floats(0, np.pi / 2))


@st.composite
def contents(draw):
    """The fields of a record. It is made in the test: the checks of shapes draw random numbers themselves."""
    n, channels = draw(st.integers(1, 5)), draw(st.integers(1, 4))
    phis = arrays(float, n, elements=st.floats(-4 * np.pi, 4 * np.pi))
    values = draw(arrays(float, (n, channels), elements=FINITE))
    values[0, 0] = abs(values[0, 0])
    waves = arrays(float, channels, elements=st.floats(0, exclude_min=True, allow_infinity=False))
    return {
        "theta_i": draw(theta_values(n)),
        "phi_i": draw(phis),
        "theta_o": draw(theta_values(n)),
        "phi_o": draw(phis),
        "values": values,
        "weights": np.ones(n),
        "wavelengths": draw(st.none() | waves),
        "name": draw(TEXTS),
        "origin": tuple(draw(st.lists(TEXTS, max_size=3))),
    }


@settings(max_examples=40, deadline=None)
@given(fields=contents())
def test_what_is_written_is_read_bit_for_bit(tmp_path_factory, fields):
    path, record = tmp_path_factory.mktemp("alta") / "again.alta", MeasuredSamples(**fields)
    write_alta(path, record)
    again = read_alta(path)
    for field in ("theta_i", "phi_i", "theta_o", "phi_o", "values", "weights"):
        assert getattr(again, field).tobytes() == getattr(record, field).tobytes()
    np.testing.assert_array_equal(again.wavelengths, record.wavelengths)
    assert again.name == record.name
    assert again.origin == record.origin


def plain(**fields) -> MeasuredSamples:
    zeros = np.zeros(2)
    arguments = {
        "theta_i": zeros,
        "phi_i": zeros,
        "theta_o": zeros,
        "phi_o": zeros,
        "values": np.ones((2, 3)),
        "weights": np.ones(2),
    }
    return MeasuredSamples(**(arguments | fields))


@pytest.mark.parametrize("waves", [None, [0.4, 0.5, 0.6]])
def test_the_header_is_altas(tmp_path, waves):
    write_alta(tmp_path / "w.alta", plain(wavelengths=waves, name="a\nb", origin=("DIM 7 7\nVS 2",)))
    out = "RGB_COLOR" if waves is None else "INV_STERADIAN"
    lines = [
        '#SAMPLE "a b"',
        "# DIM 7 7",
        "# VS 2",
        "#DIM 4 3",
        f"#PARAM_IN {SPHERICAL}",
        f"#PARAM_OUT {out}",
    ]
    assert (tmp_path / "w.alta").read_text().splitlines()[:6] == lines
    assert read_alta(tmp_path / "w.alta").origin == ("DIM 7 7", "VS 2")


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"weights": np.array([1.0, 2.0])}, "weights: write CSV or HDF5"),
        ({"values": np.array([[1.0], [np.nan]])}, "NaN or infinity"),
        ({"values": np.array([[1.0], [np.inf]])}, "NaN or infinity"),
        ({"values": -np.ones((2, 3))}, "no value ≥ 0"),
        ({"values": np.ones((2, 0))}, "no sample"),
        ({"theta_o": np.array([0.0, 1.6])}, "below the horizon"),
        ({"phi_o": np.array([0.0, 13.0])}, "two turns"),
        ({"wavelengths": np.array([0.4, 0.0, 0.5])}, "wavelengths"),
        ({"origin": ("x",) * 10_001}, "10000 lines"),
    ],
)
def test_what_could_not_be_read_again_is_not_written(tmp_path, fields, match):
    (tmp_path / "old.alta").write_text("old")
    with pytest.raises(ValueError, match=match):
        write_alta(tmp_path / "old.alta", plain(**fields))
    assert (tmp_path / "old.alta").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["old.alta"]
