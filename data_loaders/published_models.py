"""Which reflectance a row of published parameters makes: one small function for each formula.

The formulas, and how surely they are the papers' own, stand in the headers of the tables in published/.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxbrdf.brdf.abc import ABC, SmoothABC
from jaxbrdf.brdf.ashikhmin_shirley import AshikhminShirleyLobe
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.brdf.lafortune import Lafortune
from jaxbrdf.brdf.lambertian import Lambertian
from jaxbrdf.brdf.microfacet import Microfacet
from jaxbrdf.brdf.phong import BlinnPhongBRDF
from jaxbrdf.brdf.shifted_gamma import ShiftedGammaBRDF
from jaxbrdf.brdf.ward import Ward, WardDuer
from jaxbrdf.fresnel import Dielectric, Schlick
from jaxbrdf.ndf.beckmann import Beckmann
from jaxbrdf.shadowing import ShiftedGammaShadowing, VCavity

Parameters = dict[str, Array]  # (3,) where R, G and B differ, else ()

# Ngan's numbers are of MERL's samples / 1500; these bring R, G and B to 1/sr as MERL defines it.
_NGAN_TO_MERL = np.array([1.0, 1.15, 1.66])


class Published(NamedTuple):
    """A table in published/ and what makes a reflectance of one of its rows."""

    table: str
    build: Callable[[Parameters], AbstractBRDF]


def _sgd(row: Parameters) -> AbstractBRDF:
    return ShiftedGammaBRDF(
        rho_d=row["rhoD"],
        rho_s=row["rhoS"],
        alpha=row["alpha"],
        p=row["p"],
        f0=row["F0"],
        f1=row["F1"],
        shadowing=ShiftedGammaShadowing(row["lambda"], row["c"], row["k"]),
    )


def _abc(row: Parameters) -> AbstractBRDF:
    return Lambertian(row["kD"]) + ABC(row["A"], row["B"], row["C"], row["ior"])


def _abc_smooth(row: Parameters) -> AbstractBRDF:
    return Lambertian(row["kD"]) + SmoothABC(row["A"], row["B"], row["C"], row["ior"])


def _low_ashikhmin_shirley(row: Parameters) -> AbstractBRDF:
    return _glossy(row, AshikhminShirleyLobe(Dielectric(row["ior"]), row["n"]))


def _low_cook_torrance(row: Parameters) -> AbstractBRDF:
    """Cook & Torrance 1982 have 1/π where microfacet theory has 1/4, and a D that lacks its 1/π."""
    return _glossy(row, 4.0 * Microfacet(Beckmann(row["m"]), Dielectric(row["ior"]), VCavity()))


def _ngan_ashikhmin_shirley(row: Parameters) -> AbstractBRDF:
    return _ngan(row, AshikhminShirleyLobe(Schlick(row["F0"]), row["n"]))


def _ngan_blinn_phong(row: Parameters) -> AbstractBRDF:
    return _ngan(row, BlinnPhongBRDF(row["n"]))


def _ngan_cook_torrance(row: Parameters) -> AbstractBRDF:
    """Cook & Torrance 1981 have 1/π, and a D with 1/4: together the norm of microfacet theory."""
    index = (1 + jnp.sqrt(row["F0"])) / (1 - jnp.sqrt(row["F0"]))
    return _ngan(row, Microfacet(Beckmann(row["m"]), Dielectric(index), VCavity()))


def _ngan_lafortune(row: Parameters) -> AbstractBRDF:
    n, largest = row["n"], jnp.maximum(jnp.abs(row["Cxy"]), row["Cz"])
    lobe = Lafortune(n, c_x=row["Cxy"] / largest, c_z=row["Cz"] / largest)
    return _ngan(row, (n + 2) / (2 * jnp.pi) * lobe)


def _ngan_ward(row: Parameters) -> AbstractBRDF:
    return _ngan(row, Ward(row["alpha"]))


def _ngan_ward_duer(row: Parameters) -> AbstractBRDF:
    return _ngan(row, WardDuer(row["alpha"]))


def _ngan(row: Parameters, lobe: AbstractBRDF) -> AbstractBRDF:
    return _glossy({name: row[name] * _NGAN_TO_MERL for name in ("kd", "ks")}, lobe)


def _glossy(row: Parameters, lobe: AbstractBRDF) -> AbstractBRDF:
    return Lambertian(row["kd"]) + row["ks"] * lobe


PUBLISHED = {
    "sgd": Published("sgd_bagher2012.csv", _sgd),
    "abc": Published("abc_low2012.csv", _abc),
    "abc-smooth": Published("abc_smooth_low2012.csv", _abc_smooth),
    "low-ashikhmin-shirley-e1": Published("ashikhmin_shirley_e1_low2012.csv", _low_ashikhmin_shirley),
    "low-ashikhmin-shirley-e2": Published("ashikhmin_shirley_e2_low2012.csv", _low_ashikhmin_shirley),
    "low-cook-torrance-e1": Published("cook_torrance_e1_low2012.csv", _low_cook_torrance),
    "low-cook-torrance-e2": Published("cook_torrance_e2_low2012.csv", _low_cook_torrance),
    "ngan-ashikhmin-shirley": Published("ashikhmin_shirley_ngan2005.csv", _ngan_ashikhmin_shirley),
    "ngan-blinn-phong": Published("blinn_phong_ngan2005.csv", _ngan_blinn_phong),
    "ngan-cook-torrance": Published("cook_torrance_ngan2005.csv", _ngan_cook_torrance),
    "ngan-lafortune": Published("lafortune_ngan2005.csv", _ngan_lafortune),
    "ngan-ward": Published("ward_ngan2005.csv", _ngan_ward),
    "ngan-ward-duer": Published("ward_duer_ngan2005.csv", _ngan_ward_duer),
}
