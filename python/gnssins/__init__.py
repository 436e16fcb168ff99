"""INS/GNSS integration: from an IMU and GNSS log, or a simulated flight, to a trusted trajectory.

>>> import gnssins
>>> result = gnssins.run("drive.toml")  # doctest: +SKIP
>>> result.navigation  # doctest: +SKIP

Conventions, everywhere: n = north, east, down; b = body forward, right, down; e = Earth-fixed. ``q_nb`` and
``c_nb`` take b-vectors to n; quaternions are scalar first. Inside everything is SI and radians; configuration
files and tables carry the unit in the name. Time is integer nanoseconds (``t_ns``); heights are above the
ellipsoid. Navigation errors are estimate minus truth.

The names below load on first use, so that ``import gnssins`` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gnssins import ahrs, analysis, checks, config, errors, plots, reproduce, result, sim
    from gnssins.alignment import InitialState, initial_state
    from gnssins.config import Config, preset_names
    from gnssins.dataset import BaroTable, Dataset, GnssTable, HeadingTable, ImuTable, TruthTable
    from gnssins.errors import GnssinsError
    from gnssins.io import read_dataset
    from gnssins.montecarlo import MonteCarlo, monte_carlo, simulated_run
    from gnssins.navigator import Navigator
    from gnssins.pieces import run_pieces
    from gnssins.result import Result
    from gnssins.runner import run
    from gnssins.sim import Simulated, Simulator, simulate
    from gnssins.uncoupled import separated

__all__ = [
    "BaroTable",
    "Config",
    "Dataset",
    "GnssTable",
    "GnssinsError",
    "HeadingTable",
    "ImuTable",
    "InitialState",
    "MonteCarlo",
    "Navigator",
    "Result",
    "Simulated",
    "Simulator",
    "TruthTable",
    "__version__",
    "ahrs",
    "analysis",
    "checks",
    "config",
    "errors",
    "initial_state",
    "monte_carlo",
    "plots",
    "preset_names",
    "read_dataset",
    "reproduce",
    "result",
    "run",
    "run_pieces",
    "separated",
    "sim",
    "simulate",
    "simulated_run",
]

_MODULES = ("ahrs", "analysis", "checks", "config", "errors", "plots", "reproduce", "result", "sim")

_HOME = {
    "BaroTable": "dataset",
    "Config": "config",
    "Dataset": "dataset",
    "GnssTable": "dataset",
    "GnssinsError": "errors",
    "HeadingTable": "dataset",
    "ImuTable": "dataset",
    "InitialState": "alignment",
    "MonteCarlo": "montecarlo",
    "Navigator": "navigator",
    "Result": "result",
    "Simulated": "sim",
    "Simulator": "sim",
    "TruthTable": "dataset",
    "initial_state": "alignment",
    "monte_carlo": "montecarlo",
    "preset_names": "config",
    "read_dataset": "io",
    "run": "runner",
    "run_pieces": "pieces",
    "separated": "uncoupled",
    "simulate": "sim",
    "simulated_run": "montecarlo",
}

__version__: str


def __getattr__(name: str) -> Any:
    if name == "__version__":
        value: Any = import_module("gnssins._core").version()
    elif name in _MODULES:
        value = import_module(f"gnssins.{name}")
    elif name in _HOME:
        value = getattr(import_module(f"gnssins.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module 'gnssins' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
