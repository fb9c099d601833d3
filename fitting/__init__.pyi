from .least_squares import nonnegative_least_squares
from .masking_approximation import fit_masking
from .recipes import RECIPES, fit_shifted_gamma, fit_two_slice

__all__ = [
    "RECIPES",
    "fit_masking",
    "fit_shifted_gamma",
    "fit_two_slice",
    "nonnegative_least_squares",
]
