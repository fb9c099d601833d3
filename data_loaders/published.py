"""Reflectances that the literature published for measured materials: tables of parameters, as models.

The tables stand in published/; published_models.py says which model a row of each makes.
"""

import csv
import difflib
from functools import cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from data_loaders.published_models import PUBLISHED, Published
from jaxbrdf.brdf.ashikhmin_materials import ASHIKHMIN_MATERIALS, ashikhmin_material
from jaxbrdf.brdf.base import AbstractBRDF

_CHANNELS = ("R", "G", "B")
_GENERATED = "ashikhmin"  # has materials, but no table of parameters


def published(model: str, material: str) -> AbstractBRDF:
    """The reflectance that a paper gives for one material, of MERL mostly, with RGB channels, in 1/sr.

    | model | what it gives | source |
    |---|---|---|
    | sgd | `ShiftedGammaBRDF` with the masking of eq. 9 | Bagher et al. 2012 |
    | abc, abc-smooth | `Lambertian` + `ABC`, + `SmoothABC` | Löw et al. 2012 |
    | low-ashikhmin-shirley-e1, …-e2 | `Lambertian` + factor * `AshikhminShirleyLobe` | Löw et al. 2012 |
    | low-cook-torrance-e1, …-e2 | `Lambertian` + factor * `Microfacet` | Löw et al. 2012 |
    | ngan-ashikhmin-shirley | `Lambertian` + factor * `AshikhminShirleyLobe` | Ngan et al. 2005 |
    | ngan-blinn-phong | `Lambertian` + factor * `BlinnPhongBRDF` | Ngan et al. 2005 |
    | ngan-cook-torrance | `Lambertian` + factor * `Microfacet` | Ngan et al. 2005 |
    | ngan-lafortune | `Lambertian` + factor * `Lafortune` | Ngan et al. 2005 |
    | ngan-ward, ngan-ward-duer | `Lambertian` + factor * `Ward`, * `WardDuer` | Ngan et al. 2005 |
    | ashikhmin | `ashikhmin_material`, made by hand, not fitted; takes seconds | Ashikhmin et al. 2000 |

    e1 and e2 are the two measures of error that Löw et al. minimised. The papers do not say, or not wholly,
    to which norm, Fresnel term and units the numbers belong; benchmarks/published_conventions.py tries the
    candidates on tables of the materials, and the header of each table in published/ says what came out.

    Bagher's model with Smith's exact masking is `dataclasses.replace(model, shadowing=Uncorrelated())`.
    `published_parameters` gives the numbers as printed. Raises ValueError for an unknown model or material,
    and in single precision for the mirrors of "sgd", whose c reaches 1e109.
    """
    if model == _GENERATED:
        return ashikhmin_material(material)
    row = published_parameters(model, material)
    return _entry(model).build({name: _as_parameter(name, value) for name, value in row.items()})


def published_parameters(model: str, material: str) -> dict[str, np.ndarray]:
    """The numbers as printed, by their names in the table: (3,) where R, G and B differ, else ().

    The header of the table in published/ gives the formula they belong to. Raises ValueError for an unknown
    model or material, and for "ashikhmin", whose materials have no table.
    """
    rows = _rows(model)
    if material not in rows:
        raise ValueError(f"no published {model} parameters of {material!r}; {_suggestion(material, rows)}")
    return _group_channels(rows[material])


def published_materials(model: str) -> list[str]:
    """The materials that `published` knows for a model. Raises ValueError for an unknown model."""
    if model == _GENERATED:
        return list(ASHIKHMIN_MATERIALS)
    return list(_rows(model))


def _as_parameter(name: str, value: np.ndarray) -> Array:
    """In the precision that JAX has. Raises ValueError where that cannot hold it."""
    if np.max(value) > jnp.finfo(jnp.result_type(float)).max:
        raise ValueError(
            f"the parameter {name} is {np.max(value):g}, too much for single precision: switch double "
            "precision on, jax.config.update('jax_enable_x64', True)"
        )
    return jnp.asarray(value)


def _entry(model: str) -> Published:
    if model not in PUBLISHED:
        raise ValueError(
            f"no published parameters of a model named {model!r}; there are: {', '.join(PUBLISHED)}, and "
            f"without a table {_GENERATED}"
        )
    return PUBLISHED[model]


def _rows(model: str) -> dict[str, dict[str, str]]:
    return _read(Path(__file__).with_name("published") / _entry(model).table)


@cache
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
