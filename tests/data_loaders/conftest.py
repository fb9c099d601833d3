"""MERL files of known content, written by numpy alone: never by the writer that is tested."""

from pathlib import Path

import numpy as np
import pytest

SHAPE = (3, 90, 90, 180)


def write_layout(path: Path, table: np.ndarray, dimensions=(90, 90, 180)) -> Path:
    """A file of the MERL layout: three int32, then the table [channel, θ_h, θ_d, φ_d]."""
    path.write_bytes(np.array(dimensions, "<i4").tobytes() + table.astype("<f8").tobytes())
    return path


@pytest.fixture(scope="session")
def table() -> np.ndarray:
    """Random raw numbers over many decades; cells below the horizon −1, and some others −0.5 or −1e-3."""
    rng = np.random.default_rng(20)
    raw = np.exp(rng.normal(0, 3, SHAPE))
    theta_h = ((np.arange(90) + 0.5) / 90)[:, None, None] ** 2 * np.pi / 2
    theta_d = np.deg2rad(np.arange(90) + 0.5)[None, :, None]
    phi_d = np.deg2rad(np.arange(180) + 0.5)[None, None, :]
    along = np.cos(theta_h) * np.cos(theta_d)
    across = np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    raw[:, np.minimum(along - across, along + across) <= 0] = -1
    raw[rng.random(SHAPE) < 0.01] = -0.5
    raw[rng.random(SHAPE) < 0.01] = -1e-3
    raw[1, 30, 0] = -1  # nothing valid at one angle of a slice
    raw[:, :30, 7, 3] = 0.0  # zero is a valid sample
    return raw


@pytest.fixture(scope="session")
def known_file(table, tmp_path_factory) -> Path:
    """The table as a MERL file. Tests leave it as it is."""
    return write_layout(tmp_path_factory.mktemp("known") / "known.stuff.binary", table)


@pytest.fixture(scope="module")
def scratch_file(table, tmp_path_factory) -> Path:
    """Another copy, which tests may damage if they repair it."""
    return write_layout(tmp_path_factory.mktemp("scratch") / "scratch.binary", table)
