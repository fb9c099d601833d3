"""Reading a reflectance without saying what format it is in: by its first bytes, then by its suffix."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from data_loaders.errors import DataError
from data_loaders.files import AnyPath, describe, read_head
from data_loaders.merl import is_merl, read_merl
from jaxbrdf import MeasuredBRDF


class _Format(NamedTuple):
    name: str
    suffix: str
    begins: Callable[[bytes], bool]
    read: Callable[[AnyPath], MeasuredBRDF]


_FORMATS = (_Format("MERL", ".binary", is_merl, read_merl),)


def read_brdf(path: AnyPath) -> MeasuredBRDF:
    """The reflectance in a file of any format that is understood: MERL.

    The first bytes decide; where they say nothing, the suffix does, so that a damaged file is reported
    by the reader it was meant for. Raises DataError where neither is known, and as that reader does.
    """
    head = read_head(path)
    suffix = Path(path).suffix.lower()
    by_content = [f for f in _FORMATS if f.begins(head)]
    by_suffix = [f for f in _FORMATS if f.suffix == suffix]
    for known in by_content + by_suffix:
        return known.read(path)
    understood = ", ".join(f"{f.name} ({f.suffix})" for f in _FORMATS)
    raise DataError(path, f"a measured reflectance in a known format: {understood}", describe(head))
