r"""From the numbers that a solver moves to any sum of reflectances, whatever their parameters are.

    f = f_0(u) + Σ_j x_j φ_j(u)

x_j ≥ 0 are the parameters declared linear, u in [0, 1]ⁿ the shares of their ranges at which the others lie.
Shares s_1 … s_K of a whole are K − 1 of these, each the part that one takes of what those before it left:

    s_k = u_k (1 − u_1) ⋯ (1 − u_{k−1}),   k < K;   s_K = 1 − s_1 − … − s_{K−1}

A term of the sum with such a shape is a *lobe*; the rest (diffuse, fixed) is the base. Unknowns stand in the
order base, first lobe, second lobe, …, so that those of a sum of fewer lobes come first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fitting.masking import log_areas, looked_up
from fitting.parameters import ShapeSpace, share_of, value_at
from jaxbrdf.arrays import Parametric, Range, Simplex, declared, fitted_ranges
from jaxbrdf.brdf.base import AbstractBRDF, Scaled, Sum
from jaxbrdf.directions import Direction
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.special import safe_divide


@dataclass(frozen=True)
class Unknown:
    """A parameter that a fit seeks: which leaf of the model it is, its name, and the term it stands in."""

    leaf: int
    name: str
    term: int


@dataclass(frozen=True)
class Shape(Unknown):
    """One in which the reflectance is not linear, and its range; of several shares, which one it is."""

    range: Range
    part: int | None = None

    def place(self, leaf: Array) -> Array:
        """The u at which the value of its leaf lies."""
        if self.part is None:
            return share_of(self.range, leaf)
        return safe_divide(leaf[self.part], jnp.sum(leaf[self.part :], axis=0))


class ModelSpace(eqx.Module):
    """The unknowns of a model, and how its reflectance follows from them; made by `model_space`.

    A distribution alone has unknowns in the same way: it is its own and only lobe.
    """

    prototype: Parametric  # one channel of it; unknowns and `own` leaves stand in for by anything
    areas: dict[str, Array]  # log σ of families of distributions without a closed form, by class
    shapes: tuple[Shape, ...] = eqx.field(static=True)
    linear: tuple[Unknown, ...] = eqx.field(static=True)
    own: tuple[int, ...] = eqx.field(static=True)  # fixed leaves that differ from channel to channel
    lobes: tuple[int, ...] = eqx.field(static=True)  # the terms that are lobes

    @property
    def names(self) -> tuple[str, ...]:
        """All unknowns: linear ones first."""
        return tuple(unknown.name for unknown in (*self.linear, *self.shapes))

    @property
    def leaves_of_shares(self) -> set[int]:
        return {shape.leaf for shape in self.shapes if shape.part is not None}

    def first_lobes(self, count: int) -> "ModelSpace":
        """The space of the base and the first lobes; the terms of the others are left out."""
        left_out = self.lobes[count:]
        return replace(
            self,
            shapes=tuple(shape for shape in self.shapes if shape.term not in left_out),
            linear=tuple(unknown for unknown in self.linear if unknown.term not in left_out),
        )

    def model(self, u: Float[Array, " n"], x: Float[Array, " k"], own: Sequence[Array]) -> Any:
        """The reflectance of one channel, all its terms."""
        leaves, structure = jax.tree.flatten(self.prototype)
        for leaf, value in zip(self.own, own, strict=True):
            leaves[leaf] = value
        numbers = jnp.concatenate([x, self.shape_values(u)])
        return self.fitted(jax.tree.unflatten(structure, leaves), numbers)

    def shape_values(self, u: Float[Array, " n"]) -> Float[Array, " n"]:
        """The parameters at u."""
        values = []
        left: dict[int, Any] = {}  # of the whole that a leaf of shares divides; others take all of their own
        for k, shape in enumerate(self.shapes):
            rest = left.get(shape.leaf, 1)
            values.append(rest * value_at(shape.range, u[k]))
            left[shape.leaf] = rest - values[-1]
        return jnp.stack(values) if values else u

    def shares_of(self, model: Parametric) -> Float[np.ndarray, " n"]:
        """The u of another model of the same structure."""
        leaves = jax.tree.leaves(model)
        return np.array([float(shape.place(leaves[shape.leaf])) for shape in self.shapes])

    def by_parameters(
        self, by_u: Float[Array, "N n"], u: Float[Array, " n"], pinned: Bool[Array, " n"]
    ) -> Float[Array, "N n"]:
        """Derivatives by the parameters from those by u, of which the `pinned` stay; 0 for these.

        d parameter / du is diagonal but for shares, and triangular for these, none of which depends on the u
        after its own. A u that takes its part of nothing stays too.
        """
        slopes = jax.jacfwd(self.shape_values)(u)
        own = jnp.where(pinned, 0, jnp.diagonal(slopes))
        if not self.leaves_of_shares:
            return by_u * safe_divide(1.0, own)[None, :]
        free = own != 0
        both = free[:, None] & free[None, :]
        inverse = jnp.linalg.inv(jnp.where(both, slopes, jnp.eye(len(u), dtype=u.dtype)))
        return by_u @ jnp.where(both, inverse, 0)

    def fitted(self, model: Parametric, numbers: Float[Array, "*channels n"]) -> Any:
        """The model with the unknowns replaced by numbers, in the order of `names`."""
        leaves, structure = jax.tree.flatten(model)
        for k, unknown in enumerate((*self.linear, *self.shapes)):
            leaves[unknown.leaf] = numbers[..., k]
        for leaf in self.leaves_of_shares:
            own = [k for k, unknown in enumerate(self.shapes, len(self.linear)) if unknown.leaf == leaf]
            leaves[leaf] = _with_rest(jnp.stack([numbers[..., k] for k in own]))
        return jax.tree.unflatten(structure, leaves)

    def fitted_each(self, model: Parametric, numbers: Float[Array, "B *channels n"]) -> Any:
        """The same of each of many: leaves (B, …)."""
        return jax.vmap(self.fitted, (None, 0))(model, numbers)

    def parts(self, u, own, wi: Direction, wo: Direction, terms: Sequence[int]):
        """f_0 (N,) and the φ of those linear unknowns that stand in some terms of the sum, (k, N)."""

        def reflectance(term, x):
            brdf = terms_of(self.model(u, jnp.asarray(x), own))[term]
            return self._quick(brdf)._reflectance(wi, wo)

        off = {term: reflectance(term, np.zeros(len(self.linear))) for term in terms}
        basis = np.eye(len(self.linear))
        each = [
            reflectance(unknown.term, basis[k]) - off[unknown.term]
            for k, unknown in enumerate(self.linear)
            if unknown.term in terms
        ]
        count = wi.shape[0]
        total = reduce(add, off.values(), jnp.zeros(count))
        return total, jnp.stack(each) if each else jnp.zeros((0, count))

    def features(self, u, own, wi: Direction, wo: Direction):
        """f_0 (N,) and φ (k, N) of the base and of the lobes that are not left out."""
        present = {unknown.term for unknown in (*self.shapes, *self.linear)}
        count = len(terms_of(self.prototype))
        return self.parts(u, own, wi, wo, [i for i in range(count) if i not in self.lobes or i in present])

    def _quick(self, brdf: Any) -> Any:
        """The same reflectance with every integrated projected area looked up."""

        def look_up(node):
            area = self.areas.get(type(node).__name__)
            return node if area is None else looked_up(node, area)

        return jax.tree.map(look_up, brdf, is_leaf=_is_ndf)


def model_space(model: Parametric, fixed: Sequence[str] = ()) -> tuple[ModelSpace, np.ndarray, list]:
    """The space around a model; where the model itself lies in it, u (C, n); and its `own` leaves (C, …).

    C is the number of channels of the model's parameters, or 1. `fixed` names parameters that keep their
    values; "eta" stands for every parameter of that name. Within a multiple only the factor is linear.
    Raises ValueError for a name that fits none, and for a model without unknowns.
    """
    paths, structure = jax.tree_util.tree_flatten_with_path(model)
    leaves = [jnp.asarray(leaf) for _, leaf in paths]
    ranks = [declared(model, path).get("rank", 0) for path, _ in paths]
    unknowns = _unknowns(model, paths, fixed)
    shapes = tuple(unknown for unknown in unknowns if isinstance(unknown, Shape))
    linear = tuple(unknown for unknown in unknowns if not isinstance(unknown, Shape))
    with_channels = {i for i, (leaf, rank) in enumerate(zip(leaves, ranks, strict=True)) if leaf.ndim > rank}
    own = tuple(sorted(with_channels - {unknown.leaf for unknown in unknowns}))
    one_channel = [leaf[..., 0] if i in with_channels else leaf for i, leaf in enumerate(leaves)]
    prototype = jax.tree.unflatten(structure, one_channel)
    lobes = tuple(sorted({shape.term for shape in shapes}))
    space = ModelSpace(prototype, _areas(prototype, lobes), shapes, linear, own, lobes)
    starts = [np.atleast_1d(shape.place(leaves[shape.leaf])) for shape in shapes]
    u = np.stack(np.broadcast_arrays(*starts), axis=-1) if starts else np.zeros((1, 0))
    return space, u, [np.moveaxis(np.asarray(leaves[i]), -1, 0) for i in own]


def _unknowns(model: Parametric, paths: Sequence[tuple[tuple, Any]], fixed: Sequence[str]) -> list[Unknown]:
    """What a fit seeks of all leaves, given with their paths: the base's first, then lobe by lobe."""
    names = [jax.tree_util.keystr(path).lstrip(".") for path, _ in paths]
    terms = [i for i, term in enumerate(terms_of(model)) for _ in jax.tree.leaves(term)]
    held = _held(names, fixed)
    unknowns: list[Unknown] = []
    for leaf, ((path, value), name, term) in enumerate(zip(paths, names, terms, strict=True)):
        data = declared(model, path)
        if name not in held and data.get("fitted"):
            unknowns += _shapes(Unknown(leaf, name, term), data["fitted"], value)
        elif name not in held and data.get("linear") and not _scaled(model, path):
            unknowns.append(Unknown(leaf, name, term))
    if not unknowns:
        raise ValueError(f"nothing to fit: no free parameter in this {type(model).__name__}")
    lobes = {unknown.term for unknown in unknowns if isinstance(unknown, Shape)}
    return sorted(unknowns, key=lambda unknown: (unknown.term in lobes, unknown.term))


def _shapes(unknown: Unknown, fitted: Range | Simplex, value: Array | np.ndarray) -> list[Shape]:
    """The unknowns of one leaf: one, or all shares but the last."""
    leaf, name, term = unknown.leaf, unknown.name, unknown.term
    if isinstance(fitted, Range):
        return [Shape(leaf, name, term, fitted)]
    return [Shape(leaf, f"{name}[{k}]", term, Range(0.0, 1.0), k) for k in range(len(value) - 1)]


def _with_rest(shares: Float[Array, "k *channels"]) -> Float[Array, "K *channels"]:
    """All shares of a whole, from all but the last."""
    rest = 1 - jnp.sum(shares, axis=0, keepdims=True)
    below = jax.lax.stop_gradient(jnp.minimum(rest, 0))  # by rounding, which is to have no derivative
    return jnp.concatenate([shares, rest - below])


def terms_of(model: Parametric) -> list[Parametric]:
    """What is summed, sums within sums resolved; the leaves of all terms in a row are those of the model."""
    if isinstance(model, Sum):
        return [term for part in model.terms for term in terms_of(part)]
    return [model]


def _held(names: Sequence[str], fixed: Sequence[str]) -> set[str]:
    """The parameters that `fixed` names."""
    held = {wanted: [n for n in names if n == wanted or n.endswith("." + wanted)] for wanted in fixed}
    for wanted, found in held.items():
        if not found:
            raise ValueError(f"fixed names no parameter: {wanted!r}; the model has {', '.join(names)}")
    return {name for found in held.values() for name in found}


def _scaled(model: Any, path: tuple) -> bool:
    """Whether a leaf stands within a multiple."""
    for key in path:
        if isinstance(model, Scaled) and key.name == "brdf":
            return True
        by_name = isinstance(key, jax.tree_util.GetAttrKey)
        model = getattr(model, key.name) if by_name else model[key.idx]
    return False


def _areas(model: Parametric, lobes: Sequence[int]) -> dict[str, Array]:
    """log σ of the families of isotropic distributions in the lobes of a reflectance whose σ has no closed
    form."""
    if not isinstance(model, AbstractBRDF):
        return {}
    nodes = [node for i in lobes for node in jax.tree.leaves(terms_of(model)[i], is_leaf=_is_ndf)]
    return {
        type(node).__name__: jnp.asarray(log_areas(ShapeSpace(type(node))))
        for node in nodes
        if _is_ndf(node) and not node.closed_form_area and node.is_isotropic and _is_family(type(node))
    }


def _is_ndf(node: Any) -> bool:
    return isinstance(node, AbstractNDF)


def _is_family(ndf_class: type[AbstractNDF]) -> bool:
    return 1 <= len(fitted_ranges(ndf_class)) <= 2
