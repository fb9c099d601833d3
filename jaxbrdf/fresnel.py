"""How much a facet reflects: functions of cos θ_d, θ_d being the angle between light and facet normal."""

from abc import abstractmethod

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxbrdf.arrays import (
    NON_NEGATIVE,
    POSITIVE,
    Domain,
    Parameter,
    Parametric,
    Range,
    floats,
    parameter,
    per_channel,
)
from jaxbrdf.special import complex_sqrt, safe_divide, safe_power, safe_sqrt

_SHARE = Domain(0.0, 1.0)


class AbstractFresnel(Parametric):
    """A Fresnel term: called with cos θ_d (...), gives F (...), or (..., C) with C channels."""

    def __call__(self, cos_theta_d: ArrayLike) -> Float[Array, "..."]:
        """F(θ_d)."""
        return per_channel(type(self)._reflectance)(self, floats(cos_theta_d))

    @abstractmethod
    def _reflectance(self, c: Float[Array, "..."]) -> Float[Array, "..."]:
        """F for one channel at c = cos θ_d."""


class Conductor(AbstractFresnel):
    r"""The exact reflectance of a metal for unpolarised light.

        F = (R_⊥ + R_∥) / 2,   R_⊥ = |(c − u) / (c + u)|²,   R_∥ = |(N² c − u) / (N² c + u)|²
        N = η + iκ,   u = √(N² − sin²θ_d) = a + ib,   c = cos θ_d

    N is the index of the metal relative to the medium around it: `eta` > 0, `kappa` ≥ 0, else ValueError.
    Sun et al. 2002, eq. 5.4 to 5.8, which print R_∥ with a (η² + κ²) in place of Re(N² u*) and square two
    brackets too many. F(π/2) = 1. Where u = 0 (κ = 0 at the critical angle) F = 1, and its slopes, infinite
    on one side, are stated as 0. `data_loaders.optical_constants` knows N of metals.
    """

    eta: Parameter = parameter(domain=POSITIVE, fitted=Range(0.05, 20.0, log=True))
    kappa: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(1e-3, 20.0, log=True))

    def _reflectance(self, c: Float[Array, "..."]) -> Float[Array, "..."]:
        return _unpolarised(c, self.eta, self.kappa)


class Dielectric(AbstractFresnel):
    r"""The exact reflectance of a transparent medium for unpolarised light: `Conductor` with κ = 0.

    `eta` > 0 is the index behind the facet over that before it, else ValueError. For η < 1 all is reflected,
    F = 1, from the critical angle sin θ_d = η on. η = 1 is no boundary: F = 0, at grazing incidence too.
    """

    eta: Parameter = parameter(domain=POSITIVE, fitted=Range(1.01, 100.0, log=True))

    def _reflectance(self, c: Float[Array, "..."]) -> Float[Array, "..."]:
        return _unpolarised(c, self.eta, jnp.zeros_like(self.eta))


class Lazanyi(AbstractFresnel):
    r"""Schlick's approximation scaled to a complex index, with a correction for the dip before grazing.

        F = ((η − 1)² + 4η (1 − c)^5 + κ²) / ((η + 1)² + κ²) − a c (1 − c)^b,   c = cos θ_d

    Lazányi & Szirmay-Kalos 2005, "Fresnel term approximations for metals". Exact at c = 0 and c = 1. Give
    both `a` and `b` > 0, or neither: the last term is then left out. Their values for a metal come from a fit
    to `Conductor`; no published ones stand here. Raises ValueError unless η > 0, κ ≥ 0, b > 0, and for one of
    a and b without the other.
    """

    eta: Parameter = parameter(domain=POSITIVE, fitted=Range(0.05, 20.0, log=True))
    kappa: Parameter = parameter(domain=NON_NEGATIVE, fitted=Range(1e-3, 20.0, log=True))
    a: Parameter | None = parameter(optional=True)
    b: Parameter | None = parameter(domain=POSITIVE, optional=True)

    def __check_init__(self):
        if (self.a is None) != (self.b is None):
            raise ValueError("Lazanyi: a and b belong together; give both of them or none")

    def _reflectance(self, c: Float[Array, "..."]) -> Float[Array, "..."]:
        eta, kappa = self.eta, self.kappa
        F = ((eta - 1) ** 2 + 4 * eta * (1 - c) ** 5 + kappa**2) / ((eta + 1) ** 2 + kappa**2)
        return F if self.a is None else F - self.a * c * safe_power(1 - c, self.b)


class Schlick(AbstractFresnel):
    r"""Schlick's approximation: F = F_0 + (1 − F_0)(1 − cos θ_d)^5.

    Schlick 1994, "An inexpensive BRDF model for physically-based rendering". `f0` is the reflectance at
    normal incidence; ValueError unless it lies in [0, 1].
    """

    f0: Parameter = parameter(domain=_SHARE, fitted=Range(0.0, 1.0))

    def _reflectance(self, c: Float[Array, "..."]) -> Float[Array, "..."]:
        return self.f0 + (1 - self.f0) * (1 - c) ** 5


class LinearSchlick(AbstractFresnel):
    r"""Schlick's approximation with a linear slope, for metals and metallic paints.

        F(θ_d) = F_0 + (1 − F_0)(1 − cos θ_d)^5 − F_1 cos θ_d

    Bagher et al. 2012, eq. 11. F_1 = 0 is Schlick's. F(π/2) = 1 always; F(0) = F_0 − F_1, which seven
    published rows make negative: nothing is clamped here.
    """

    f0: Parameter = parameter(fitted=Range(0.0, 1.0))
    f1: Parameter = parameter(fitted=Range(-1.0, 1.0))

    def _reflectance(self, c: Float[Array, "..."]) -> Float[Array, "..."]:
        return self.f0 + (1 - self.f0) * (1 - c) ** 5 - self.f1 * c


class Constant(AbstractFresnel):
    """F = F_0 at every angle; `f0` = 1 leaves a BRDF to its geometry. ValueError unless `f0` is in [0, 1]."""

    f0: Parameter = parameter(domain=_SHARE)

    def _reflectance(self, c: Float[Array, "..."]) -> Float[Array, "..."]:
        return self.f0 + jnp.zeros_like(c)


def kappa_from_reflectance(f0: ArrayLike, eta: ArrayLike = 1.0) -> Float[Array, "..."]:
    r"""The κ that gives a metal of index η the reflectance F_0 at normal incidence; f0 and eta broadcast.

        κ = √((F_0 (η + 1)² − (η − 1)²) / (1 − F_0)),   √(4 F_0 / (1 − F_0)) for η = 1

    Sun et al. 2002, eq. 5.10 and 5.11, for a material of which only a reflectance is known. Raises ValueError
    (outside jit) unless ((η − 1)/(η + 1))² ≤ F_0 < 1. At the lower end κ = 0, its infinite slope stated as 0;
    under jit κ is 0 below that end too, and infinite at F_0 = 1.
    """
    f0, eta = jnp.broadcast_arrays(floats(f0), floats(eta))
    excess = f0 * (eta + 1) ** 2 - (eta - 1) ** 2
    if not isinstance(excess, jax.core.Tracer):
        _check_reflectance(f0, eta, excess)
    return safe_sqrt(excess / (1 - f0))


def _check_reflectance(f0: Array, eta: Array, excess: Array) -> None:
    if np.any(~((f0 >= 0) & (f0 < 1))):
        raise ValueError(
            f"f0 must lie in [0, 1), the share of light reflected at normal incidence; found {f0}. "
            "No finite κ reflects all: scale the reflectance below 1"
        )
    rounding = 4 * jnp.finfo(f0.dtype).eps * (eta + 1) ** 2
    if np.any(~((eta > 0) & (excess >= -rounding))):
        raise ValueError(
            f"no real κ gives f0 = {f0} with η = {eta}: η > 0 alone reflects ((η − 1)/(η + 1))² at normal "
            "incidence, and κ only adds to that; take an η nearer to 1, which always has a κ"
        )


def _unpolarised(c, eta, kappa):
    """Mean of R_⊥ and R_∥, as `Conductor` gives them, in real arithmetic; all three arguments broadcast."""
    a, b = complex_sqrt((eta - 1) * (eta + 1) + c**2 - kappa**2, 2 * eta * kappa)
    re, im = (eta - kappa) * (eta + kappa), 2 * eta * kappa  # of N²
    R_perp = safe_divide((c - a) ** 2 + b**2, (c + a) ** 2 + b**2)
    R_par = safe_divide((re * c - a) ** 2 + (im * c - b) ** 2, (re * c + a) ** 2 + (im * c + b) ** 2)
    return (R_perp + R_par) / 2
