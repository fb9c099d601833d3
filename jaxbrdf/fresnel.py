"""How much a facet reflects: functions of cos θ_d, θ_d being the angle between light and facet normal."""

from abc import abstractmethod

import equinox as eqx
from jaxtyping import Array, Float

from jaxbrdf.arrays import Parameter, parameter, per_channel


class AbstractFresnel(eqx.Module):
    """A Fresnel term: called with cos θ_d (...), gives F (...), or (..., C) with C channels."""

    @abstractmethod
    def __call__(self, cos_theta_d: Float[Array, "..."]) -> Float[Array, "..."]:
        """F(θ_d)."""


class LinearSchlick(AbstractFresnel):
    r"""Schlick's approximation with a linear slope, for metals and metallic paints.

        F(θ_d) = F_0 + (1 − F_0)(1 − cos θ_d)^5 − F_1 cos θ_d

    Bagher et al. 2012, eq. 11. F_1 = 0 is Schlick's. F(π/2) = 1 always; F(0) = F_0 − F_1, which seven
    published rows make negative: nothing is clamped here.
    """

    f0: Parameter = parameter()
    f1: Parameter = parameter()

    @per_channel
    def __call__(self, cos_theta_d: Float[Array, "..."]) -> Float[Array, "..."]:
        return self.f0 + (1 - self.f0) * (1 - cos_theta_d) ** 5 - self.f1 * cos_theta_d
