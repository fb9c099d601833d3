"""Pictures of comparisons: lobes and lit spheres of one material's models, errors across many materials."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxbrdf import AbstractBRDF, MeasuredBRDF
from jaxbrdf.cli import pictures, report
from jaxbrdf.preview import Appearance, image, render, to_srgb
from jaxbrdf.scene import lit_sphere

_SIZE = 96  # pixels of a sphere


def material(
    measured: MeasuredBRDF, models: Mapping[str, AbstractBRDF], document: Mapping[str, Any]
) -> Figure:
    """The lobes of all models in the plane of incidence, of the middle channel, and spheres made of them."""
    figure = Figure(figsize=(13, 5.6), dpi=110, layout="constrained")
    upper, lower = cast(np.ndarray, figure.subfigures(2, 1, height_ratios=(1.5, 1)))
    channel = len(document["channels"]) // 2
    colours = _colours(list(models))
    pictures.draw_model_lobes(list(upper.subplots(1, 4)), measured, models, colours, channel)
    handles, labels = upper.axes[0].get_legend_handles_labels()
    upper.legend(handles, labels, loc="outside lower center", ncols=7, frameon=False)
    name = document["channels"][channel]
    upper.suptitle(f"lobes, radius $f^{{1/3}}${', ' + name if name else ''}", fontsize=10)
    differences = {fit["model"]: fit["lab_difference"] for fit in document["fits"]}
    if all(value is None for value in differences.values()):
        lower.suptitle("no lit spheres: they take one channel, or R, G and B", fontsize=10)
    else:
        _draw_spheres(list(np.atleast_1d(lower.subplots(1, len(models) + 1))), measured, models, differences)
    figure.suptitle(pictures.plain(document["name"]), fontsize=12)
    return figure


def _draw_spheres(
    axes: Sequence[Axes], measured: MeasuredBRDF, models: Mapping, differences: Mapping
) -> None:
    appearance = Appearance.of(measured, lit_sphere(_SIZE))
    scene, exposure = appearance.scene, appearance.exposure
    rendered = {"measured": appearance.picture} | {name: render(m, scene) for name, m in models.items()}
    for ax, (name, picture) in zip(axes, rendered.items(), strict=True):
        ax.imshow(np.asarray(image(to_srgb(exposure * picture), scene, 1.0)), interpolation="nearest")
        ax.set_axis_off()
        note = "" if name == "measured" else f"\nΔE {differences[name]:.2g}"
        ax.set_title(name + note, fontsize=9)


def across(documents: Sequence[Mapping[str, Any]]) -> Figure:
    """Normalized L2 of every model against materials, which are sorted by the error of the first model.

    Bagher et al. 2012, Fig. 11, sorts them by roughness; here the order is that of the error to beat.
    """
    names = [fit["model"] for fit in documents[0]["fits"]]
    errors = np.array(
        [[report.mean(fit["normalized_l2"]) for fit in document["fits"]] for document in documents]
    )
    order = np.argsort(-np.nan_to_num(errors[:, 0], nan=np.inf), kind="stable")
    figure = Figure(figsize=(max(7, 0.16 * len(documents) + 3), 5.2), dpi=110, layout="constrained")
    ax = figure.subplots()
    for k, (name, colour) in enumerate(zip(names, _colours(names).values(), strict=True)):
        ax.plot(errors[order, k], "o-", color=colour, markersize=3, linewidth=0.9, label=name)
    ax.set(yscale="log", ylabel="normalized L2 below 80°, mean over channels", xlim=(-0.7, len(order) - 0.3))
    labels = [pictures.plain(documents[i]["name"]) for i in order]
    ax.set_xticks(range(len(order)), labels, rotation=90, fontsize=7)
    ax.grid(axis="y", color="0.92", linewidth=0.6)
    figure.legend(loc="outside right upper", frameon=False)
    return figure


def _colours(names: Sequence[str]) -> dict[str, Any]:
    """A colour for each model."""
    palette = colormaps["tab20"] if len(names) > 10 else colormaps["tab10"]
    return {name: palette(k) for k, name in enumerate(names)}
