from .backscattering import BackscatteringNDF, backscattering_ndf
from .catalogue import catalogue
from .distribution import fit_ndf
from .factors import fit_factors
from .image import fit_image
from .least_squares import nonnegative_least_squares
from .losses import LOSSES, Loss, compressed, robust
from .masking_approximation import fit_masking
from .minimize import Minimum, minimize
from .patches import fit_ndf_patches
from .recipes import RECIPES, fit_shifted_gamma, fit_two_slice
from .reflectance import fit_losses, fit_reflectance

__all__ = [
    "LOSSES",
    "RECIPES",
    "BackscatteringNDF",
    "Loss",
    "Minimum",
    "backscattering_ndf",
    "catalogue",
    "compressed",
    "fit_factors",
    "fit_image",
    "fit_losses",
    "fit_masking",
    "fit_ndf",
    "fit_ndf_patches",
    "fit_reflectance",
    "fit_shifted_gamma",
    "fit_two_slice",
    "minimize",
    "nonnegative_least_squares",
    "robust",
]
