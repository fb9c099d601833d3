"""What a height map accepts, and what it says of itself."""

import numpy as np
import pytest

from jaxbrdf import Heightfield

FLAT = np.zeros((3, 4))


def test_missing_heights_count_as_zero_whatever_stands_there():
    z = np.array([[1.0, np.nan], [np.inf, 2.0]])
    surface = Heightfield(z, 0.5, 2, mask=np.isfinite(z))
    np.testing.assert_array_equal(surface.heights, [[1, 0], [0, 2]])
    np.testing.assert_array_equal(surface.valid, [[True, False], [False, True]])
    assert surface.size == (4.0, 1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((1, 5)), 1, 1), "at least 2"),
        ((np.zeros(5), 1, 1), "at least 2"),
        ((FLAT, 0, 1), "dx must be a length in micrometres greater than 0; found 0"),
        ((FLAT, 1, -2), "dy must be a length"),
        ((FLAT, 1, np.nan), "dy must be a length"),
        ((FLAT, 1, 1, np.ones((4, 3), bool)), "the shape of z"),
        ((FLAT, 1, 1, np.zeros((3, 4), bool)), "no height was measured"),
        ((np.array([[0, np.nan], [1, np.inf]]), 1, 1), "2 heights are NaN or infinite"),
    ],
)
def test_a_map_that_makes_no_sense_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Heightfield(*arguments)
