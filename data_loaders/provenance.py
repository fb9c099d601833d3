"""Where a result comes from: the versions that made it, when, and from which files."""

import os
from collections.abc import Iterable
from datetime import UTC, datetime
from importlib.metadata import version

from data_loaders.files import AnyPath

Source = AnyPath | Iterable[AnyPath] | None


def provenance(source: Source = None) -> dict[str, str | tuple[str, ...]]:
    """The time (ISO 8601, UTC), the versions of what took part, and the `source` files as they were given."""
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        **{package: version(package) for package in ("jaxbrdf", "jax", "numpy", "optimistix")},
        "source": _names(source),
    }


def _names(source: Source) -> tuple[str, ...]:
    if source is None:
        return ()
    paths = [source] if isinstance(source, str | os.PathLike) else source
    return tuple(os.fspath(path) for path in paths)
