"""Attitude from gyro, accelerometer and magnetometer alone.

>>> from gnssins import ahrs
>>> sensors = ahrs.Sensors(t_ns, gyro, accel, mag)  # doctest: +SKIP
>>> ahrs.run(sensors).euler  # doctest: +SKIP
>>> ahrs.run(sensors, ahrs.Cross(k=42.8, n=13.3)).euler  # doctest: +SKIP

``run`` without a law is the filter for use. The laws are those of Aleshkin et al. (2021);
:mod:`gnssins.ahrs.tuning` finds their gains and says what these give, :mod:`gnssins.analysis.ahrs` analyses them.
"""

from gnssins.ahrs.estimate import FLAGS, Attitude, References, Sensors, run
from gnssins.ahrs.laws import Cross, Form, Integral, Law, Levelling, Positional, Quaternion, RowLaw

__all__ = [
    "FLAGS",
    "Attitude",
    "Cross",
    "Form",
    "Integral",
    "Law",
    "Levelling",
    "Positional",
    "Quaternion",
    "References",
    "RowLaw",
    "Sensors",
    "run",
]
