"""Shared set-up of the Python tests: head-less figures, reproducible properties, recorded data."""

import os
from pathlib import Path

os.environ["MPLBACKEND"] = "Agg"  # before anything imports matplotlib

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parents[2]

settings.register_profile(
    "gnssins", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("gnssins")


@pytest.fixture(scope="session")
def repository() -> Path:
    """Top folder of the source tree."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the recorded data sets.

    It lies beside the source tree (``../shared/data``) or where ``GNSSINS_DATA`` says, and is not
    part of the distribution: tests that need it are skipped where it is absent.
    """
    folder = Path(os.environ.get("GNSSINS_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"recorded data not found at {folder}: set GNSSINS_DATA to the folder of the sets")
    return folder


@pytest.fixture(autouse=True)
def _no_open_figures() -> object:
    """Close the figures that a test left open, so that one test cannot draw into another's."""
    yield
    import sys

    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")
