"""README.md keeps its word: its Python examples run as printed."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests import references

README = Path(__file__).resolve().parents[1] / "README.md"


@pytest.fixture(scope="module")
def examples():
    return re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


def numbers_printed_by(example: str, folder: Path) -> list[float]:
    done = subprocess.run([sys.executable, "-c", example], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return [float(n) for n in re.findall(r"[-\d.]+(?:e-?\d+)?", done.stdout)]


def test_the_fit_finds_its_parameters_again(examples, tmp_path):
    numbers = numbers_printed_by(examples[0], tmp_path)
    np.testing.assert_allclose(numbers[:9], [0, 0, 0, 0.15, 0.15, 0.15, 0.9, 0.9, 0.9], rtol=1e-5)


def test_any_model_is_fitted_to_samples(examples, tmp_path):
    numbers = numbers_printed_by(examples[1], tmp_path)
    np.testing.assert_allclose(numbers, [0.2, 0.7, 0.1, 0.3, 0.04], rtol=1e-3)


def test_a_height_map_becomes_an_ellipsoid(examples, tmp_path):
    """A Gaussian filter of σ widens τ² by 4σ² along both axes: α_y/α_x is √((400 + 4) / (16 + 4))."""
    status, alpha_x, alpha_y = numbers_printed_by(examples[2], tmp_path)
    assert status == 0
    assert alpha_y / alpha_x == pytest.approx(np.sqrt(404 / 20), rel=0.1)


def test_a_height_map_becomes_a_texture(examples, tmp_path):
    share, reflectance = numbers_printed_by(examples[3], tmp_path)
    assert share == 1
    assert reflectance > 0


def test_the_new_distribution_shadows_as_brute_force_says(examples, tmp_path):
    def logistic(m, alpha=0.3):
        above = m[..., 2] > 1e-9
        cos = np.where(above, m[..., 2], 1)
        y = np.minimum((1 / cos**2 - 1) / alpha**2, 600)
        return np.where(above, 1 / (2 * np.pi * alpha**2 * np.cosh(y / 2) ** 2 * cos**4), 0)

    masks = [w[2] / references.projected_area(logistic, w) for w in references.direction([1.2, 0.5], 0.0)]
    np.testing.assert_allclose(numbers_printed_by(examples[4], tmp_path), [masks[0] * masks[1]], rtol=2e-6)


def test_these_are_all_examples(examples):
    assert len(examples) == 5
