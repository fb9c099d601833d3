"""What an array means here: parameters, their trailing channels, and work done in chunks.

Every formula of the library is written for *scalar* parameters and directions of any leading shape.
`per_channel` makes such a formula serve models whose parameters carry one trailing axis of channels
(RGB, wavelengths); `in_chunks` bounds the memory of formulas that need many nodes a direction.
Batches of models are not made here: they are `jax.vmap` over the model's leaves.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

Parameter = Float[Array, "..."]  # () or (C,): one value, or one for each channel


@dataclass(frozen=True)
class Range:
    """Where a fit looks for a parameter: [low, high], evenly, or evenly in log(parameter − pole)."""

    low: float
    high: float
    log: bool = False
    pole: float = 0.0


@dataclass(frozen=True)
class Simplex:
    """Where a fit looks for K shares, along the first axis of a field of rank 1: s_k ≥ 0 with the sum 1."""


@dataclass(frozen=True)
class Domain:
    """The values for which a formula has a meaning: from low (left out where `open`) to high."""

    low: float = -math.inf
    high: float = math.inf
    open: bool = False

    def __contains__(self, value: Array | np.ndarray) -> bool:
        """Whether all of an array lies inside; NaN, the parameter of a failed fit, is let through."""
        array = np.asarray(value)
        return not np.any((array <= self.low if self.open else array < self.low) | (array > self.high))

    def __str__(self):
        bound = f"{'greater than' if self.open else 'at least'} {self.low:g}"
        return bound if self.high == math.inf else f"{bound} and at most {self.high:g}"


POSITIVE = Domain(0.0, open=True)
NON_NEGATIVE = Domain(0.0)


def parameter(
    rank: int = 0,
    domain: Domain | None = None,
    fitted: Range | Simplex | None = None,
    optional: bool = False,
    default: float | None = None,
    linear: bool = False,
) -> Any:
    """A field of a model whose own shape has `rank` axes; one more, at the end, is the channels.

    A model refuses values outside the `domain` when it is made. `fitted` is the range in which a fit may look
    for the parameter, or `Simplex()` for shares; evaluation is not bound to it. A reflectance is `linear` in
    some parameters: fits look for those from 0 on, without a range. A parameter may be left out if it is
    `optional`, then it is None, or if it has a `default`.
    """
    metadata = {"rank": rank, "domain": domain, "fitted": fitted, "optional": optional, "linear": linear}
    converter = _array_or_none if optional else jnp.asarray
    if optional or default is not None:
        return eqx.field(converter=converter, metadata=metadata, default=default)
    return eqx.field(converter=converter, metadata=metadata)


def _array_or_none(value):
    return None if value is None else jnp.asarray(value)


def floats(a: ArrayLike) -> Float[Array, "..."]:
    """`a` as an array of floating-point numbers, whole numbers too; in its own precision if it has one."""
    array = jnp.asarray(a)
    return array if jnp.issubdtype(array.dtype, jnp.floating) else array.astype(float)


def precision(tree: Any) -> Any:
    """The dtype that a model, or several, computes in: that of its parameters."""
    return jnp.result_type(float, *jax.tree.leaves(tree))


class Parametric(eqx.Module):
    """A pytree of parameters; what `parameter` declares of them is checked when it is made, outside jit."""

    def __check_init__(self):
        for field in dataclasses.fields(self):
            domain, value = field.metadata.get("domain"), getattr(self, field.name)
            if domain is None or value is None or isinstance(value, jax.core.Tracer):
                continue
            if value not in domain:
                raise ValueError(
                    f"{type(self).__name__}: {field.name} must be {domain}; found {np.array2string(value)}"
                )


def fitted_ranges(model_class: type[eqx.Module]) -> dict[str, Range]:
    """The parameters of a class that have a range for fits, by name; no optional ones, and no shares."""
    fields = [f for f in dataclasses.fields(model_class) if not f.metadata.get("optional")]
    return {f.name: f.metadata["fitted"] for f in fields if isinstance(f.metadata.get("fitted"), Range)}


def per_channel(method: Callable) -> Callable:
    """Let a method written for one channel serve a model of C channels: (...) becomes (..., C).

    Any parameter of the model, or of a model inside it, may have a trailing axis of length C; the
    others are shared by all channels. A model without channels passes straight through.
    Raises ValueError where two parameters have different numbers of channels.
    """

    @wraps(method)
    def mapped(self, *args):
        leaves, treedef = jax.tree.flatten(self)
        axes = _channel_axes(self)
        if all(axis is None for axis in axes):
            return method(self, *args)

        def one_channel(leaves, *args):
            return method(treedef.unflatten(leaves), *args)

        in_axes = (axes, *(None for _ in args))
        return jax.vmap(one_channel, in_axes=in_axes, out_axes=-1)(leaves, *args)

    return mapped


def channel_count(model: Any) -> int | None:
    """The number of channels that a model's parameters carry, or None. Raises ValueError as `per_channel`."""
    axes = _channel_axes(model)
    counts = [leaf.shape[-1] for leaf, axis in zip(jax.tree.leaves(model), axes, strict=True) if axis == -1]
    return counts[0] if counts else None


def _channel_axes(model: Any) -> list[int | None]:
    """For each leaf of the model: -1 where it has an axis of channels, None where it has not."""
    paths, _ = jax.tree_util.tree_flatten_with_path(model)
    axes = [
        _channel_axis(leaf, declared(model, path).get("rank", 0), jax.tree_util.keystr(path))
        for path, leaf in paths
    ]
    counts = {leaf.shape[-1] for (_, leaf), axis in zip(paths, axes, strict=True) if axis == -1}
    if len(counts) > 1:
        raise ValueError(
            f"the model's parameters have different numbers of channels: {sorted(counts)}; "
            "give each parameter no channels or the same number of them"
        )
    return axes


def parameter_ranks(model: Any) -> list[int]:
    """The rank, without channels, that each leaf of a model was declared with."""
    paths = jax.tree_util.tree_flatten_with_path(model)[0]
    return [declared(model, path).get("rank", 0) for path, _ in paths]


def _channel_axis(leaf: Array | np.ndarray, rank: int, name: str) -> int | None:
    if jnp.ndim(leaf) > rank + 1:
        raise ValueError(
            f"parameter {name} has shape {jnp.shape(leaf)}: at most {rank + 1} axes were expected (the last "
            "one for channels); to evaluate a batch of models, jax.vmap over the model"
        )
    return -1 if jnp.ndim(leaf) == rank + 1 else None


def declared(model: Any, path: tuple) -> Mapping[str, Any]:
    """What `parameter` declared of the field that a leaf's `path` ends in; nothing if it was not used."""
    metadata: Mapping[str, Any] = {}
    for key in path:
        if isinstance(key, jax.tree_util.GetAttrKey):
            metadata = type(model).__dataclass_fields__[key.name].metadata
            model = getattr(model, key.name)
        else:
            model = model[key.idx if isinstance(key, jax.tree_util.SequenceKey) else key.key]
    return metadata


def in_chunks(function: Callable, *arrays: Array, size: int = 8192) -> Array:
    """`function`, of scalars, at each element of arrays, which broadcast; at most `size` elements at once.

    Axes of its own results come last.
    """
    shape = jnp.broadcast_shapes(*(jnp.shape(a) for a in arrays))
    flat = [jnp.broadcast_to(a, shape).reshape(-1) for a in arrays]
    if flat[0].size <= size:
        each = jax.vmap(function)(*flat)
    else:
        each = jax.lax.map(lambda xs: function(*xs), tuple(flat), batch_size=size)
    return each.reshape(shape + each.shape[1:])
