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
from gnssins.analysis.ensemble import Ensemble, Sample, ensemble, sample_run
from gnssins.analysis.errors import NavErrors, Rmse, Track, Trajectory, compare, interpolate, ned_difference
from gnssins.analysis.gates import Share
from gnssins.analysis.growth import OutageGrowth, outage_growth
from gnssins.analysis.integrity import Integrity, integrity
from gnssins.analysis.montecarlo import MonteCarlo, monte_carlo, run_seed
from gnssins.analysis.noise import BandLimited
from gnssins.analysis.observable import Observability, observability
from gnssins.analysis.outages import Outage, OutageTable, outage_table
from gnssins.analysis.windows import place_windows

__all__ = [
    "BandLimited",
    "Ensemble",
    "Integrity",
    "MonteCarlo",
    "NavErrors",
    "Nees",
    "NeesGroup",
    "Nis",
    "NisGroup",
    "Observability",
    "Outage",
    "OutageGrowth",
    "OutageTable",
    "Parameters",
    "Rmse",
    "Sample",
    "Share",
    "Track",
    "Trajectory",
    "chi_square_bounds",
    "compare",
    "ensemble",
    "integrity",
    "interpolate",
    "monte_carlo",
    "ned_difference",
    "nees",
    "nis",
    "observability",
    "outage_growth",
    "outage_table",
    "place_windows",
    "run_seed",
    "sample_run",
]
