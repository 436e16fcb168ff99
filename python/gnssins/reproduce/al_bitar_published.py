"""Figures that Al Bitar and Gavrilov (2019) print, and those of an independent program on a drive of the same kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

__all__ = ["LABELS", "PUBLISHED_TABLE", "REFERENCE_R1", "REFERENCE_R2", "REFERENCE_SIGMA", "TIMES_S", "Row"]

Row = tuple[float, float, float, float, float, float]

#: Seconds since the loss of GNSS.
TIMES_S: Final = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0)

#: Quantity of :class:`gnssins.analysis.OutageGrowth`: what it is called, unit of the tables, factor from SI.
LABELS: Final[Mapping[str, tuple[str, str, float]]] = {
    "latitude": ("latitude", "1e-7 rad", 1e7),
    "longitude": ("longitude", "1e-7 rad", 1e7),
    "north": ("latitude", "m", 1.0),
    "east": ("longitude", "m", 1.0),
    "height": ("height", "m", 1.0),
    "distance": ("E_xyz", "m", 1.0),
    "v_north": ("v north", "m/s", 1.0),
    "v_east": ("v east", "m/s", 1.0),
    "v_down": ("v down", "m/s", 1.0),
    "roll": ("roll", "deg", 57.29577951308232),
    "pitch": ("pitch", "deg", 57.29577951308232),
    "heading": ("heading", "deg", 57.29577951308232),
}

#: The table of the publication, a recorded drive, mean of seven outages; units as in :data:`LABELS`.
PUBLISHED_TABLE: Final[Mapping[str, Row]] = {
    "latitude": (2.0, 3.6, 6.0, 9.4, 14.0, 20.0),
    "longitude": (4.8, 10.0, 18.0, 26.0, 37.0, 49.0),
    "height": (2.00, 2.40, 2.60, 2.68, 2.74, 2.86),
    "distance": (3.01, 5.67, 8.82, 12.74, 17.71, 24.02),
    "v_north": (0.134, 0.196, 0.288, 0.351, 0.453, 0.595),
    "v_east": (0.281, 0.420, 0.515, 0.604, 0.723, 0.852),
    "v_down": (0.036, 0.037, 0.039, 0.039, 0.040, 0.044),
    "roll": (0.072, 0.086, 0.098, 0.107, 0.119, 0.132),
    "pitch": (0.085, 0.088, 0.099, 0.109, 0.118, 0.127),
    "heading": (1.613, 1.670, 1.720, 1.777, 1.840, 1.898),
}

#: Independent program, 20 simulated drives, the same sensor values on another route: R1.
REFERENCE_R1: Final[Mapping[str, Row]] = {
    "latitude": (0.25, 0.56, 1.1, 1.8, 2.7, 4.0),
    "longitude": (0.38, 0.81, 1.5, 2.4, 3.8, 5.5),
    "height": (0.07, 0.10, 0.14, 0.18, 0.23, 0.28),
    "distance": (0.28, 0.58, 1.07, 1.78, 2.73, 3.97),
    "v_north": (0.022, 0.037, 0.054, 0.073, 0.094, 0.119),
    "v_east": (0.023, 0.036, 0.051, 0.069, 0.090, 0.115),
    "v_down": (0.005, 0.006, 0.007, 0.008, 0.008, 0.009),
    "roll": (0.013, 0.015, 0.018, 0.020, 0.023, 0.026),
    "pitch": (0.013, 0.015, 0.018, 0.020, 0.022, 0.025),
    "heading": (0.10, 0.11, 0.11, 0.11, 0.12, 0.12),
}

#: The same: R2.
REFERENCE_R2: Final[Mapping[str, Row]] = {
    "latitude": (0.40, 1.1, 2.2, 3.8, 6.0, 8.9),
    "longitude": (0.60, 1.5, 3.0, 5.2, 8.2, 12.3),
    "height": (0.09, 0.15, 0.22, 0.30, 0.39, 0.51),
    "distance": (0.43, 1.10, 2.21, 3.83, 6.04, 8.98),
    "v_north": (0.031, 0.059, 0.091, 0.125, 0.169, 0.222),
    "v_east": (0.032, 0.056, 0.085, 0.122, 0.166, 0.216),
    "v_down": (0.006, 0.007, 0.008, 0.010, 0.011, 0.013),
    "roll": (0.014, 0.018, 0.022, 0.026, 0.032, 0.034),
    "pitch": (0.014, 0.018, 0.022, 0.026, 0.029, 0.037),
    "heading": (0.11, 0.11, 0.12, 0.13, 0.13, 0.14),
}

#: The same: the filter's own sigma of E_xyz, m.
REFERENCE_SIGMA: Final[Row] = (0.47, 1.20, 2.41, 4.20, 6.69, 9.96)
