"""Every distribution at the seams, in single precision, with channels and in batches."""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose

from tests.jaxbrdf.ndf.cases import ABOVE, TYPICAL, compiled_quickly, evaluated, every_kind, every_ndf

U = np.linspace(0.05, 0.9, 10).reshape(5, 2)


@every_ndf
def test_values_and_gradients_are_finite_at_the_seams(case):
    at = evaluated(case)
    for a in (at.value, at.by_parameter, at.by_direction):
        assert np.all(np.isfinite(a))


@every_ndf
def test_single_precision_is_finite_at_the_seams(case):
    at = evaluated(case, np.float32)
    for a in (at.value, at.by_parameter, at.by_direction):
        assert a.dtype == np.float32
        assert np.all(np.isfinite(a))


@every_ndf
def test_single_precision_is_accurate(case):
    """D and σ at directions and parameters that are the same in both precisions."""
    single = evaluated(case, np.float32)
    double = evaluated(case, np.float32, np.float64)
    assert_allclose(single.value[0, TYPICAL], double.value[0, TYPICAL], rtol=2e-4)
    assert_allclose(single.value[1, ABOVE], double.value[1, ABOVE], rtol=2e-4)


@compiled_quickly
def everything(make, parameters, m, u):
    """D and σ (2, N), normals (M, 3) and, where there are such, visible normals (M, 3); channels trail."""
    ndf = make(*parameters)
    normals = [ndf.sample(u)]
    if hasattr(ndf, "sample_visible"):
        normals.append(ndf.sample_visible(u, m[4]))
    return [jnp.stack([ndf(m), ndf.projected_area(m)]), *normals]


@every_kind
def test_channels_and_batches_are_models_of_their_own(case):
    """Leaves (C,): results trail. Leaves (B,), by vmap: the same results lead. One of them: leaves ()."""
    at = evaluated(case)
    m = np.concatenate([at.m[ABOVE], at.m[TYPICAL]])
    factors = np.array([1.0, 0.96, 0.9])
    parameters = np.array(case.parameters)[:, None] * factors
    rgb = everything(case.make, parameters, m, U)
    batch = jax.vmap(lambda p: everything(case.make, p, m, U), 1)(parameters)
    for trailing, leading in zip(rgb, batch, strict=True):
        assert trailing.shape == (*leading.shape[1:], 3)
        assert np.all(np.any(np.ptp(trailing, axis=-1) > 0, axis=-1))
        assert_allclose(trailing, np.moveaxis(leading, 0, -1), rtol=1e-11, atol=1e-13)
    assert_allclose(batch[0][0, :, : ABOVE.stop], at.value[:, ABOVE], rtol=1e-11, atol=1e-200)
    assert_allclose(batch[0][0, :, ABOVE.stop :], at.value[:, TYPICAL], rtol=1e-11)
