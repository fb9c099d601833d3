"""The Mini-Diff's files: the real ones against numpy's own reader, and what is refused."""

import numpy as np
import pytest

from data_loaders import DataError, read_minidiff

HEADER = """LAB_NAME Light Tec

SAMPLE_NAME C2_White
NUM_POINTS 3
VARS theta_i,phi_i,theta_s,465nm,525.5nm,630nm

"""
ROWS = [
    "0,3.14159265358979,0,0,8.05,8.70,8.72",
    "0.349065850398866,3.14159265358979,1.5707963267949,1.5,-0.001,0.0,1E-3",
    "0.698131700797732,3.14159265358979,0.5,6.28318530717959,1,2,3",
]
TEXT = HEADER + "\n".join(ROWS) + "\n"
NAMES = ["C1_White", "C8_Silver", "C10_Copper", "Metal_Blue"]


def write(path, text=TEXT):
    path.write_text(text, encoding="latin-1")
    return path


def fault(path) -> DataError:
    with pytest.raises(DataError) as caught:
        read_minidiff(path)
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize("name", NAMES)
def test_real_files_against_genfromtxt(shared_data, name):
    path = shared_data / "minidiff" / f"{name}.astm"
    rows = np.genfromtxt(path, delimiter=",", skip_header=14)
    measured = read_minidiff(path)
    assert rows.shape == (12964, 7)
    angles = (measured.theta_i, measured.phi_i, measured.theta_o, measured.phi_o)
    np.testing.assert_array_equal(np.stack([*angles, *measured.values.T], axis=1), rows)
    np.testing.assert_array_equal(measured.wavelengths, [0.465, 0.525, 0.63])
    assert measured.name == name
    assert "APERTURE Circular" in measured.origin
    np.testing.assert_allclose(np.unique(measured.theta_i), np.radians([0, 20, 40, 60]), atol=1e-12)


def test_the_mirror_direction_is_opposite(shared_data):
    """The silver paint is brightest at φ_s = φ_i − π and θ_s = θ_i (at θ_i = 60° the channels disagree)."""
    measured = read_minidiff(shared_data / "minidiff" / "C8_Silver.astm")
    for theta in np.radians([20, 40]):
        there = np.flatnonzero(np.isclose(measured.theta_i, theta))
        brightest = there[np.argmax(measured.values[there, 1])]
        assert np.cos(measured.phi_o[brightest] - measured.phi_i[brightest]) == pytest.approx(-1, abs=1e-12)
        assert abs(measured.theta_o[brightest] - theta) < np.radians(1.5)


def test_negative_values_stay_and_are_not_valid(tmp_path):
    measured = read_minidiff(write(tmp_path / "white.astm"))
    np.testing.assert_array_equal(measured.values[1], [-0.001, 0.0, 1e-3])
    assert measured.theta_o[1] == 1.5707963267949  # as the file has it, a little beyond the horizon
    assert not measured.valid[1].any()
    assert measured.valid[[0, 2]].all()
    assert measured.name == "white"
    assert measured.origin[1] == "SAMPLE_NAME C2_White"


def test_the_name_of_phi_s_may_stand_there(tmp_path):
    named = write(tmp_path / "named.astm", TEXT.replace("theta_s,", "theta_s,phi_s,"))
    np.testing.assert_array_equal(read_minidiff(named).phi_o, [0, 1.5, 6.28318530717959])


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("POINTS 3", "POINTS 4", "3"),
        ("POINTS 3", f"POINTS {10**12}", "3"),
        ("POINTS 3", f"POINTS {'9' * 5000}", "3"),
        ("POINTS 3", "POINTS some", "3"),
        ("VARS ", "VARIABLES ", "'0,3.1415"),
        ("VARS ", "", "'0,3.1415"),
        ("theta_i,", "theta_i,phi_s,", "VARS"),
        ("465nm,525.5nm,630nm", "BRDF", "VARS"),
        ("465nm", "465um", "VARS"),
        ("465nm", "4nm", "4, 525.5, 630"),
        ("465nm,", "", "7 in line 7"),
        ("0,3.14159265358979,0,0,", "0,3.14159265358979,0,", "6 in line 7"),
        (",1E-3", "", "6 in line 8"),
        (",1E-3", ",", "something else in line 8"),
        ("1E-3", "nan", "nan in row 2, column 7"),
        ("1E-3", "-inf", "-inf in row 2, column 7"),
        ("0.698131700797732", "40", "(degrees?)"),
        ("6.28318530717959", "360", "(degrees?)"),
        ("0.349065850398866", "-0.349065850398866", "-0.349066"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, old, new, part):
    assert old in TEXT
    assert part in fault(write(tmp_path / "wrong.astm", TEXT.replace(old, new, 1))).found


def test_lines_may_not_be_missing(tmp_path, shared_data):
    text = (shared_data / "minidiff" / "C1_White.astm").read_text()
    error = fault(write(tmp_path / "cut.astm", text[: text.rindex("\n", 0, 10**6) + 1]))
    assert "NUM_POINTS" in error.expected
    assert "12964" in error.expected
