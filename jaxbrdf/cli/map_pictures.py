"""Pictures of maps of ellipsoids: some patches' distributions, images of parameters, and the surface lit."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, PowerNorm
from matplotlib.figure import Figure

from jaxbrdf import Constant, Ellipsoid, Microfacet, NDFMap, PatchNDFs, SpatiallyVaryingBRDF, Uncorrelated
from jaxbrdf.directions import Direction, reflect
from jaxbrdf.ndf.tabulated import disk_cells

_SHOWN = 8  # patches whose distributions are drawn
_LEVELS = (0.1, 0.5)  # of the highest D of a fit, at which lines are drawn
_DRAWN = 512  # texels of a texture that are drawn along each side
_NARROW = 6  # a map longer than so many times its width is drawn wider than it is


def patches(tables: PatchNDFs, item: NDFMap, name: str, error: np.ndarray) -> Figure:
    """Distributions of some patches with what was fitted to them, images of parameters and of an error."""
    figure = Figure(figsize=(16, 6.4), dpi=110, layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1, 1.25), squeeze=False)[:, 0]
    _draw_distributions(above, tables, item)
    axes = below.subplots(1, 6)
    scales = [_scale(name, [item]) for name in item.names]
    for ax, name, scale in zip(axes, item.names, scales, strict=False):
        _draw_image(ax, item, _in_degrees(name, item), scale, _label(name))
    shown = np.where(item.success, error, np.nan)
    _draw_image(axes[5], item, shown, Normalize(0, _high(shown)), f"{name} of the fit")
    figure.suptitle(f"{item.name}: {item.success.sum()} of {item.success.size} patches of {_size(item.size)}")
    return figure


def texture(exemplar: NDFMap, synthesised: NDFMap) -> Figure:
    """The parameters of both, and both lit from where differences are largest, seen from above."""
    figure = Figure(figsize=(17, 6.2), dpi=110, layout="constrained")
    rows = figure.subplots(2, 6)
    shown = _corner(synthesised)
    scales = [_scale(name, [exemplar, shown]) for name in exemplar.names]
    light = _light(exemplar)
    pictures = [_lit(item, light) for item in (exemplar, shown)]
    for axes, item, picture, title in zip(
        rows, (exemplar, shown), pictures, ("exemplar", "texture"), strict=True
    ):
        for ax, name, scale in zip(axes, item.names, scales, strict=False):
            _draw_image(ax, item, _in_degrees(name, item), scale, _label(name))
        high = np.nanpercentile(pictures[0], 99.5)
        _draw_image(axes[5], item, picture, Normalize(0, high), "lit", cmap="gray")
        axes[0].set_ylabel(f"{title}, {_size(_extent(item))}")
    return figure


def _draw_distributions(figure, tables: PatchNDFs, item: NDFMap) -> None:
    """As figure 11 of Dong et al. 2015: D of patches evenly spread over the map, and lines of the fits."""
    fitted = np.flatnonzero(item.success)
    chosen = fitted[np.linspace(0, len(fitted) - 1, min(_SHOWN, len(fitted))).round().astype(int)]
    x, y = tables.tables.extent
    m = jnp.asarray(np.moveaxis(disk_cells(tables.values.shape[-1], tables.tables.extent), 0, -1))
    for ax, k in zip(np.atleast_1d(figure.subplots(1, _SHOWN)), [*chosen, *[None] * _SHOWN], strict=False):
        if k is None:
            ax.axis("off")
            continue
        values = np.asarray(tables.values[k])
        ax.imshow(
            values, origin="lower", extent=(-x, x, -y, y), cmap="inferno", norm=PowerNorm(0.4), aspect="auto"
        )
        fit = np.asarray(jax.tree.map(lambda leaf, k=k: leaf.ravel()[k], item.ndf)._density(m))
        ax.contour(
            m[..., 0], m[..., 1], fit, [fit.max() * level for level in _LEVELS], colors="w", linewidths=0.8
        )
        i, j = np.unravel_index(k, item.shape)
        ax.set_title(f"row {i}, column {j}", fontsize=8)
        ax.tick_params(labelsize=7)
    figure.supylabel("m_y")
    figure.supxlabel("m_x")


def _draw_image(
    ax: Axes, item: NDFMap, image: np.ndarray, norm: Normalize, label: str, cmap: str = "viridis"
) -> None:
    width, height = _extent(item)
    aspect: Literal["equal", "auto"] = "equal" if 1 / _NARROW < width / height < _NARROW else "auto"
    extent = (0, width, 0, height)
    drawn = ax.imshow(
        image, origin="lower", extent=extent, cmap=cmap, norm=norm, aspect=aspect, interpolation="nearest"
    )
    ax.set_title(label, fontsize=9)
    ax.tick_params(labelsize=7)
    ticks = np.asarray(norm.inverse(np.linspace(0, 1, 5)))
    bar = ax.figure.colorbar(drawn, ax=ax, shrink=0.8, ticks=ticks, format="{x:.3g}")
    bar.minorticks_off()
    bar.ax.tick_params(labelsize=7)


def _in_degrees(name: str, item: NDFMap) -> np.ndarray:
    image = np.where(item.success, np.asarray(getattr(item.ndf, name)), np.nan)
    return np.rad2deg(image) if name.startswith("theta") else image


def _scale(name: str, items: Sequence[NDFMap]) -> Normalize:
    """What most of the values lie in."""
    values = np.concatenate([_in_degrees(name, item).ravel() for item in items])
    low, high = np.nanpercentile(values, (1, 99))
    if name.startswith("theta"):
        return Normalize(low, high + 1e-9)
    return LogNorm(low, high * (1 + 1e-9))


def _label(name: str) -> str:
    return f"{name}, °" if name.startswith("theta") else name


def _high(image: np.ndarray) -> float:
    return float(np.nanpercentile(image, 99)) if np.isfinite(image).any() else 1.0


def _extent(item: NDFMap) -> tuple[float, float]:
    """(width, height) in µm."""
    return item.shape[1] * item.step[0], item.shape[0] * item.step[1]


def _size(lengths: tuple[float, float]) -> str:
    return " × ".join(f"{length:.4g}" for length in lengths) + " µm"


def _corner(item: NDFMap) -> NDFMap:
    """What is drawn of a large texture."""
    return NDFMap(jax.tree.map(lambda leaf: leaf[:_DRAWN, :_DRAWN], item.ndf), item.step)


# Light


def _light(item: NDFMap) -> Direction:
    """From where light is reflected upwards by normals as far from the mean as the roughness across, where
    parameters make large differences."""
    ok = jnp.asarray(item.success.ravel())
    flat = jax.tree.map(lambda leaf: jnp.ravel(leaf)[ok], item.ndf)
    mean, G = (jnp.mean(part, axis=0) for part in jax.vmap(Ellipsoid.slope_form)(flat))
    squares, axes = np.linalg.eigh(np.asarray(G))
    x, y = np.asarray(mean) + np.sqrt(squares[0]) * axes[:, 0]
    m = np.array([x, y, 1.0]) / np.sqrt(1 + x * x + y * y)
    return reflect(jnp.array([0.0, 0.0, 1.0]), jnp.asarray(m))


@eqx.filter_jit
def _reflected(item: NDFMap, light: Direction):
    height, width = item.shape
    u, v = (jnp.arange(width) + 0.5) / width, (jnp.arange(height) + 0.5) / height
    surface = SpatiallyVaryingBRDF(Microfacet(item.ndf, Constant(jnp.array(1.0)), Uncorrelated()))
    return surface(u[None, :], v[:, None], light, jnp.array([0.0, 0.0, 1.0])) * light[2]


def _lit(item: NDFMap, light: Direction) -> np.ndarray:
    """Radiance under light of irradiance 1 / cos from one direction, texel by texel."""
    return np.where(item.success, np.asarray(_reflected(item, light)), np.nan)
