"""What commands that take height maps share: which files, how they are prepared, what is said of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_loaders import DataError, read_heightfield, scan_files
from jaxbrdf import Heightfield, levelled, without_outliers
from jaxbrdf.cli import batch

_LEVELS = {"none": 0, "plane": 1, "quadratic": 2}


@dataclass(frozen=True)
class Treatment:
    """How scans are read and prepared."""

    level: str = "plane"
    outliers: bool = True
    unit: str | None = None
    pixel: float | None = None

    def refuse_nonsense(self) -> None:
        if self.level not in _LEVELS:
            raise batch.Refused(f"--level {self.level}: expected one of {', '.join(_LEVELS)}")

    def about(self) -> dict[str, str]:
        """What a file says of how its scans were treated."""
        return {"levelled": self.level, "outliers": "kept" if self.outliers else "masked out"}

    def read(self, path: Path) -> Heightfield:
        """The map of a file, without outliers and form."""
        heightfield = read_heightfield(path, unit=self.unit, pixel=self.pixel)
        if not self.outliers:
            heightfield = without_outliers(heightfield)
        degree = _LEVELS[self.level]
        return levelled(heightfield, degree) if degree else heightfield


def inputs(scans: Sequence[Path], out: Path) -> list[Path]:
    """The files of all scans; refuses an output that is no HDF5 file, or would overwrite one of them."""
    if out.suffix.lower() not in (".h5", ".hdf5"):
        raise batch.Refused(f"--out {out}: expected a name that ends in .h5")
    try:
        files = scan_files(scans)
    except DataError as error:
        raise batch.Refused(str(error)) from error
    written = {out.resolve(), out.with_suffix(".png").resolve()}
    for file in files:
        if file.resolve() in written:
            raise batch.Refused(f"--out {out}: the result would overwrite {file}; give it another name")
    batch.writable_folder(out.parent)
    return files


def described(path: Path, heightfield: Heightfield) -> dict[str, Any]:
    """What is to be said of a prepared scan."""
    valid = np.asarray(heightfield.valid)
    heights = np.asarray(levelled(heightfield).heights)[valid]
    return {
        "name": path.stem,
        "source": str(path),
        "shape": list(valid.shape),
        "pixel": [heightfield.dx, heightfield.dy],
        "missing": float(1 - valid.mean()),
        "Sq": float(np.sqrt(np.mean(heights**2))),
    }
