"""The fits that stand side by side in comparisons."""

import numpy as np
import pytest

from fitting import catalogue
from jaxbrdf import Comparison


@pytest.mark.slow
def test_a_second_lobe_helps_those_who_need_it(merl_material):
    """Bagher et al. 2012, section 6.3, name these three as what one lobe does not fit."""
    materials = [merl_material(name) for name in ("two-layer-gold", "two-layer-silver", "alum-bronze")]
    one, two = (catalogue()[name].fit(materials, "l2") for name in ("sgd", "sgd+lobe"))
    for material, first, second in zip(materials, one, two, strict=True):
        errors = Comparison.of(material).errors
        before, after = (errors(fit.model)["normalized_l2"] for fit in (first, second))
        np.testing.assert_array_less(after, before, err_msg=material.name)
