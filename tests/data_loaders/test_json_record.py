"""The JSON record of a fit: one entry a fit, plain types, and null for what is not a number."""

import json

import numpy as np
import pytest

from data_loaders import fit_to_json
from jaxbrdf import (
    CookTorrance,
    FitResult,
    FitStatus,
    LinearSchlick,
    ShiftedGamma,
    ShiftedGammaBRDF,
    TabulatedNDF,
)

PARAMETERS = ("rho_d", "rho_s", "alpha", "p", "f0", "f1")


def fit(shape, names=(), model=None):
    numbers = np.arange(6 * np.prod(shape, dtype=int)).reshape((6, *shape)) / 8
    covariance = np.broadcast_to(np.diag([1.0, 4.0, 9.0, np.nan, -1.0, np.inf]), (*shape, 6, 6))
    return FitResult(
        model=ShiftedGammaBRDF(*numbers) if model is None else model,
        status=np.full(shape, FitStatus.AT_BOUND),
        cost=np.full(shape, np.nan),
        steps=np.full(shape, 7),
        covariance=covariance,
        residuals=np.zeros((*shape, 4)),
        parameters=PARAMETERS,
        recipe="slices",
        names=names,
    )


def strict(result, **options):
    """Through JSON and back: raises for NaN and for anything that is not a plain type."""
    return json.loads(json.dumps(fit_to_json(result, **options), allow_nan=False))


def test_one_material():
    record = strict(fit((3,), names=("gold",)), source="gold.binary")
    assert record["model"] == "ShiftedGammaBRDF"
    assert record["recipe"] == "slices"
    assert record["provenance"]["source"] == ["gold.binary"]
    assert [(f["name"], f["channel"]) for f in record["fits"]] == [("gold", 0), ("gold", 1), ("gold", 2)]
    blue = record["fits"][2]
    assert (blue["status"], blue["message"]) == ("AT_BOUND", FitStatus.AT_BOUND.message)
    assert blue["steps"] == 7
    assert blue["cost"] is None
    assert [blue["parameters"][p]["value"] for p in PARAMETERS] == [(2 + 3 * k) / 8 for k in range(6)]
    assert [blue["parameters"][p]["standard_error"] for p in PARAMETERS] == [1, 2, 3, None, None, None]


def test_a_batch_is_material_by_channel():
    fits = strict(fit((2, 3), names=("gold", "felt")))["fits"]
    assert [(f["name"], f["channel"]) for f in fits] == [(n, c) for n in ("gold", "felt") for c in range(3)]
    assert [f["parameters"]["rho_d"]["value"] for f in fits] == [k / 8 for k in range(6)]


def test_one_grey_fit_without_a_name():
    (only,) = strict(fit(()))["fits"]
    assert (only["name"], only["channel"]) == (None, None)
    assert only["parameters"]["alpha"] == {"value": 0.25, "standard_error": 3.0}


def test_parameters_inside_models_and_shared_ones():
    model = CookTorrance(0.5, np.array([1.0, np.nan]), ShiftedGamma(0.25, 1.0), LinearSchlick(0.5, 0.0))
    fits = strict(fit((2,), model=model))["fits"]
    assert fits[1]["parameters"]["rho_s"]["value"] is None
    for entry in fits:
        assert [*entry["parameters"]] == ["rho_d", "rho_s", "ndf.alpha", "ndf.p", "fresnel.f0", "fresnel.f1"]
        assert entry["parameters"]["ndf.alpha"] == {"value": 0.25, "standard_error": None}


@pytest.mark.parametrize("shape", [(), (3,)])
def test_tables_are_left_out(shape):
    assert all(f["parameters"] == {} for f in strict(fit(shape, model=TabulatedNDF(np.ones((5, 5)))))["fits"])
