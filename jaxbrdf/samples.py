"""Measured reflectance at scattered pairs of directions, as goniometers give it."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

_ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o")


def _floats(values) -> np.ndarray:
    return np.asarray(values, dtype=float)


def _optional_floats(values) -> np.ndarray | None:
    return None if values is None else _floats(values)


class MeasuredSamples(eqx.Module):
    r"""Reflectance measured at N pairs of directions that lie on no grid, in C channels.

    `theta_i`, `phi_i` (N,) are the angles of the light, `theta_o`, `phi_o` (N,) those of the viewer, in
    radians, as the instrument gave them; `wi` and `wo` are the directions. `values` (N, C) is the reflectance
    in 1/sr as it was measured; a sample is *valid* where it is ≥ 0 and both directions are above the horizon.
    `weights` (N,) ≥ 0 say how much each pair counts, 1 unless the file knows better. `wavelengths` (C,) are
    in micrometres, None for RGB and where nobody knows. `origin` holds what else the file says of itself,
    line by line. Raises ValueError where the shapes do not belong together.
    """

    theta_i: Float[np.ndarray, " N"] = eqx.field(converter=_floats)
    phi_i: Float[np.ndarray, " N"] = eqx.field(converter=_floats)
    theta_o: Float[np.ndarray, " N"] = eqx.field(converter=_floats)
    phi_o: Float[np.ndarray, " N"] = eqx.field(converter=_floats)
    values: Float[np.ndarray, "N C"] = eqx.field(converter=_floats)
    weights: Float[np.ndarray, " N"] = eqx.field(converter=_floats)
    wavelengths: Float[np.ndarray, " C"] | None = eqx.field(converter=_optional_floats, default=None)
    name: str = eqx.field(static=True, default="")
    origin: tuple[str, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        pairs, channels = self.values.shape if self.values.ndim == 2 else (None, None)
        expected = dict.fromkeys((*_ANGLES, "weights"), (pairs,))
        if self.wavelengths is not None:
            expected["wavelengths"] = (channels,)
        found = {name: getattr(self, name).shape for name in expected}
        if found != expected:
            raise ValueError(
                f"MeasuredSamples: values {self.values.shape} must be (N, C), and the rest {expected}; "
                f"found {found}"
            )

    @property
    def wi(self) -> Float[np.ndarray, "N 3"]:
        """The directions towards the light."""
        return _direction(self.theta_i, self.phi_i)

    @property
    def wo(self) -> Float[np.ndarray, "N 3"]:
        """The directions towards the viewer."""
        return _direction(self.theta_o, self.phi_o)

    @property
    def valid(self) -> Bool[np.ndarray, "N C"]:
        """Which samples may be used."""
        above = (np.cos(self.theta_i) > 0) & (np.cos(self.theta_o) > 0)
        return above[:, None] & (self.values >= 0)


def _direction(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    sin = np.sin(theta)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), np.cos(theta)], axis=-1)
