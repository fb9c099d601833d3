r"""The factors of a reflectance as its data show them, with fits drawn over.

As in Fig. 3 and 6 of Bagher et al. 2012, D is read off the backscattering slice, by power iteration, and F
off the mirror slice by their eq. 10, in the normalisation of `Microfacet`:

    F(θ_d) = (m_d(θ_d) − ρ_d/π) 4 cos²θ_d / (D(0) G1(θ_d)²)

The diffuse part that is taken off is that of the shifted gamma fit. F of every fit is read off its mirror
slice with the same ρ_d, D(0) and G1: where it meets the points, the fit meets the measurement. D is a fit's
own; only that of the free form, whose factors mean little but for their product, is read off as well. How far
the error of a fit is from that of the free form is what it could still gain.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich import box
from rich.console import Console
from rich.table import Table

from data_loaders import to_rgb
from fitting import BackscatteringNDF, backscattering_ndf, fit_factors, fit_shifted_gamma, fit_two_slice
from jaxbrdf import (
    AbstractBRDF,
    Beckmann,
    CookTorrance,
    FitResult,
    FitStatus,
    FreeFormBRDF,
    MeasuredBRDF,
    ShiftedGammaBRDF,
    Slices,
    TrowbridgeReitz,
    as_table,
    compare,
    from_half_difference,
    spherical,
)
from jaxbrdf.cli import pictures, report, sources
from jaxbrdf.resampling import Reflectance, evaluate

_DATA, _FREE = "read off the data", "free form"
_SGD = "shifted gamma"
_LINES: dict[str, dict[str, Any]] = {  # how each is drawn; the data as the channel's markers
    _SGD: {"linestyle": "-", "linewidth": 1.3},
    "GGX": {"linestyle": "--", "linewidth": 1.3},
    "Beckmann": {"linestyle": ":", "linewidth": 1.3},
    _FREE: {"linestyle": "-", "linewidth": 3.5, "alpha": 0.35},
}
_POINTS: dict[str, Any] = {"markersize": 3.5, "alpha": 0.45, "mew": 0, "linestyle": ""}
_MOST = 8  # channels; of more, their colours


class Factors(NamedTuple):
    """Of one material: D (H, C) over θ_h and F (E, C) over θ_d, of the data and of each fit; G1 besides."""

    channels: list[str]
    theta_h: np.ndarray
    theta_d: np.ndarray
    D: dict[str, np.ndarray]
    F: dict[str, np.ndarray]
    G1: dict[str, tuple[np.ndarray, np.ndarray]]  # angles, and values
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
    fits = _fit(table)
    models = {name: cast(AbstractBRDF, fit.model) for name, fit in fits.items()}
    errors = {name: {k: np.asarray(v) for k, v in compare(m, table).items()} for name, m in models.items()}
    sgd, free = cast(ShiftedGammaBRDF, models[_SGD]), cast(FreeFormBRDF, models[_FREE])
    read = backscattering_ndf(slices, np.nan_to_num(np.asarray(sgd.rho_d)))
    of_models = {name: _slices_of(model, slices) for name, model in models.items()}
    D = {name: _distribution(model, slices.theta_h) for name, model in models.items() if name != _FREE}
    D |= {_DATA: read.D, _FREE: backscattering_ndf(of_models[_FREE], read.rho_d).D}
    F = {name: _fresnel(s, read) for name, s in ({_DATA: slices} | of_models).items()}
    G1 = {_DATA: (read.theta_h, read.G1), _FREE: (np.asarray(free.theta), np.asarray(free.G1))}
    channels = sources.channels(reflectance)
    return Factors(channels, slices.theta_h, slices.theta_d, D, F, G1, fits, errors)


def _fit(table: MeasuredBRDF) -> dict[str, FitResult]:
    return {
        _SGD: fit_shifted_gamma(table),
        "GGX": fit_two_slice(TrowbridgeReitz, table),
        "Beckmann": fit_two_slice(Beckmann, table),
        _FREE: fit_factors(table),
    }


def _slices_of(model: AbstractBRDF, like: Slices) -> Slices:
    """The two slices of a model, at the angles of others."""
    w = np.asarray(spherical(like.theta_h, 0.0))
    wi, wo = map(np.asarray, from_half_difference(like.theta_h_mirror, 0.0, like.theta_d, np.pi / 2))
    return Slices(like.theta_h, evaluate(model, w, w), like.theta_d, evaluate(model, wi, wo))


def _distribution(model: AbstractBRDF, theta_h: np.ndarray) -> np.ndarray:
    """D of a parametric fit, (H, C)."""
    return np.asarray(cast(CookTorrance, model).ndf(spherical(theta_h, 0.0)))


def _fresnel(slices: Slices, read: BackscatteringNDF) -> np.ndarray:
    """F by the formula of the module, (E, C); NaN where no facet faces the normal."""
    G1 = np.stack([np.interp(slices.theta_d, read.theta_h, g) for g in read.G1.T], axis=-1)
    lobe = (slices.m_d - read.rho_d / np.pi) * 4 * np.cos(slices.theta_d)[:, None] ** 2
    facing = read.D[:1] * G1**2
    return np.where(facing > 0, lobe, np.nan) / np.where(facing > 0, facing, 1)


def document(found: Factors) -> dict[str, Any]:
    """All of it as plain numbers: lists with one number, or one list over the angles, for each channel."""
    return {
        "channels": found.channels,
        "theta_h_deg": np.rad2deg(found.theta_h).tolist(),
        "distribution": found.D[_DATA].T.tolist(),
        "theta_d_deg": np.rad2deg(found.theta_d).tolist(),
        "fresnel": found.F[_DATA].T.tolist(),
        "fits": [_fit_document(name, fit, found.errors[name]) for name, fit in found.fits.items()],
    }


def _fit_document(name: str, fit: FitResult, errors: dict[str, np.ndarray]) -> dict[str, Any]:
    return {
        "model": name,
        "rho_d": np.asarray(cast(CookTorrance, fit.model).rho_d).tolist(),
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
        _draw_channel(list(axes), found, c, pictures.style(channel))
    pictures.set_range(axes[0], found.D[_DATA][found.theta_h < pictures.GRAZING])
    pictures.set_range(axes[1], found.F[_DATA][found.theta_d < pictures.GRAZING])
    axes[2].set_ylim(0, 1.5)
    axes[2].grid(color="0.92", linewidth=0.6)
    figure.legend(handles=_legend(found.channels), loc="outside lower center", ncols=9, frameon=False)
    figure.suptitle(pictures.plain(name), fontsize=12)
    return figure


def _draw_channel(axes: Sequence[Axes], found: Factors, c: int, style: tuple[str, str]) -> None:
    colour, marker = style
    for name in (_DATA, *_LINES):
        look = _LINES.get(name, {"marker": marker, **_POINTS})
        axes[0].plot(np.rad2deg(found.theta_h), found.D[name][:, c], color=colour, **look)
        axes[1].plot(np.rad2deg(found.theta_d), found.F[name][:, c], color=colour, **look)
        if name in found.G1:
            theta, G1 = found.G1[name]
            axes[2].plot(np.rad2deg(theta), G1[:, c], color=colour, **look)


def _legend(channels: Sequence[str]) -> list[Line2D]:
    styles = [(channel, *pictures.style(channel)) for channel in channels if channel]
    by_channel = [Line2D([], [], color=colour, marker=m, markersize=5, label=c) for c, colour, m in styles]
    points = Line2D([], [], color="0.4", marker="o", markersize=4, linestyle="", label=_DATA)
    return [
        *by_channel,
        points,
        *(Line2D([], [], color="0.3", label=n, **look) for n, look in _LINES.items()),
    ]
