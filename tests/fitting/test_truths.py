"""The numpy truths of this folder against the brute-force and mpmath ones that all tests share."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests import references
from tests.fitting import truths


@pytest.mark.parametrize(("alpha", "p"), references.PUBLISHED_LOBES)
def test_density_is_the_published_one(alpha, p):
    theta = np.array([0.0, 0.01, 0.3, 1.0])
    expected = references.sgd(alpha, p)(references.direction(theta, 0.4))
    assert_allclose(truths.density(theta, alpha, p), expected, rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize(("alpha", "p"), [(0.003, 0.9), (0.05, 0.4), (0.3, 0.6), (0.2, 1.8)])
def test_projected_area_is_the_double_integral(alpha, p):
    theta = np.array([0.3, 1.2, 1.5])
    expected = [references.sgd_projected_area(alpha, p, t) for t in theta]
    assert_allclose(np.exp(truths.log_area(np.cos(theta), alpha, p)), expected, rtol=1e-7)


def test_table_is_cook_torrance_pair_by_pair():
    import jaxbrdf as jb

    grid = jb.merl_grid()
    row = {"rho_d": 0.1, "rho_s": 0.5, "alpha": 0.05, "p": 0.4, "f0": 0.6, "f1": 0.1}
    table = truths.table(grid, [tuple(row.values())])
    for i, j, k in [(0, 0, 0), (20, 30, 40), (50, 60, 100)]:
        h, d = (
            references.direction(grid.theta_h[i], 0.0),
            references.direction(grid.theta_d[j], grid.phi_d[k]),
        )
        wi = references.rotation("y", grid.theta_h[i]) @ d
        expected = references.cook_torrance(wi, 2 * (wi @ h) * h - wi, **row)
        assert_allclose(table[i, j, k, 0], expected, rtol=1e-6)
    assert np.all(table[89, 80:, 0] == -1)
