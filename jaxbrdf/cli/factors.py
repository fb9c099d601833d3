r"""The factors of a reflectance as its data show them, and fits over them: Bagher et al. 2012, Fig. 3 and 6.

D is read off the backscattering slice by power iteration, and F off the mirror slice by eq. 10 of the paper
in the normalisation of `Microfacet`:

    F(θ_d) = (m_d(θ_d) − ρ_d/π) 4 cos²θ_d / (D(0) G1(θ_d)²)

with the diffuse part of the shifted gamma fit taken off. The free form is read off in the same way: of its
own factors only the product means much. How far a fit's error is from its error is what the fit could gain.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich import box
from rich.console import Console
from rich.table import Table

from data_loaders import to_rgb
from fitting import backscattering_ndf, fit_factors, fit_shifted_gamma, fit_two_slice
from jaxbrdf import (
    Beckmann,
    FitResult,
    FitStatus,
    MeasuredBRDF,
    Slices,
    TrowbridgeReitz,
    as_table,
    compare,
    spherical,
)
from jaxbrdf.cli import pictures, report, sources
from jaxbrdf.metrics import tabulate
from jaxbrdf.resampling import Reflectance

_FITS: dict[str, Any] = {
    "shifted gamma": "-",
    "GGX": "--",
    "Beckmann": ":",
}  # what is fitted, and how it is drawn
_FREE = "free form"
_MOST = 8  # channels; of more, their colours
_DENSE = np.pi / 2 * np.linspace(0, 1, 300, endpoint=False)


class Read(NamedTuple):
    """D (H, C) at θ_h (H,), F (E, C) at θ_d (E,) and Smith's G1 (H, C) at θ_h, as slices show them."""

    theta_h: np.ndarray
    D: np.ndarray
    theta_d: np.ndarray
    F: np.ndarray
    G1: np.ndarray


class Factors(NamedTuple):
    """Of one material: its channels, what was read off it and off the free form, fits and their errors."""

    channels: list[str]
    data: Read
    free: Read
    fits: dict[str, FitResult]
    errors: dict[str, dict[str, np.ndarray]]


def find(reflectance: Reflectance) -> Factors:
    """Raises ValueError where a reflectance is not isotropic, or nothing is known of its backscattering."""
    if len(sources.channels(reflectance)) > _MOST:
        reflectance = to_rgb(reflectance)
    table = as_table(reflectance)
    slices = table.slices()
    if not np.isfinite(slices.m_h).any():
        raise ValueError(
            "--factors reads the distribution off the backscattering slice: expected samples with wi near "
            "wo, found none"
        )
    fits = {
        "shifted gamma": fit_shifted_gamma(table),
        "GGX": fit_two_slice(TrowbridgeReitz, table),
        "Beckmann": fit_two_slice(Beckmann, table),
        _FREE: fit_factors(table),
    }
    errors = {
        name: {k: np.asarray(v) for k, v in compare(_model(f), table).items()} for name, f in fits.items()
    }
    rho_d = np.nan_to_num(np.asarray(_model(fits["shifted gamma"]).rho_d))
    free = _model(fits[_FREE])
    fitted = MeasuredBRDF(np.asarray(tabulate(free, table.grid)), np.ones(len(rho_d)), table.grid)
    read = _read_off(slices, rho_d), _read_off(fitted.slices(), rho_d)
    return Factors(sources.channels(reflectance), *read, fits, errors)


def _read_off(slices: Slices, rho_d: np.ndarray) -> Read:
    ndf = backscattering_ndf(slices, rho_d)
    G1 = np.stack([np.interp(slices.theta_d, ndf.theta_h, g) for g in ndf.G1.T], axis=-1)
    lobe = (slices.m_d - rho_d / np.pi) * 4 * np.cos(slices.theta_d)[:, None] ** 2
    return Read(ndf.theta_h, ndf.D, slices.theta_d, lobe / (ndf.D[:1] * G1**2), ndf.G1)


def _model(fit: FitResult) -> Any:
    """The model: of a class that each fit has for itself."""
    return fit.model


def document(found: Factors) -> dict[str, Any]:
    """All of it as plain numbers: lists with one number, or one list over the angles, for each channel."""
    data = found.data
    return {
        "channels": found.channels,
        "theta_h_deg": np.rad2deg(data.theta_h).tolist(),
        "distribution": data.D.T.tolist(),
        "theta_d_deg": np.rad2deg(data.theta_d).tolist(),
        "fresnel": data.F.T.tolist(),
        "fits": [_fit_document(name, fit, found.errors[name]) for name, fit in found.fits.items()],
    }


def _fit_document(name: str, fit: FitResult, errors: dict[str, np.ndarray]) -> dict[str, Any]:
    return {
        "model": name,
        "rho_d": np.asarray(_model(fit).rho_d).tolist(),
        "normalized_l2_below_80": errors["normalized_l2"].tolist(),
        "log_error_below_80": errors["log_error"].tolist(),
        "status": [FitStatus(int(s)).name.lower() for s in fit.status],
    }


def show(factors: dict[str, Any]) -> None:
    """The diffuse albedos and the errors of all fits of a `document`, on standard output."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("fit")
    columns = {"ρ_d": "rho_d", "L2<80°": "normalized_l2_below_80", "log<80°": "log_error_below_80"}
    for label in columns:
        for channel in factors["channels"]:
            table.add_column(f"{label} {channel}".strip(), justify="right")
    for fit in factors["fits"]:
        table.add_row(fit["model"], *(report.number(x) for key in columns.values() for x in fit[key]))
    report.wide_enough(Console()).print(table)


def draw(found: Factors, name: str) -> Figure:
    """Three panels: D over θ_h, F over θ_d, and G1."""
    figure = Figure(figsize=(13, 5), dpi=110, layout="constrained")
    axes = figure.subplots(1, 3)
    pictures.dress_slices(list(axes[:2]))
    axes[0].set(title="distribution", ylabel="D (1/sr)")
    axes[1].set(title="Fresnel term", ylabel="F")
    axes[2].set(title="masking", xlim=(0, 90), xlabel=r"$\theta$ (degrees)", ylabel="$G_1$")
    for c, channel in enumerate(found.channels):
        _draw_channel(list(axes), found, c, *pictures.style(channel))
    data = found.data
    pictures.set_range(axes[0], data.D[data.theta_h < pictures.GRAZING])
    pictures.set_range(axes[1], data.F[data.theta_d < pictures.GRAZING])
    axes[2].set_ylim(bottom=0)
    axes[2].grid(color="0.92", linewidth=0.6)
    figure.legend(handles=_legend(found.channels), loc="outside lower center", ncols=9, frameon=False)
    figure.suptitle(pictures.plain(name), fontsize=12)
    return figure


def _draw_channel(axes: Sequence[Axes], found: Factors, c: int, colour: str, marker: str) -> None:
    data, free = found.data, found.free
    points: dict[str, Any] = {"color": colour, "markersize": 3.5, "alpha": 0.45, "mew": 0}
    axes[0].plot(np.rad2deg(data.theta_h), data.D[:, c], marker, **points)
    axes[1].plot(np.rad2deg(data.theta_d), data.F[:, c], marker, **points)
    axes[2].plot(np.rad2deg(data.theta_h), data.G1[:, c], marker, **points)
    for name, line in _FITS.items():
        D, F = _fitted(found.fits[name])
        axes[0].plot(np.rad2deg(_DENSE**2 / _DENSE[-1]), D[:, c], line, color=colour, linewidth=1.3)
        axes[1].plot(np.rad2deg(_DENSE), F[:, c], line, color=colour, linewidth=1.3)
    thick: dict[str, Any] = {"color": colour, "linewidth": 3, "alpha": 0.35}
    axes[0].plot(np.rad2deg(free.theta_h), free.D[:, c], **thick)
    axes[1].plot(np.rad2deg(free.theta_d), free.F[:, c], **thick)
    model = _model(found.fits[_FREE])
    axes[2].plot(np.rad2deg(np.asarray(model.theta)), np.asarray(model.G1)[:, c], **thick)


def _fitted(fit: FitResult) -> tuple[np.ndarray, np.ndarray]:
    """D and F of a Cook–Torrance fit, dense, (N, C); its 1/π is made the 1/4 of `Microfacet`."""
    model = _model(fit)
    D = np.asarray(model.ndf(spherical(_DENSE**2 / _DENSE[-1], 0.0)))
    F = 4 / np.pi * np.asarray(model.rho_s) * np.asarray(model.fresnel(np.cos(_DENSE)))
    return D, F


def _legend(channels: Sequence[str]) -> list[Line2D]:
    styles = [(channel, *pictures.style(channel)) for channel in channels if channel]
    by_channel = [Line2D([], [], color=colour, marker=m, markersize=5, label=c) for c, colour, m in styles]
    points = Line2D([], [], color="0.4", marker="o", markersize=4, linestyle="", label="read off the data")
    fits = [Line2D([], [], color="0.3", linestyle=line, label=name) for name, line in _FITS.items()]
    return [*by_channel, points, *fits, Line2D([], [], color="0.3", linewidth=3, alpha=0.35, label=_FREE)]
