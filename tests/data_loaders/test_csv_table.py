"""Tables of goniometers: names, units and delimiters in all their spellings, round trips, and bad tables."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from data_loaders import DataError, read_csv, write_csv
from jaxbrdf import MeasuredSamples

TABLE = """# name: brass, brushed
# lamp: halogen
theta_i,phi_i,theta_o,phi_o,weight,465nm,0.525um
0.1,0,0.2,3.14,1,0.5,-0.25
0.3,1.5,1.5,0,2.5,1e-3,7
"""


def write(path, text=TABLE, encoding="utf-8"):
    path.write_text(text, encoding=encoding)
    return path


def fault(path) -> DataError:
    with pytest.raises(DataError) as caught:
        read_csv(path)
    assert "\n" not in str(caught.value)
    return caught.value


def angles(measured):
    return np.stack([measured.theta_i, measured.phi_i, measured.theta_o, measured.phi_o], axis=-1)


# Reading


def test_table(tmp_path):
    measured = read_csv(write(tmp_path / "t.csv"))
    np.testing.assert_array_equal(angles(measured), [[0.1, 0, 0.2, 3.14], [0.3, 1.5, 1.5, 0]])
    np.testing.assert_array_equal(measured.values, [[0.5, -0.25], [1e-3, 7]])
    np.testing.assert_array_equal(measured.weights, [1, 2.5])
    np.testing.assert_array_equal(measured.wavelengths, [0.465, 0.525])
    assert measured.name == "brass, brushed"
    assert measured.origin == ("lamp: halogen",)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("delimiter", [",", ";", "\t", ", "])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
def test_delimiters_line_ends_and_encodings(tmp_path, end, delimiter, encoding):
    lines = ["# Größe", "theta_i,phi_i,theta_o,phi_o,465nm", "0.1,0.2,0.3,0.4,5", "", "0,0,0,0,6 # end"]
    text = end.join(line.replace(",", delimiter) for line in lines)
    measured = read_csv(write(tmp_path / "d.csv", text, encoding))
    np.testing.assert_array_equal(angles(measured), [[0.1, 0.2, 0.3, 0.4], [0, 0, 0, 0]])
    np.testing.assert_array_equal(measured.values, [[5], [6]])
    assert measured.origin == ("Größe",)
    assert measured.name == "d"


@pytest.mark.parametrize(
    ("suffix", "unit"),
    [(s, 1.0) for s in ("", "_rad", " (rad)", " [rad]", "[radians]", "_radian")]
    + [
        (s, np.pi / 180) for s in ("_deg", " (deg)", " [deg]", "(degrees)", " deg", " [°]", "_DEG", "_degree")
    ],
)
@pytest.mark.parametrize("end", ["o", "s", "r", "v"])
def test_units_and_ends(tmp_path, suffix, unit, end):
    header = f"R,PHI_{end.upper()}{suffix},Theta_{end}{suffix},thetai{suffix}"
    measured = read_csv(write(tmp_path / "u.csv", f"{header}\n7,0.25,0.5,1\n"))
    np.testing.assert_allclose(angles(measured), [[unit, 0, 0.5 * unit, 0.25 * unit]], rtol=1e-15)
    np.testing.assert_array_equal(measured.values, [[7]])


@pytest.mark.parametrize(
    ("names", "order", "origin"),
    [
        ("R,G,B", [0, 1, 2], ()),
        ("b,r,g", [1, 2, 0], ()),
        ("value_0,value_1,value_2", [0, 1, 2], ()),
        ("red,G,brdf (1/sr)", [0, 1, 2], ("channels: red, brdf (1/sr)",)),
        ('"R","G","B"', [0, 1, 2], ()),
    ],
)
def test_channels_without_wavelengths(tmp_path, names, order, origin):
    text = f"theta_i,theta_o,phi_o,{names}\n0,0,0,1,2,3\n"
    measured = read_csv(write(tmp_path / "c.csv", text))
    np.testing.assert_array_equal(measured.values, [np.array([1.0, 2, 3])[order]])
    assert measured.wavelengths is None
    assert measured.origin == origin


@pytest.mark.parametrize("name", ["465nm", "465 nm", "465.NM", "0.465um", "0.465 µm", "0.465μm", "465e-3um"])
def test_wavelengths(tmp_path, name):
    measured = read_csv(write(tmp_path / "w.csv", f"theta_i,theta_o,phi_o,{name}\n0,0,0,1\n"))
    np.testing.assert_array_equal(measured.wavelengths, [0.465])


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("theta_i,", "incidence,", "theta_i among them"),
        (",phi_o", ",azimuth", "phi_o among them"),
        (",phi_o", ",phi_out", "phi_o among them"),
        (",weight", ",phi_out", "'phi_out'"),
        (",phi_o", ",theta_s", "one column theta_o"),
        (",phi_o", ",phi_o,phi_o_deg", "one column phi_o"),
        (",weight,465nm", ",weight,weights", "2 and 1"),
        (",465nm,0.525um", "", "1 and 0"),
        ("465nm,0.525um", "465nm,green", "'green'"),
        ("465nm,0.525um", "4nm,0.525um", "nanometres"),
        ("0.525um", "0um", "'0um'"),
        ("0.525um", "1e999um", "'1e999um'"),
        ("0.525um", "", "''"),
        ("0.1,0,", "0.1,", "6 in line 4"),
        ("1e-3,7", "1e-3", "6 in line 5"),
        ("1e-3,7", "1e-3,", "something else in line 5"),
        ("1e-3,7", "1e-3,nan", "nan in row 2, column 7"),
        ("1e-3,7", "1e-3,inf", "inf in row 2, column 7"),
        ("1e-3,7", '1e-3,"7"', "something else"),
        ("1,0.5", "-1,0.5", "-1"),
        ("0.3,1.5,1.5", "0.3,1.5,45", "(degrees?)"),
        ("0.3,1.5,1.5", "0.3,1.5,1.58", "call it theta_o_deg"),
        ("0.3,1.5,1.5", "0.3,150,1.5", "(degrees?)"),
        ("0.5,-0.25", "-0.5,-0.25", None),
    ],
)
def test_what_is_wrong_is_said(tmp_path, old, new, part):
    assert old in TABLE
    path = write(tmp_path / "wrong.csv", TABLE.replace(old, new, 1))
    if part is None:
        assert read_csv(path)
    else:
        assert part in str(fault(path))


# Writing

FINITE = st.floats(allow_nan=False, allow_infinity=False)
TEXTS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\r\n"), max_size=20)


@st.composite
def contents(draw):
    """The fields of a record. It is made in the test: the checks of shapes draw random numbers themselves."""
    n, channels = draw(st.integers(1, 5)), draw(st.integers(1, 4))
    thetas = arrays(float, n, elements=st.floats(0, np.pi / 2))
    phis = arrays(float, n, elements=st.floats(-4 * np.pi, 4 * np.pi))
    values = draw(arrays(float, (n, channels), elements=FINITE))
    values[0, 0] = abs(values[0, 0])
    waves = arrays(float, channels, elements=st.floats(0, exclude_min=True, allow_infinity=False))
    return {
        "theta_i": draw(thetas),
        "phi_i": draw(phis),
        "theta_o": draw(thetas),
        "phi_o": draw(phis),
        "values": values,
        "weights": draw(st.just(np.ones(n)) | arrays(float, n, elements=st.floats(0, 1e300))),
        "wavelengths": draw(st.none() | waves),
        "name": draw(TEXTS),
        "origin": tuple(draw(st.lists(TEXTS, max_size=3))),
    }


@settings(max_examples=40, deadline=None)
@given(fields=contents())
def test_what_is_written_is_read_bit_for_bit(tmp_path_factory, fields):
    path, record = tmp_path_factory.mktemp("csv") / "again.csv", MeasuredSamples(**fields)
    write_csv(path, record)
    again = read_csv(path)
    for field in ("theta_i", "phi_i", "theta_o", "phi_o", "values", "weights"):
        assert getattr(again, field).tobytes() == getattr(record, field).tobytes()
    np.testing.assert_array_equal(again.wavelengths, record.wavelengths)
    assert again.name == record.name
    assert again.origin == record.origin


def plain(channels=3, **fields) -> MeasuredSamples:
    zeros = np.zeros(2)
    values = np.ones((2, channels))
    arguments = {"theta_i": zeros, "phi_i": zeros, "theta_o": zeros, "phi_o": zeros, "values": values}
    return MeasuredSamples(**(arguments | {"weights": np.ones(2)} | fields))


@pytest.mark.parametrize(
    ("record", "names"),
    [
        (plain(), "R,G,B"),
        (plain(1), "value"),
        (plain(2), "value_0,value_1"),
        (plain(2, weights=np.array([1, 0.5])), "weight,value_0,value_1"),
        (plain(3, wavelengths=np.array([0.465, 0.525, 1e-7])), "0.465um,0.525um,1e-07um"),
    ],
)
def test_the_names_of_the_columns(tmp_path, record, names):
    write_csv(tmp_path / "n.csv", record)
    lines = ["# name: ", f"theta_i,phi_i,theta_o,phi_o,{names}"]
    assert (tmp_path / "n.csv").read_text().splitlines()[:2] == lines


def test_many_blocks_of_rows(tmp_path):
    """More rows than are formatted at a time, against numpy's own reader."""
    rng = np.random.default_rng(1)
    record = plain().__class__(
        *rng.random((4, 40_000)), values=rng.random((40_000, 3)), weights=np.ones(40_000)
    )
    write_csv(tmp_path / "long.csv", record)
    rows = np.loadtxt(tmp_path / "long.csv", delimiter=",", skiprows=2)
    np.testing.assert_array_equal(rows, np.hstack([angles(record), record.values]))


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"values": np.array([[1.0], [np.nan]])}, "NaN or infinity"),
        ({"values": -np.ones((2, 3))}, "no value ≥ 0"),
        ({"weights": np.array([1.0, -1.0])}, "weights below 0"),
        ({"weights": np.array([1.0, np.inf])}, "NaN or infinity"),
        ({"theta_i": np.array([0.0, 1.6])}, "below the horizon"),
        ({"phi_i": np.array([0.0, 13.0])}, "two turns"),
        ({"name": "\ud800"}, "surrogates"),
    ],
)
def test_what_could_not_be_read_again_is_not_written(tmp_path, fields, match):
    (tmp_path / "old.csv").write_text("old")
    with pytest.raises(ValueError, match=match):
        write_csv(tmp_path / "old.csv", plain(**fields))
    assert (tmp_path / "old.csv").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["old.csv"]
