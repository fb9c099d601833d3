"""The picture of one reflectance: two slices, the image slice over θ_h and θ_d, and lobes."""

from collections.abc import Sequence

import numpy as np
from jax.typing import ArrayLike
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from data_loaders import to_rgb
from jaxbrdf import MeasuredSamples, from_half_difference, spherical
from jaxbrdf.cli import pictures, sources
from jaxbrdf.resampling import Reflectance, evaluate

_INCIDENCES = (10.0, 30.0, 50.0, 70.0)  # degrees, of the lobes, unless a few others were measured
_ROWS = 180  # of the image slice
_MOST = 8  # channels drawn as they are; of more, their colours
_NEAR = 0.05  # from the plane of incidence or from a slice: samples within are drawn as dots


def draw(reflectance: Reflectance, name: str) -> Figure:
    """The picture. Between samples lines are interpolated, and end where those reach no farther."""
    coloured = to_rgb(reflectance) if sources.wavelengths(reflectance) is not None else reflectance
    reflectance = coloured if len(sources.channels(reflectance)) > _MOST else reflectance
    figure = Figure(figsize=(11, 6.8), dpi=110, layout="constrained")
    upper, lower = pictures.two_rows(figure)
    slices = upper.subplots(1, 3)
    styles = [pictures.style(channel) for channel in sources.channels(reflectance)]
    _draw_slices(list(slices[:2]), reflectance, styles)
    _draw_image(slices[2], coloured)
    incidences = _incidences(reflectance)
    lobes = np.atleast_1d(lower.subplots(1, len(incidences)))
    for ax, incidence in zip(lobes, incidences, strict=True):
        _draw_lobe(ax, reflectance, styles, incidence)
    lower.suptitle("lobes in the plane of incidence: radius $f^{1/3}$, dashed towards the light", fontsize=10)
    names = [channel for channel in sources.channels(reflectance) if channel]
    if names:
        handles = [Line2D([], [], color=c, label=n) for (c, _), n in zip(styles, names, strict=True)]
        upper.legend(handles=handles, loc="outside upper center", ncols=9, frameon=False)
    figure.suptitle(f"{pictures.plain(name)}: {sources.kind(reflectance)}", fontsize=12)
    return figure


def _draw_slices(axes: Sequence[Axes], reflectance: Reflectance, styles: Sequence[tuple]) -> None:
    """f along the backscattering slice, θ_d = 0, and the mirror slice, θ_h = 0."""
    half = np.pi / 2
    theta_d = half * np.linspace(0, 1, 400, endpoint=False)
    theta_h = theta_d**2 / half
    pictures.dress_slices(axes)
    for ax, angle, pairs in (
        (axes[0], theta_h, from_half_difference(theta_h, 0.0, 0.0, half)),
        (axes[1], theta_d, from_half_difference(0.0, 0.0, theta_d, half)),
    ):
        f = _values(reflectance, *pairs)
        for values, (colour, _) in zip(f.T, styles, strict=True):
            ax.plot(np.rad2deg(angle), values, color=colour, linewidth=1.4)
        pictures.set_range(ax, f[angle < pictures.GRAZING])


def _draw_image(ax: Axes, reflectance: Reflectance) -> None:
    """∛f as a colour over √θ_h and θ_d at φ_d = 90°, where both directions are equally steep."""
    side = (np.arange(_ROWS) + 0.5) / _ROWS
    theta_h, theta_d = np.meshgrid(np.pi / 2 * side**2, np.pi / 2 * side)
    f = _values(reflectance, *from_half_difference(theta_h, 0.0, theta_d, np.pi / 2))
    known = np.isfinite(f).all(axis=-1)
    shade = np.cbrt(np.where(known[..., None], np.maximum(f, 0), 0))
    shade = shade / (np.quantile(shade[known], 0.98) if known.any() else 1)
    colours = np.broadcast_to(shade[..., [0, shade.shape[-1] // 2, -1]], (*known.shape, 3))
    ax.imshow(
        np.where(known[..., None], np.clip(colours, 0, 1), 0.85),
        origin="lower",
        extent=(0, 1, 0, 90),
        aspect="auto",
    )
    ticks = np.array([0, 1, 5, 15, 30, 60, 90])
    ax.set_xticks(np.sqrt(ticks / 90), map(str, ticks))
    ax.set(xlabel="$\\theta_h$ (degrees), at $\\phi_d = 90°$", ylabel="$\\theta_d$ (degrees)")
    ax.set_title("image slice: $f^{1/3}$, grey where unknown", fontsize=9)


def _incidences(reflectance: Reflectance) -> Sequence[float]:
    """Those of the lobes, degrees: of samples, four or fewer of those that were measured."""
    if not isinstance(reflectance, MeasuredSamples):
        return _INCIDENCES
    measured, count = np.unique(np.round(np.rad2deg(reflectance.theta_i), 1), return_counts=True)
    often = measured[count >= 0.2 * count.max()]
    return often[np.unique(np.linspace(0, len(often) - 1, 4).round().astype(int))].tolist()


def _draw_lobe(ax: Axes, reflectance: Reflectance, styles: Sequence[tuple], incidence: float) -> None:
    theta = np.arange(-89.75, 90.0, 0.25)
    wi, wo = spherical(np.radians(incidence), np.pi), spherical(np.radians(theta), 0.0)
    radii = np.cbrt(np.maximum(_values(reflectance, wi, wo), 0))
    points, at = _in_plane(reflectance, incidence)
    for c, (colour, marker) in enumerate(styles):
        ax.plot(*pictures.polar(radii[:, c], theta), color=colour, linewidth=1.1)
        ax.plot(*pictures.polar(points[:, c], at), marker, color=colour, markersize=2.6, alpha=0.45, mew=0)
    pictures.dress_lobe(ax, incidence, pictures.largest(radii, points))


def _in_plane(reflectance: Reflectance, incidence: float) -> tuple[np.ndarray, np.ndarray]:
    """∛f (n, C) of the samples themselves near the plane of incidence, and their angles, degrees."""
    if not isinstance(reflectance, MeasuredSamples):
        return np.empty((0, len(sources.channels(reflectance)))), np.empty(0)
    turn = reflectance.phi_o - reflectance.phi_i
    side = np.sin(reflectance.theta_o) * np.sin(turn)
    near = (np.abs(side) < _NEAR) & (np.abs(np.rad2deg(reflectance.theta_i) - incidence) < 0.1)
    near &= reflectance.valid.all(axis=1)
    theta = np.rad2deg(reflectance.theta_o) * np.where(np.cos(turn) < 0, 1, -1)
    return np.cbrt(reflectance.values[near]), theta[near]


def _values(reflectance: Reflectance, wi: ArrayLike, wo: ArrayLike) -> np.ndarray:
    """f of broadcast directions, (..., C); NaN where it is unknown or infinite."""
    wi, wo = np.broadcast_arrays(np.asarray(wi), np.asarray(wo))
    f = evaluate(reflectance, wi.reshape(-1, 3), wo.reshape(-1, 3))
    return np.where(np.isfinite(f), f, np.nan).reshape(*wi.shape[:-1], -1)
