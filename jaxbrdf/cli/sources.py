"""What the commands take for a reflectance: a file of any format, or published numbers, MODEL:MATERIAL."""

from pathlib import Path

import numpy as np

from data_loaders import published, read_brdf, recognise
from jaxbrdf import AdaptiveBRDF, MeasuredBRDF, MeasuredSamples, Scaled, Sum
from jaxbrdf.cli.report import channel_names
from jaxbrdf.resampling import Measurement, Reflectance, count_channels


def is_published(path: Path) -> bool:
    """Whether an argument names numbers from the literature, not a file."""
    return ":" in str(path) and not path.exists()


def load(path: Path) -> Reflectance:
    """The reflectance that an argument names. Raises DataError and ValueError as the readers do."""
    if is_published(path):
        model, _, material = str(path).partition(":")
        return published(model, material)
    return read_brdf(path)


def format_name(path: Path) -> str:
    return "published" if is_published(path) else recognise(path).name


def class_names(reflectance: Reflectance) -> str:
    """The class of a reflectance, or those of the terms of a sum."""
    if isinstance(reflectance, Sum):
        return " + ".join(class_names(term) for term in reflectance.terms)
    return class_names(reflectance.brdf) if isinstance(reflectance, Scaled) else type(reflectance).__name__


def kind(reflectance: Reflectance) -> str:
    """What holds the reflectance, in words."""
    words = {
        MeasuredSamples: "samples at scattered directions",
        MeasuredBRDF: "a table over half and difference angles",
        AdaptiveBRDF: "adaptive tables",
    }
    return words.get(type(reflectance), f"the model {class_names(reflectance)}")


def wavelengths(reflectance: Reflectance) -> np.ndarray | None:
    """Those of a measurement's channels, µm, where they are known."""
    return reflectance.wavelengths if isinstance(reflectance, Measurement) else None


def channels(reflectance: Reflectance) -> list[str]:
    """What the channels are called: R, G, B, a wavelength or a number; one empty name of a grey model."""
    known = wavelengths(reflectance)
    if known is not None:
        return [f"{1000 * x:.4g} nm" for x in known]
    return channel_names(count_channels(reflectance))
