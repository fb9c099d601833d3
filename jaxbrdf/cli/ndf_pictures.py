"""Pictures of a tabulated distribution of normals: the disk in colour, and slices with fits drawn over."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter, map_coordinates

from jaxbrdf import FitResult, TabulatedNDF, spherical
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.tabulated import disk_cells

_SHARE = 0.995  # of the normals that are in the picture
_SMOOTH = 1.5  # cells by which slices are smoothed: a histogram's cells hold few normals each


def overview(ndf: TabulatedNDF, fits: Mapping[str, FitResult], title: str) -> Figure:
    """The disk, and slices across and along the direction in which normals spread least."""
    figure = Figure(figsize=(13, 4.2), dpi=110, layout="constrained")
    disk, across, along = figure.subplots(1, 3)
    radius, azimuth = _spread(ndf)
    _draw_disk(figure, disk, ndf, radius)
    smooth = TabulatedNDF(gaussian_filter(np.asarray(ndf.values), _SMOOTH), ndf.extent)
    for ax, name, angle in ((across, "across", azimuth), (along, "along", azimuth + np.pi / 2)):
        _draw_slice(ax, smooth, fits, angle, min(1.0, 1.3 * radius))
        ax.set(title=f"{name}: azimuth {np.rad2deg(angle) % 180:.0f}°")
        ax.set_ylim(1e-4 * smooth.values.max(), 2 * smooth.values.max())
    across.set_ylabel("D, 1/sr")
    along.legend(frameon=False, fontsize=8)
    figure.suptitle(title)
    return figure


def _spread(ndf: TabulatedNDF) -> tuple[float, float]:
    """The radius in the disk within which almost all normals are, and the azimuth along which they spread
    most: light is then spread across what lies along, grooves for instance."""
    m_x, m_y, m_z = disk_cells(len(ndf.values), ndf.extent)
    weight = np.where(m_z > 0, np.asarray(ndf.values), 0)
    order = np.argsort(np.hypot(m_x, m_y), axis=None)
    inside = np.cumsum(weight.ravel()[order]) <= _SHARE * weight.sum()
    radius = np.hypot(m_x, m_y).ravel()[order][np.sum(inside) - 1]
    x, y = m_x - np.average(m_x, weights=weight), m_y - np.average(m_y, weights=weight)
    xx, xy, yy = (np.sum(weight * a) for a in (x * x, x * y, y * y))
    least = 4 * max(ndf.extent) / len(weight)
    return float(np.clip(radius, least, 1)), float(np.arctan2(2 * xy, xx - yy) / 2)


def _draw_disk(figure: Figure, ax: Axes, ndf: TabulatedNDF, radius: float) -> None:
    x, y = ndf.extent
    image = ax.imshow(
        np.asarray(ndf.values),
        origin="lower",
        extent=(-x, x, -y, y),
        cmap="inferno",
        norm=PowerNorm(0.4),
        interpolation="antialiased",
    )
    turn = np.linspace(0, 2 * np.pi, 200)
    ax.plot(np.cos(turn), np.sin(turn), color="0.6", linewidth=0.8)
    ax.set(xlim=(-radius, radius), ylim=(-radius, radius), xlabel="m_x", ylabel="m_y", aspect="equal")
    ax.locator_params(nbins=5)
    figure.colorbar(image, ax=ax, label="D, 1/sr", shrink=0.85)


def _draw_slice(
    ax: Axes, ndf: TabulatedNDF, fits: Mapping[str, FitResult], azimuth: float, reach: float
) -> None:
    """D against the polar angle, on both sides of the normal."""
    limit = np.arcsin(min(reach, 0.999))
    theta = np.linspace(-limit, limit, 401)
    m = np.array(spherical(np.abs(theta), np.where(theta < 0, azimuth + np.pi, azimuth)))
    n = len(ndf.values)
    rows, columns = ((m[:, k] / ndf.extent[k] + 1) * n / 2 - 0.5 for k in (1, 0))
    data = map_coordinates(np.asarray(ndf.values), [rows, columns], order=1, mode="nearest")
    measured = (data > 0) & np.all(np.abs(m[:, :2]) <= ndf.extent, axis=1)
    ax.semilogy(
        np.rad2deg(theta), np.where(measured, data, np.nan), color="0.55", linewidth=2.5, label="measured"
    )
    for (name, fit), style in zip(fits.items(), ("-", "--", ":"), strict=False):
        if fit.success and isinstance(fit.model, AbstractNDF):
            ax.semilogy(np.rad2deg(theta), fit.model(m), style, linewidth=1.2, label=name)
    ax.set(xlabel="θ, degrees", xlim=(-np.rad2deg(limit), np.rad2deg(limit)))
    ax.grid(color="0.93")
