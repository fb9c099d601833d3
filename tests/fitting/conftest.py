"""A distribution of one parameter that the library does not have, to fit like any other."""

import jax.numpy as jnp
import pytest

import jaxbrdf as jb
from jaxbrdf.arrays import Parameter, Range, parameter


class PlainBeckmann(jb.AbstractIsotropicNDF):
    """Isotropic Beckmann: P22(x) = exp(−x/α²) / (π α²)."""

    alpha: Parameter = parameter(fitted=Range(1e-3, 1.0, log=True))

    def slope_density(self, x):
        return jnp.exp(-x / self.alpha**2) / (jnp.pi * self.alpha**2)

    def slope_scales(self):
        return self.alpha, 6 * self.alpha

    def _sample(self, u):
        raise NotImplementedError


@pytest.fixture(scope="session")
def beckmann():
    return PlainBeckmann
