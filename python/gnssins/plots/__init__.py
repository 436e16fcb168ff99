"""Figures of a run: one function makes one :class:`matplotlib.figure.Figure` and returns it.

>>> from gnssins import plots
>>> plots.save(plots.track(result), "track.png")  # doctest: +SKIP
"""

from gnssins.plots.aiding import innovations, nis
from gnssins.plots.blocks import biases
from gnssins.plots.errors import attitude_errors, position_errors, velocity_errors
from gnssins.plots.ground import track
from gnssins.plots.inertial import schuler
from gnssins.plots.observability import observability
from gnssins.plots.style import save

__all__ = [
    "attitude_errors",
    "biases",
    "innovations",
    "nis",
    "observability",
    "position_errors",
    "save",
    "schuler",
    "track",
    "velocity_errors",
]
