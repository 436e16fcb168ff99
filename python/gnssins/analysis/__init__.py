"""How good is a trajectory, and does the filter know it? Errors, outages, consistency, Monte Carlo.

Every result is a frozen object with ``table()`` (text) and ``to_dict()`` (plain numbers).
"""

from gnssins.analysis.consistency import (
    Nees,
    NeesGroup,
    Nis,
    NisGroup,
    Parameters,
    chi_square_bounds,
    nees,
    nis,
)
from gnssins.analysis.errors import NavErrors, Rmse, Track, Trajectory, compare, interpolate, ned_difference
from gnssins.analysis.montecarlo import MonteCarlo, monte_carlo, run_seed
from gnssins.analysis.outages import Outage, OutageTable, outage_table

__all__ = [
    "MonteCarlo",
    "NavErrors",
    "Nees",
    "NeesGroup",
    "Nis",
    "NisGroup",
    "Outage",
    "OutageTable",
    "Parameters",
    "Rmse",
    "Track",
    "Trajectory",
    "chi_square_bounds",
    "compare",
    "interpolate",
    "monte_carlo",
    "ned_difference",
    "nees",
    "nis",
    "outage_table",
    "run_seed",
]
