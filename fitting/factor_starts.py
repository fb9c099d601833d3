"""Where the fit of free factors starts: what the two slices of a table show."""

import numpy as np
from jaxtyping import Float

from fitting.factor_cells import polar_nodes
from jaxbrdf.brdf.measured import Slices

_LIMIT = np.deg2rad(80)  # backscattering beyond this is not trusted


def starts(slices: Slices, channel: int) -> list[Float[np.ndarray, " n"]]:
    r"""log (ρ_d, D, F, G1) read off the slices, once with all that may be diffuse, once with little of it:

        ρ_d = π q min m_h,   D = 4 cos²θ_h (m_h − ρ_d/π),   F = 4 cos²θ_d (m_d − ρ_d/π) / (D(0) G1²)

    with q = 1 and G1 = 1, or q = 0.1 and G1 = √cos θ; D takes what masking there is.
    """
    m_h = np.where(slices.theta_h < _LIMIT, slices.m_h[:, channel], np.nan)
    m_d, cos_h, cos_d = slices.m_d[:, channel], np.cos(slices.theta_h), np.cos(slices.theta_d)
    known = m_h[np.isfinite(m_h)]
    least, typical = (known.min(), np.median(known)) if known.size else (0.0, 0.0)
    found = []
    for share, power in ((1.0, 0.0), (0.1, 0.5)):
        diffuse = max(share * least, 1e-3 * typical, 1e-9)
        D = _positive(4 * cos_h**2 * (m_h - diffuse))
        F = _positive(4 * cos_d ** (2 - 2 * power) * (m_d - diffuse)) / D[0]
        found.append(np.log(np.concatenate([[np.pi * diffuse], D, F, np.cos(polar_nodes()[:-1]) ** power])))
    return found


def _positive(values: np.ndarray) -> np.ndarray:
    """The values, at least 1e-4 of the largest; unknown ones are interpolated, all 1e-9 if none is known."""
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(values), 1e-9)
    nodes = np.arange(len(values))
    filled = np.interp(nodes, nodes[known], values[known])
    return np.maximum(filled, max(1e-4 * filled.max(), 1e-9))
