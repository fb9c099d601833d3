"""Cornell's files: the real ones against a plain split, layouts that vary, and what is refused."""

import numpy as np
import pytest

from data_loaders import DataError, read_cornell

TEXT = (
    "# Cornell\r\n# Gläsern\r\n\r\n# num wls\r\n3\r\n\r\n# wls\r\n400 550.5\r\n700\r\n\r\n# theta i, ...\r\n"
    "0.5 0.0 0.25 3.141593 0.1 0.2 0.3\r\n"
    "0.0 0.1 1.570796 -0.5 -0.01 0.0 1e-3 # noisy\r\n"
)


def write(path, text=TEXT, encoding="latin-1"):
    path.write_bytes(text.encode(encoding))
    return path


def fault(path) -> DataError:
    with pytest.raises(DataError) as caught:
        read_cornell(path)
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize("name", ["garnet_red", "krylon_blue"])
def test_real_files_against_a_plain_split(shared_data, name):
    path = shared_data / "cornell" / f"{name}.brdf"
    words = [line.partition("#")[0].split() for line in path.read_text(encoding="latin-1").splitlines()]
    rows = np.array([list(map(float, line)) for line in words if len(line) == 35])
    measured = read_cornell(path)
    assert measured.values.shape == (1439, 31)
    np.testing.assert_array_equal(measured.theta_i, rows[:, 0])
    np.testing.assert_array_equal(measured.phi_i, rows[:, 1])
    np.testing.assert_array_equal(measured.theta_o, rows[:, 2])
    np.testing.assert_array_equal(measured.phi_o, rows[:, 3])
    np.testing.assert_array_equal(measured.values, rows[:, 4:])
    np.testing.assert_allclose(measured.wavelengths, np.arange(400, 701, 10) / 1000, rtol=1e-15)
    assert measured.name == name
    assert measured.origin[0] == "Cornell University, Program of Computer Graphics"


def test_the_mirror_direction_is_at_phi_pi(shared_data):
    """The glossy paint is brightest near the mirror direction of every incidence from 20°."""
    measured = read_cornell(shared_data / "cornell" / "garnet_red.brdf")
    for theta in np.unique(measured.theta_i[measured.theta_i > 0.3]):
        there = np.flatnonzero(measured.theta_i == theta)
        brightest = there[np.argmax(measured.values[there, 15])]
        assert abs(abs(measured.phi_o[brightest]) - np.pi) < 1e-6
        assert measured.theta_o[brightest] > theta - 0.1


def test_layout(tmp_path):
    measured = read_cornell(write(tmp_path / "glass.brdf"))
    np.testing.assert_array_equal(measured.theta_o, [0.25, 1.570796])
    np.testing.assert_array_equal(measured.phi_o, [3.141593, -0.5])
    np.testing.assert_array_equal(measured.values, [[0.1, 0.2, 0.3], [-0.01, 0, 1e-3]])
    np.testing.assert_array_equal(measured.valid, [[True] * 3, [False, True, True]])
    np.testing.assert_array_equal(measured.wavelengths, [0.4, 0.5505, 0.7])
    np.testing.assert_array_equal(measured.weights, [1, 1])
    assert measured.origin == ("Cornell", "Gläsern", "num wls")
    assert measured.name == "glass"


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("\r\n3\r\n", "\r\n\r\n", "'400 550.5'"),
        ("\r\n3\r\n", "\r\n0\r\n", "0"),
        ("\r\n3\r\n", "\r\n2\r\n", "1 in line 9: '700'"),
        ("\r\n3\r\n", "\r\n4\r\n", "10"),
        ("\r\n3\r\n", f"\r\n{10**12}\r\n", f"{10**12}"),
        ("\r\n3\r\n", f"\r\n{'9' * 5000}\r\n", "'9999"),
        ("400 550.5", "400 green", "green"),
        ("400 550.5", "0.4 0.55", "0.4, 0.55, 700"),
        ("400 550.5", "400 nan", "nan"),
        ("0.3\r\n", "0.3 0.4\r\n", "8 in line 12"),
        ("1e-3", "", "6 in line 13"),
        ("1e-3", "O.1", "something else in line 13"),
        ("1e-3", "nan", "nan in row 2, column 7"),
        ("1e-3", "1e999", "inf in row 2"),
        ("0.5 0.0", "28.6 0.0", "(degrees?)"),
        ("1.570796", "1.58", "1.58"),
        ("0.25 3.14", "0.25 180.", "(degrees?)"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, old, new, part):
    assert TEXT.count(old) >= 1
    assert part in fault(write(tmp_path / "wrong.brdf", TEXT.replace(old, new, 1))).found


def test_nothing_valid(tmp_path):
    text = TEXT[: TEXT.index("0.5 0.0")] + "0.5 0 0.5 0 -1 -1 -1\n"
    assert "none: all 3 values are negative" in fault(write(tmp_path / "void.brdf", text)).found
