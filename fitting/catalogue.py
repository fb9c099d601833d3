"""The fits that stand side by side in comparisons: each model by name, with the way it is fitted."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType

import equinox as eqx
import numpy as np

from fitting.factors import fit_factors
from fitting.losses import Loss
from fitting.recipes import fit_shifted_gamma
from fitting.reflectance import fit_reflectance
from jaxbrdf.brdf.abc import ABC
from jaxbrdf.brdf.ashikhmin_shirley import AshikhminShirleyLobe
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.brdf.lafortune import Lafortune
from jaxbrdf.brdf.lambertian import Lambertian
from jaxbrdf.brdf.measured import MeasuredBRDF
from jaxbrdf.brdf.microfacet import Microfacet
from jaxbrdf.brdf.shifted_gamma import ShiftedGammaBRDF
from jaxbrdf.brdf.ward import Ward
from jaxbrdf.fit_result import FitResult, FitStatus
from jaxbrdf.fresnel import Schlick
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.beckmann import Beckmann
from jaxbrdf.ndf.student_t import StudentT
from jaxbrdf.ndf.trowbridge_reitz import TrowbridgeReitz

IMAGE_LOSSES = ("l2", "log", "cube_root", "log_ratio")  # what 'image' chooses among


class AbstractEntry(eqx.Module):
    """A model and how it is fitted to tables that share a grid."""

    @abstractmethod
    def fit(self, measured: Sequence[MeasuredBRDF], loss: str | Loss) -> list[FitResult]:
        """One result for each table. `loss` is one of `fit_reflectance`, or 'image': the best-looking."""


class General(AbstractEntry):
    """Any sum of reflectances, by `fit_reflectance`."""

    model: AbstractBRDF

    def fit(self, measured: Sequence[MeasuredBRDF], loss: str | Loss) -> list[FitResult]:
        if loss == "image":
            result = fit_reflectance(self.model, measured, IMAGE_LOSSES, select="image")
        else:
            result = fit_reflectance(self.model, measured, loss)
        return [result[i] for i in range(len(measured))]


class Recipe(AbstractEntry):
    """The shifted gamma reflectance by `fit_shifted_gamma`, which has a balance of losses of its own."""

    recipe: str = eqx.field(static=True)

    def fit(self, measured: Sequence[MeasuredBRDF], loss: str | Loss) -> list[FitResult]:
        result = fit_shifted_gamma(measured, self.recipe)
        return [result[i] for i in range(len(measured))]


class SecondLobe(AbstractEntry):
    """The shifted gamma reflectance of recipe 'full', whose Fresnel term stays, and a GGX lobe besides.

    Under L2 its error over the cells looked at is at most that of the recipe.
    """

    def fit(self, measured: Sequence[MeasuredBRDF], loss: str | Loss) -> list[FitResult]:
        first = fit_shifted_gamma(measured, "full")
        return [self._with_second(first[i], one, loss) for i, one in enumerate(measured)]

    def _with_second(self, first: FitResult, measured: MeasuredBRDF, loss: str | Loss) -> FitResult:
        if np.any(np.asarray(first.status) > FitStatus.STEP_LIMIT):
            return first
        assert isinstance(first.model, ShiftedGammaBRDF)
        model = first.model.as_cook_torrance(first.model.ndf) + facets(TrowbridgeReitz(0.3))
        fixed = ("terms[0].fresnel.f0", "terms[0].fresnel.f1")
        if loss == "image":
            return fit_reflectance(model, measured, IMAGE_LOSSES, select="image", fixed=fixed)
        return fit_reflectance(model, measured, loss, fixed=fixed)


class FreeForm(AbstractEntry):
    """Tabulated D, F and G1 by `fit_factors`: the bound of what facets can do. 'image' means 'log' here."""

    def fit(self, measured: Sequence[MeasuredBRDF], loss: str | Loss) -> list[FitResult]:
        result = fit_factors(measured, loss="log" if loss == "image" else loss)
        return [result[i] for i in range(len(measured))]


def facets(ndf: AbstractNDF) -> AbstractBRDF:
    """A factor times facets with Schlick's Fresnel term and Smith's shadowing, all of them to be sought."""
    return 1.0 * Microfacet(ndf, Schlick(0.3))


@lru_cache
def catalogue() -> Mapping[str, AbstractEntry]:
    """The models by name; 'sgd' is the shifted gamma reflectance, of recipe 'full' unless it says another."""
    diffuse = Lambertian(0.3)
    return MappingProxyType(
        {
            "lambertian": General(diffuse),
            "lafortune": General(diffuse + 1.0 * Lafortune(20.0, -1.0, c_z=0.95)),
            "ward": General(diffuse + 1.0 * Ward(0.2)),
            "ashikhmin-shirley": General(diffuse + 1.0 * AshikhminShirleyLobe(Schlick(0.3), 50.0)),
            "beckmann": General(diffuse + facets(Beckmann(0.2))),
            "ggx": General(diffuse + facets(TrowbridgeReitz(0.2))),
            "student-t": General(diffuse + facets(StudentT(0.2, 3.0))),
            "abc": General(diffuse + ABC(1.0, 100.0, 1.0, 1.5)),
            "sgd-slices": Recipe("slices"),
            "sgd-linear": Recipe("slices+linear"),
            "sgd": Recipe("full"),
            "sgd+lobe": SecondLobe(),
            "free-form": FreeForm(),
        }
    )
