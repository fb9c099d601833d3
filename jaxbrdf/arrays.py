"""What an array means here: parameters, their trailing channels, and work done in chunks.

Every formula of the library is written for *scalar* parameters and directions of any leading shape.
`per_channel` makes such a formula serve models whose parameters carry one trailing axis of channels
(RGB, wavelengths); `in_chunks` bounds the memory of formulas that need many nodes a direction.
Batches of models are not made here: they are `jax.vmap` over the model's leaves.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Parameter = Float[Array, "..."]  # () or (C,): one value, or one for each channel


@dataclass(frozen=True)
class Range:
    """Where a fit looks for a parameter: [low, high], evenly or evenly in the logarithm."""

    low: float
    high: float
    log: bool = False


def parameter(rank: int = 0, fitted: Range | None = None) -> Any:
    """A field of a model whose own shape has `rank` axes; one more, at the end, is the channels.

    `fitted` is the range in which a fit may look for the parameter; evaluation is not bound to it.
    """
    return eqx.field(converter=jnp.asarray, metadata={"rank": rank, "fitted": fitted})


def fitted_ranges(model_class: type[eqx.Module]) -> dict[str, Range]:
    """The parameters of a class that a fit may change, by name, with their ranges."""
    fields = dataclasses.fields(model_class)
    return {f.name: f.metadata["fitted"] for f in fields if f.metadata.get("fitted")}


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


def _channel_axes(model: eqx.Module) -> list[int | None]:
    """For each leaf of the model: -1 where it has an axis of channels, None where it has not."""
    paths, _ = jax.tree_util.tree_flatten_with_path(model)
    axes = [_channel_axis(leaf, _rank(model, path), jax.tree_util.keystr(path)) for path, leaf in paths]
    counts = {leaf.shape[-1] for (_, leaf), axis in zip(paths, axes, strict=True) if axis == -1}
    if len(counts) > 1:
        raise ValueError(
            f"the parameters of {type(model).__name__} have different numbers of channels: {sorted(counts)}; "
            "give each parameter no channels or the same number of them"
        )
    return axes


def _channel_axis(leaf: Array | np.ndarray, rank: int, name: str) -> int | None:
    if jnp.ndim(leaf) > rank + 1:
        raise ValueError(
            f"parameter {name} has shape {jnp.shape(leaf)}: at most {rank + 1} axes were expected (the last "
            "one for channels); to evaluate a batch of models, jax.vmap over the model"
        )
    return -1 if jnp.ndim(leaf) == rank + 1 else None


def _rank(model: Any, path: tuple) -> int:
    """The rank that the field at the end of `path` was declared with by `parameter`; 0 if it was not."""
    rank = 0
    for key in path:
        if isinstance(key, jax.tree_util.GetAttrKey):
            rank = type(model).__dataclass_fields__[key.name].metadata.get("rank", 0)
            model = getattr(model, key.name)
        else:
            model = model[key.idx if isinstance(key, jax.tree_util.SequenceKey) else key.key]
    return rank


def in_chunks(function: Callable, *arrays: Array, size: int = 8192) -> Array:
    """`function`, of scalars, at each element of arrays of one shape, at most `size` elements at once."""
    shape = jnp.broadcast_shapes(*(jnp.shape(a) for a in arrays))
    flat = [jnp.broadcast_to(a, shape).reshape(-1) for a in arrays]
    if flat[0].size <= size:
        return jax.vmap(function)(*flat).reshape(shape)
    return jax.lax.map(lambda xs: function(*xs), tuple(flat), batch_size=size).reshape(shape)
