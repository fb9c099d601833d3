from . import metrics
from .brdf.base import AbstractBRDF, Sum
from .brdf.cook_torrance import CookTorrance
from .brdf.lambertian import Lambertian
from .brdf.measured import MeasuredBRDF, Slices
from .brdf.shifted_gamma import ShiftedGammaBRDF
from .directions import (
    dot,
    from_frame,
    from_half_difference,
    half_vector,
    reflect,
    spherical,
    to_frame,
    to_half_difference,
    to_spherical,
)
from .fit_result import FitResult, FitStatus
from .fresnel import AbstractFresnel, LinearSchlick
from .metrics import albedo, compare, largest_albedo, normalized_l2
from .ndf.base import AbstractIsotropicNDF, AbstractNDF
from .ndf.shifted_gamma import ShiftedGamma
from .ndf.tabulated import TabulatedNDF
from .ndf.tabulated_area import TabulatedArea, tabulate_projected_area
from .quadrature import HalfDifferenceGrid, hemisphere, merl_grid
from .shadowing import AbstractShadowing, ShiftedGammaShadowing, Uncorrelated, smith_G1
from .special import log_upper_gamma, upper_gamma

__all__ = [
    "AbstractBRDF",
    "AbstractFresnel",
    "AbstractIsotropicNDF",
    "AbstractNDF",
    "AbstractShadowing",
    "CookTorrance",
    "FitResult",
    "FitStatus",
    "HalfDifferenceGrid",
    "Lambertian",
    "LinearSchlick",
    "MeasuredBRDF",
    "ShiftedGamma",
    "ShiftedGammaBRDF",
    "ShiftedGammaShadowing",
    "Slices",
    "Sum",
    "TabulatedArea",
    "TabulatedNDF",
    "Uncorrelated",
    "albedo",
    "compare",
    "dot",
    "from_frame",
    "from_half_difference",
    "half_vector",
    "hemisphere",
    "largest_albedo",
    "log_upper_gamma",
    "merl_grid",
    "metrics",
    "normalized_l2",
    "reflect",
    "smith_G1",
    "spherical",
    "tabulate_projected_area",
    "to_frame",
    "to_half_difference",
    "to_spherical",
    "upper_gamma",
]
