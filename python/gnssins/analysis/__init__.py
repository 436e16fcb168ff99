"""How good is a trajectory, and does the filter know it? Errors, outages, consistency, Monte Carlo.

Every result is a frozen object with ``table()`` (text) and ``to_dict()`` (plain numbers).
"""

from gnssins.analysis.budget import Budget, correction_period, linearity_bound, sensor_budget
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
from gnssins.analysis.earth import EarthVariants, earth_variants
from gnssins.analysis.errors import NavErrors, Rmse, Track, Trajectory, compare, interpolate, ned_difference
from gnssins.analysis.forms import FormTable, agile_flight, attitude_forms, three_rates
from gnssins.analysis.montecarlo import MonteCarlo, monte_carlo, run_seed
from gnssins.analysis.outages import Outage, OutageTable, outage_table
from gnssins.analysis.schuler import SchulerCurves, schuler_curves

__all__ = [
    "Budget",
    "EarthVariants",
    "FormTable",
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
    "SchulerCurves",
    "Track",
    "Trajectory",
    "agile_flight",
    "attitude_forms",
    "chi_square_bounds",
    "compare",
    "correction_period",
    "earth_variants",
    "interpolate",
    "linearity_bound",
    "monte_carlo",
    "ned_difference",
    "nees",
    "nis",
    "outage_table",
    "run_seed",
    "schuler_curves",
    "sensor_budget",
    "three_rates",
]
