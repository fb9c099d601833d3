"""README.md keeps its word: its Python example runs as printed."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

README = Path(__file__).resolve().parents[1] / "README.md"


def test_the_python_example_runs_as_printed(tmp_path):
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    done = subprocess.run([sys.executable, "-c", example], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    numbers = [float(n) for n in re.findall(r"[-\d.]+(?:e-?\d+)?", done.stdout)]
    np.testing.assert_allclose(numbers[:9], [0, 0, 0, 0.15, 0.15, 0.15, 0.9, 0.9, 0.9], rtol=1e-5)
