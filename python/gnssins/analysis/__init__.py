"""How good is a trajectory, and does the filter know it? Errors, outages, consistency, ensembles.

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
from gnssins.analysis.ensemble import Ensemble, Sample, ensemble, sample_run
from gnssins.analysis.errors import NavErrors, Rmse, Track, Trajectory, compare, interpolate, ned_difference
from gnssins.analysis.forms import FormTable, agile_flight, attitude_forms, three_rates
from gnssins.analysis.gates import Share
from gnssins.analysis.growth import OutageGrowth, outage_growth
from gnssins.analysis.integrity import Integrity, integrity
from gnssins.analysis.noise import BandLimited
from gnssins.analysis.observable import Observability, observability
from gnssins.analysis.outages import Outage, OutageTable, outage_table
from gnssins.analysis.schuler import SchulerCurves, schuler_curves
from gnssins.analysis.windows import place_windows
from gnssins.sim.streams import run_seed

__all__ = [
    "BandLimited",
    "Budget",
    "EarthVariants",
    "Ensemble",
    "FormTable",
    "Integrity",
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
    "SchulerCurves",
    "Share",
    "Track",
    "Trajectory",
    "agile_flight",
    "attitude_forms",
    "chi_square_bounds",
    "compare",
    "correction_period",
    "earth_variants",
    "ensemble",
    "integrity",
    "interpolate",
    "linearity_bound",
    "ned_difference",
    "nees",
    "nis",
    "observability",
    "outage_growth",
    "outage_table",
    "place_windows",
    "run_seed",
    "sample_run",
    "schuler_curves",
    "sensor_budget",
    "three_rates",
]
