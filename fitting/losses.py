r"""What a fit minimises: how far apart two reflectances are.

    E² = Σ w (φ(f) − φ(m))²,   φ(f) = ((1 + k y)^q − 1) / (q k),   y = f (cos θ_i)^a
                               w = measure · (cos θ_i cos θ_o)^b

over pairs of directions, m measured and f modelled; φ is log(1 + k y) / k for q = 0 (the transformation of
Box & Cox 1964). All losses are this one formula with other numbers, so many of them are a batch of one fit.
"""

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float


def _as_float(value: ArrayLike) -> Any:
    """Arrays that JAX traces stay; numbers wait as numpy's until somebody knows in which precision."""
    return value if isinstance(value, jax.Array) else np.asarray(value, float)


class Loss(eqx.Module):
    r"""E² as the module says; q, k, a, b are `power`, `gain` (sr), `inner_cosine` and `outer_cosine`.

    The smaller `power` and the larger `gain`, the more the dim directions count beside the mirror peak.
    With a `cutoff` it is robust: r = φ(f) − φ(m) counts as 2c² (√(1 + r²/c²) − 1), like r² below c = cutoff ·
    (the residuals' own spread) and like |r| beyond (Charbonnier et al. 1997); 0 is no cutoff.
    """

    power: Any = eqx.field(converter=_as_float, default=1.0)
    gain: Any = eqx.field(converter=_as_float, default=1.0)
    inner_cosine: Any = eqx.field(converter=_as_float, default=0.0)
    outer_cosine: Any = eqx.field(converter=_as_float, default=1.0)
    cutoff: Any = eqx.field(converter=_as_float, default=0.0)

    def transformed(self, f: Float[Array, "..."], cos_i: Float[Array, "..."]) -> Float[Array, "..."]:
        """φ(f); negative f counts as 0, unless φ is the identity."""
        straight = self.power == 1
        y = f * cos_i**self.inner_cosine
        log = jnp.log1p(self.gain * jnp.where(straight, 0, jnp.maximum(y, 0)))
        power = jnp.where(self.power == 0, 1, self.power)
        compressed = jnp.where(self.power == 0, log, jnp.expm1(power * log) / power) / self.gain
        return jnp.where(straight, y, compressed)

    def slope(self, f: Float[Array, "..."], cos_i: Float[Array, "..."]) -> Float[Array, "..."]:
        """dφ/df at f ≥ 0: (1 + k y)^(q − 1) (cos θ_i)^a."""
        cosine = cos_i**self.inner_cosine
        return (1 + self.gain * f * cosine) ** (self.power - 1) * cosine

    def weight(self, cos_i: Float[Array, "..."], cos_o: Float[Array, "..."]) -> Float[Array, "..."]:
        """w / measure."""
        return (cos_i * cos_o) ** self.outer_cosine

    def robust_residual(self, r: Float[Array, "..."], spread: Float[Array, ""]) -> Float[Array, "..."]:
        """The number whose square the robust loss makes of r², `spread` being that of all r; r itself without
        cutoff. Written as r √(2 / (1 + √(1 + r²/c²))), which is smooth at r = 0."""
        width = self.cutoff * spread
        share = jnp.where(width > 0, r / jnp.where(width > 0, width, 1), 0)
        return r * jnp.sqrt(2 / (1 + jnp.sqrt(1 + share**2)))


LOSSES: Mapping[str, Loss] = MappingProxyType(
    {
        "l2": Loss(),
        "log": Loss(power=0.0, inner_cosine=1.0, outer_cosine=0.0),
        "cube_root": Loss(power=1 / 3, gain=1e6),
        "log_ratio": Loss(power=0.0, gain=1e4),
    }
)
"""The losses by name:

'l2'         (f − m)², weighed by cos θ_i cos θ_o: Ngan et al. 2005
'log'        of log(1 + f cos θ_i): Löw et al. 2012
'cube_root'  of f^⅓, cosine-weighted: Fores et al. 2012 (f + 1e-6/sr, which keeps slopes finite)
'log_ratio'  log(f / m)², cosine-weighted (f + 1e-4/sr: differences below are noise)
"""


def compressed(gain: ArrayLike) -> Loss:
    """'log' of log(1 + k f cos θ_i) / k: from L2 at small `gain` k to relative errors at a large one.

    A family to choose from by the picture that a fit makes, in the manner of Bieron & Peers 2020.
    """
    return dataclasses.replace(LOSSES["log"], gain=gain)


def robust(loss: str | Loss, cutoff: float = 3.0) -> Loss:
    """A loss that outliers hardly move: residuals count in proportion beyond `cutoff` times their spread.

    The spread is 1.48 times the median of |r|, the standard deviation of a normal distribution. Raises
    ValueError unless `cutoff` > 0.
    """
    if not cutoff > 0:
        raise ValueError(f"cutoff must be greater than 0; found {cutoff}")
    return dataclasses.replace(as_loss(loss), cutoff=cutoff)


def as_loss(loss: str | Loss) -> Loss:
    """A loss, or the one of that name. Raises ValueError for an unknown name."""
    if isinstance(loss, Loss):
        return loss
    if loss not in LOSSES:
        raise ValueError(f"unknown loss {loss!r}: expected one of {', '.join(LOSSES)}, or a fitting.Loss")
    return LOSSES[loss]


def spread(r: Float[np.ndarray, "L N"], used: np.ndarray) -> Float[np.ndarray, " L"]:
    """1.48 times the median of |r| where it is used, for each lane; 1 where nothing is."""
    rows = zip(r, used, strict=True)
    return np.array([1.4826 * np.median(np.abs(row[use])) if use.any() else 1.0 for row, use in rows])


def normalised(
    weight: Float[np.ndarray, "L N"], values: Float[np.ndarray, "L N"]
) -> Float[np.ndarray, "L N"]:
    """Weights in proportion, with Σ w v² = 100 in each lane: residuals are then of order one."""
    total = np.sum(weight * values**2, axis=1, keepdims=True)
    return weight * (100 / np.where(total > 0, total, 1))
