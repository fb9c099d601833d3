"""Model parameters that the literature published for measured materials; small tables in published/."""

import csv
import difflib
from pathlib import Path

import numpy as np

_TABLES = {"abc": "abc_low2012.csv", "sgd": "sgd_bagher2012.csv"}
_CHANNELS = ("R", "G", "B")


def published(model: str, material: str) -> dict[str, np.ndarray]:
    """The published parameters of `model` for one MERL material, by the names its paper uses.

    Parameters that differ between R, G and B are (3,), the shared ones (). Models: "abc" (Löw et al.
    2012: kD, A, B, C, ior) and "sgd" (Bagher et al. 2012: rhoD, rhoS, alpha, p, F0, F1, …); each table's
    header gives the source and the formula the numbers belong to.
    Raises ValueError for an unknown model or material.
    """
    rows = _rows(model)
    if material not in rows:
        raise ValueError(f"no published {model} parameters of {material!r}; {_suggestion(material, rows)}")
    return _group_channels(rows[material])


def published_materials(model: str) -> list[str]:
    """The materials that `published` knows for a model. Raises ValueError for an unknown model."""
    return list(_rows(model))


def _rows(model: str) -> dict[str, dict[str, str]]:
    if model not in _TABLES:
        raise ValueError(
            f"no published parameters of a model named {model!r}; there are: {', '.join(_TABLES)}"
        )
    return _read(Path(__file__).with_name("published") / _TABLES[model])


def _read(path: Path) -> dict[str, dict[str, str]]:
    """The rows of a table by material; lines that begin with # are comments."""
    with path.open(encoding="utf-8") as file:
        return {row.pop("material"): row for row in csv.DictReader(line for line in file if line[0] != "#")}


def _group_channels(row: dict[str, str]) -> dict[str, np.ndarray]:
    names = dict.fromkeys(column.rsplit("_", 1)[0] for column in row)
    return {name: np.array(_values(row, name)) for name in names}


def _values(row: dict[str, str], name: str) -> float | list[float]:
    return float(row[name]) if name in row else [float(row[f"{name}_{channel}"]) for channel in _CHANNELS]


def _suggestion(material: str, known: dict[str, dict[str, str]]) -> str:
    near = difflib.get_close_matches(material, known) or [*list(known)[:3], "…"]
    return f"of {len(known)} materials the nearest names are: {', '.join(near)}"
