"""Pictures of fits: arrays and models in, a matplotlib figure out; saving it is the caller's business."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Wedge

from jaxbrdf import AbstractBRDF, MeasuredBRDF, from_half_difference, spherical
from jaxbrdf.cli import sources
from jaxbrdf.cli.report import printable
from jaxbrdf.directions import Direction

# Okabe & Ito 2008, "Color universal design": told apart with any colour vision, and by the marker too.
_STYLES = {"R": ("#D55E00", "o"), "G": ("#009E73", "s"), "B": ("#0072B2", "^")}
_OTHER = ("#444444", "o")
_BANDS = ((490, "B"), (585, "G"), (800, "R"))  # nm: up to where a wavelength is drawn as which

_INCIDENCES = (10.0, 30.0, 50.0, 70.0)  # degrees, the lobes of Bagher et al. 2012, Fig. 9
_UNUSED = 70  # degrees: the slice beyond this θ_d is not fitted (Bagher et al. 2012, section 5.2)
GRAZING = np.radians(80)  # what is measured beyond may be anything, and does not set the scale


def material(
    measured: MeasuredBRDF, model: AbstractBRDF, name: str, errors: Sequence[float], note: str = ""
) -> Figure:
    """Both slices and four lobes of one material, measured against fitted.

    `errors` is the normalized L2 of each channel; `note` stands small below the picture.
    """
    channels = sources.channels(measured)
    figure = Figure(figsize=(10, 6.6), dpi=110, layout="constrained")
    slices, lobes = two_rows(figure)
    _draw_slices(list(slices.subplots(1, 2)), measured, model, channels)
    _draw_lobes(list(lobes.subplots(1, len(_INCIDENCES))), measured, model, channels)
    slices.legend(handles=_legend(channels), loc="outside upper center", ncols=9, frameon=False)
    lobes.suptitle("lobes in the plane of incidence: radius $f^{1/3}$, dashed towards the light", fontsize=10)
    figure.suptitle(_title(name, channels, errors), fontsize=12)
    if note:
        figure.supxlabel(plain(note), fontsize=9, style="italic", color="0.3")
    return figure


def two_rows(figure: Figure) -> tuple[SubFigure, SubFigure]:
    upper, lower = cast(np.ndarray, figure.subfigures(2, 1, height_ratios=(2.1, 1)))
    return upper, lower


def _title(name: str, channels: Sequence[str], errors: Sequence[float]) -> str:
    numbers = "   ".join(f"{c} {error:.3g}".strip() for c, error in zip(channels, errors, strict=True))
    return f"{plain(name)}      normalized L2:  {numbers}"


def style(channel: str) -> tuple[str, str]:
    """The colour and the marker of a channel, R, G, B or a wavelength."""
    if channel.endswith(" nm"):
        channel = next((band for end, band in _BANDS if float(channel[:-3]) < end), "")
    return _STYLES.get(channel, _OTHER)


def plain(text: str) -> str:
    """A text as it stands: matplotlib would take what is between two dollar signs for a formula."""
    return printable(text).replace("$", r"\$")


def _draw_slices(
    axes: Sequence[Axes], measured: MeasuredBRDF, model: AbstractBRDF, channels: Sequence[str]
) -> None:
    table, half = measured.slices(), np.pi / 2
    theta_d = np.linspace(0, half, 400, endpoint=False)
    theta_h = theta_d**2 / half
    f_h = _evaluate(model, *from_half_difference(theta_h, 0.0, 0.0, half))
    f_d = _evaluate(model, *from_half_difference(table.theta_h_mirror, 0.0, theta_d, half))
    _draw_slice(axes[0], (table.theta_h, table.m_h), (theta_h, f_h), channels)
    _draw_slice(axes[1], (table.theta_d, table.m_d), (theta_d, f_d), channels)
    dress_slices(axes)
    axes[1].axvspan(_UNUSED, 90, color="0.9", zorder=0)
    axes[1].text(80, 0.03, "slice unused", transform=axes[1].get_xaxis_transform(), ha="center", color="0.4")


def dress_slices(axes: Sequence[Axes]) -> None:
    """The scales and names of the backscattering and the mirror slice."""
    axes[0].set_xscale("function", functions=(_root, np.square))
    axes[0].set_xticks([0, 1, 5, 10, 20, 30, 45, 60, 90])
    axes[0].set(xlim=(0, 90), xlabel=r"half angle $\theta_h$ (degrees), at $\theta_d = 0$", ylabel="f (1/sr)")
    axes[1].set(xlim=(0, 90), xlabel=r"difference angle $\theta_d$ (degrees), at $\theta_h = 0$")


def set_range(ax: Axes, values: np.ndarray) -> None:
    """A logarithmic axis of f that holds the positive values."""
    positive = values[values > 0]
    if positive.size:
        ax.set(yscale="log", ylim=(positive.min() / 1.6, positive.max() * 1.6))
    ax.grid(color="0.92", linewidth=0.6)


def _root(theta: np.ndarray) -> np.ndarray:
    """The scale on which MERL's θ_h cells are evenly spaced."""
    return np.sqrt(np.maximum(theta, 0))


def _draw_slice(ax: Axes, points: tuple, line: tuple, channels: Sequence[str]) -> None:
    """One slice: (angles, values) measured and fitted; the axis holds all that was measured below 80°."""
    for c, channel in enumerate(channels):
        colour, marker = style(channel)
        ax.plot(
            np.rad2deg(points[0]), points[1][:, c], marker, color=colour, markersize=3.5, alpha=0.45, mew=0
        )
        ax.plot(np.rad2deg(line[0]), line[1][:, c % line[1].shape[1]], color=colour, linewidth=1.6)
    set_range(ax, points[1][points[0] < GRAZING])


def _legend(channels: Sequence[str]) -> list[Line2D]:
    styles = [(channel, *style(channel)) for channel in channels if channel]
    by_channel = [Line2D([], [], color=colour, marker=m, markersize=5, label=c) for c, colour, m in styles]
    points = Line2D([], [], color="0.4", marker="o", markersize=4, linestyle="", label="measured")
    return [*by_channel, points, Line2D([], [], color="0.4", label="fitted")]


def _draw_lobes(
    axes: Sequence[Axes], measured: MeasuredBRDF, model: AbstractBRDF, channels: Sequence[str]
) -> None:
    coarse, fine = np.arange(-88.0, 89.0, 2.0), np.arange(-89.75, 90.0, 0.25)
    points, lines = _lobes(measured, coarse), _lobes(model, fine)
    for i, ax in enumerate(axes):
        for c, channel in enumerate(channels):
            colour, marker = style(channel)
            ax.plot(*polar(points[i, :, c], coarse), marker, color=colour, markersize=2.6, alpha=0.45, mew=0)
            ax.plot(*polar(lines[i, :, c % lines.shape[2]], fine), color=colour, linewidth=1.1)
        dress_lobe(ax, _INCIDENCES[i], largest(points[i], lines[i]))


def draw_model_lobes(
    axes: Sequence[Axes],
    measured: MeasuredBRDF,
    models: Mapping[str, AbstractBRDF],
    colours: Mapping[str, Any],
    channel: int,
) -> None:
    """One channel of a measurement and of several models, a colour each, at four incidences."""
    coarse, fine = np.arange(-88.0, 89.0, 2.0), np.arange(-89.75, 90.0, 0.25)
    points = _lobes(measured, coarse)[:, :, channel]
    lines = {name: _lobes(model, fine) for name, model in models.items()}
    for i, ax in enumerate(axes):
        ax.plot(*polar(points[i], coarse), "o", color="0.3", markersize=2.6, mew=0, label="measured")
        for name, line in lines.items():
            radius = line[i, :, channel % line.shape[2]]
            ax.plot(*polar(radius, fine), color=colours[name], linewidth=1.1, label=name)
        dress_lobe(ax, _INCIDENCES[i], largest(points[i]))


def _lobes(brdf: AbstractBRDF, theta_o: np.ndarray) -> np.ndarray:
    """∛f (4, N, C) for each incidence, over signed angles in the plane of incidence: mirror side positive."""
    wi = spherical(np.deg2rad(np.array(_INCIDENCES))[:, None], np.pi)
    wo = spherical(np.deg2rad(theta_o)[None, :], 0.0)
    return np.cbrt(np.maximum(_evaluate(brdf, wi, wo), 0))


def polar(radius: np.ndarray, theta: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) of polar coordinates, θ in degrees from the upright axis, positive to the right."""
    return radius * np.sin(np.deg2rad(theta)), radius * np.cos(np.deg2rad(theta))


def largest(*values: np.ndarray) -> float:
    """The largest finite number of some arrays, 1 where there is none above 0: a radius to draw within."""
    finite = np.concatenate([v[np.isfinite(v)] for v in values])
    return float(finite.max(initial=0)) or 1.0


def dress_lobe(ax: Axes, incidence: float, radius: float) -> None:
    """A half disc around the lobe (matplotlib's own polar axes leave its lower half empty)."""
    rim = 1.06 * radius
    ax.add_patch(Wedge((0, 0), rim, 0, 180, facecolor="none", edgecolor="0.3", linewidth=0.8))
    for theta in (-60.0, -30.0, 0.0, 30.0, 60.0):
        ax.plot(*polar(np.array([0, rim]), theta), color="0.9", linewidth=0.6, zorder=0)
    ax.plot(*polar(np.array([0, rim]), -incidence), color="0.45", linewidth=1, linestyle="--")
    ax.set(xlim=(-1.02 * rim, 1.02 * rim), ylim=(-0.02 * rim, 1.02 * rim), aspect="equal")
    ax.set_axis_off()
    ax.set_title(rf"$\theta_i = {incidence:g}°$,  max f {float(f'{radius**3:.3g}'):g}/sr", fontsize=9)


@eqx.filter_jit
def _values(brdf: AbstractBRDF, wi: Direction, wo: Direction) -> jax.Array:
    return brdf(wi, wo)


def _evaluate(brdf: AbstractBRDF, wi: Direction, wo: Direction) -> np.ndarray:
    """f of broadcast directions, (..., C), or (..., 1) of a grey model; NaN, which is not drawn, for ±∞."""
    wi, wo = jnp.broadcast_arrays(wi, wo)
    values = np.asarray(_values(brdf, wi, wo))
    values = np.where(np.isfinite(values), values, np.nan)
    return values if values.ndim == wi.ndim else values[..., None]
