"""Navigation sample by sample, with the same engine and the same numbers as :func:`gnssins.run`."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gnssins import _core
from gnssins.config import Config
from gnssins.errors import InputError
from gnssins.result import STATUS, Event, finite
from gnssins.runner import Start, as_config, as_initial
from gnssins.tables import State
from gnssins.units import DEG_TO_RAD, NS_PER_S, seconds_to_ns, times_to_ns

__all__ = ["Measurement", "NavState", "NavStates", "Navigator"]

Array = NDArray[np.float64]

#: Times beyond it do not fit into 64 bits of nanoseconds.
LARGEST_TIME_S: Final = 9.2e9


@dataclass(frozen=True, eq=False)
class NavState:
    """The estimate at one moment; symbols, units and order as in :class:`gnssins.Result`, without the time axis."""

    t_ns: int
    lla: Array
    v_n: Array
    rpy: Array
    q_nb: Array
    sd: Array
    x: Array
    x_sd: Array

    @property
    def time_s(self) -> float:
        """Time in seconds."""
        return self.t_ns / NS_PER_S


@dataclass(frozen=True, eq=False)
class NavStates:
    """Estimates at k moments: the arrays of :class:`gnssins.Result` of the same names."""

    t_ns: NDArray[np.int64]
    lla: Array
    v_n: Array
    rpy: Array
    q_nb: Array
    sd: Array
    x: Array
    x_sd: Array

    def __len__(self) -> int:
        return int(self.t_ns.size)


@dataclass(frozen=True, eq=False)
class Measurement:
    """What became of one row of an aid; see :class:`gnssins.result.Records` for the meaning of the fields.

    ``source`` is ``"gnss"``, ``"baro"`` or ``"heading"``; the latter two have one component: shapes (1,) and (1, 1).
    """

    source: str
    row: int
    t_ns: int
    status: str
    dof: int
    nis: float
    innovation: Array
    innovation_cov: Array
    reason: str
    refused: int


class Navigator(_core.Navigator):
    """A filter that takes one sample after the other, or blocks of them.

    Times are seconds as ``float``, or nanoseconds as ``int``: ``12.5`` and ``12_500_000_000`` are the same
    moment. Use integers where the clock counts from an old epoch: at 1e9 s a float resolves only 0.1 microseconds.

    Parameters
    ----------
    config : Config, mapping or path
        As for :func:`gnssins.run`; file names and ``[run]`` are not looked at.
    initial : InitialState or mapping
        State to start from (for example :func:`gnssins.alignment.initial_state` over the first seconds).

    Raises
    ------
    ConfigError
        The configuration cannot be used.
    InputError
        ``initial`` is no initial state.
    """

    def __new__(
        cls,
        config: Config | Mapping[str, Any] | str | os.PathLike[str],
        initial: Start,
    ) -> Self:
        """Make the filter at its start."""
        config = as_config(config)
        self = super().__new__(cls, json.dumps(config.engine_config(as_initial(initial).to_engine())))
        self._uses_position = config.gnss.uses_position
        self._uses_velocity = config.gnss.uses_velocity
        self._default_var = _configured_variances(config)
        self._baro_sd = config.baro.height_sd_m
        heading_sd = config.heading.heading_sd_deg
        self._heading_sd = None if heading_sd is None else heading_sd * DEG_TO_RAD
        return self

    _uses_position: bool
    _uses_velocity: bool
    _default_var: Array
    _baro_sd: float | None
    _heading_sd: float | None

    def imu_many(
        self, t: ArrayLike, gyro: ArrayLike, accel: ArrayLike, *, interval_s: float | None = None
    ) -> NavStates:
        """Take rows of the IMU as :meth:`imu` does one by one, in a single call; the state after it has the same bits.

        Other threads run meanwhile.

        Parameters
        ----------
        t : array_like, shape (n,)
            Stamps: seconds as float, nanoseconds as int.
        gyro, accel : array_like, shape (n, 3)
            As in :meth:`imu`.
        interval_s : float, optional
            Spacing of the estimates that are handed back: at the first row of every multiple of it, or at every row
            for 0; left out: none.

        Returns
        -------
        NavStates
            The estimates asked for.

        Raises
        ------
        TimeOrderError, GapError
            As :meth:`imu`; ``context["block_row"]`` is the row of the block, from 0. The rows before it are taken, it
            and the rest are not.
        InputError
            Wrong shapes, or times or values that are no numbers; then no row is taken.
        """
        t_ns = _stamps(t)
        interval_ns = None if interval_s is None else seconds_to_ns(interval_s)
        return NavStates(
            **self._imu_many(t_ns, _numbers(gyro, "gyro"), _numbers(accel, "accel"), interval_ns)
        )

    def gnss(
        self,
        t: float | int,
        *,
        lla: ArrayLike | None = None,
        v_n: ArrayLike | None = None,
        sd: ArrayLike | None = None,
        cov: ArrayLike | None = None,
        new_constellation: bool = False,
    ) -> None:
        """Take one fix; it is fused when the IMU reaches its time of validity.

        Parameters
        ----------
        t : float or int
            Stamp as in :meth:`imu`; the latency of the configuration is taken off here.
        lla : array_like, shape (3,), optional
            Latitude, longitude (rad), height (m) of the antenna.
        v_n : array_like, shape (3,), optional
            Velocity north, east, down (m/s); NaN for an absent component.
        sd : array_like, shape (6,), optional
            Standard deviations of position (m) and velocity (m/s), north, east, down; left out: those of ``[gnss]``.
        cov : array_like, shape (6, 6), optional
            Full covariance instead of ``sd``.
        new_constellation : bool, optional
            Whether the receiver uses other satellites than in the row before.

        Raises
        ------
        InputError
            No accuracy is known, an ``sd`` is not positive, or both ``sd`` and ``cov`` are given.
        """
        if cov is not None and sd is not None:
            raise InputError("input.accuracy", "a fix with both sd and cov", "give one of them")
        var = self._default_var if cov is None else _numbers(cov, "cov")
        if sd is not None:
            var = _numbers(sd, "sd") ** 2
        position = _vector(lla) if self._uses_position else None
        velocity = _vector(v_n) if self._uses_velocity else None
        parts = ((position, slice(0, 3)), (velocity, slice(3, 6)))
        if sd is not None:
            _refuse_sd(_numbers(sd, "sd"), position, velocity)
        if any(p is not None and not np.isfinite(var[at]).any() for p, at in parts):
            raise InputError(
                "input.no_sd",
                "the accuracy of a fix is not known",
                "give sd or cov, or [gnss] position_sd_m and velocity_sd_m_s",
            )
        self._gnss(t, position, velocity, var, new_constellation)

    def baro(self, t: float | int, height_m: float, sd_m: float | None = None) -> None:
        """Take one barometric height; it is fused when the IMU reaches its time of validity.

        Parameters
        ----------
        t : float or int
            Stamp as in :meth:`imu`; the latency of the configuration is taken off here.
        height_m : float
            Height above the ellipsoid, up to the altimeter's own error (m).
        sd_m : float, optional
            White noise, 1 sigma; left out: ``[baro] height_sd_m``.

        Raises
        ------
        InputError
            No accuracy is known.
        """
        sd = self._baro_sd if sd_m is None else sd_m
        self._baro(t, float(height_m), _variance(sd, "baro", "height_sd_m"))

    def heading(self, t: float | int, heading_rad: float, sd_rad: float | None = None) -> None:
        """Take one heading of the forward axis, clockwise from true north (rad); as :meth:`baro`.

        Raises
        ------
        InputError
            No accuracy is known.
        """
        sd = self._heading_sd if sd_rad is None else sd_rad
        self._heading(t, float(heading_rad), _variance(sd, "heading", "heading_sd_deg"))

    @property
    def state(self) -> NavState:
        """The estimate now."""
        return NavState(**self._state())

    @property
    def covariance(self) -> Array:
        """Error-state covariance now, shape (n, n), NED axes, SI, order of :attr:`states`."""
        return self._cov()

    @property
    def states(self) -> tuple[State, ...]:
        """Names and units of all states."""
        return tuple(State(s["name"], s["unit"], s["block"], s["kind"]) for s in self._states())

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """Rows taken so far by what became of them, for ``"imu"``, ``"gnss"`` and the aids that were fed."""
        return self._counts()

    def take_measurements(self) -> list[Measurement]:
        """Hand out the records of all aids since the last call, source by source."""
        records: Mapping[str, Any] = self._take_measurements()
        return [
            _measurement(source, columns, i)
            for source, columns in records.items()
            for i in range(len(columns["row"]))
        ]

    def take_events(self) -> list[Event]:
        """Hand out the events since the last call."""
        events = self._take_events()
        return [Event(e["t_ns"], e["code"], e["row"], e["message"], finite(e["value"])) for e in events]


def _measurement(source: str, m: Mapping[str, Any], i: int) -> Measurement:
    whole = source == "gnss"
    return Measurement(
        source,
        int(m["row"][i]),
        int(m["t_ns"][i]),
        STATUS[int(m["status"][i])],
        int(m["dof"][i]),
        float(m["nis"][i]),
        m["innovation"][i] if whole else m["innovation"][i : i + 1],
        m["innovation_cov"][i] if whole else m["variance"][i : i + 1, None],
        m["reason"][i],
        int(m["refused"][i]),
    )


def _variance(sd: float | None, section: str, key: str) -> float:
    if sd is None:
        raise InputError(
            "input.no_sd", f"the accuracy of a {section} row is not known", f"give it, or [{section}] {key}"
        )
    return float(sd) ** 2


def _stamps(t: ArrayLike) -> NDArray[np.int64]:
    """Nanoseconds of stamps: whole numbers are nanoseconds already, floating point is seconds."""
    stamps = np.asarray(t)
    if stamps.dtype.kind in "iu" or not stamps.size:
        return stamps.astype(np.int64, copy=False)
    number = stamps.dtype.kind == "f"
    bad = ~(np.abs(stamps) < LARGEST_TIME_S) if number else np.ones(stamps.size, dtype=np.bool_)
    if not bad.any():
        return times_to_ns(stamps.astype(np.float64, copy=False))
    first = int(np.argmax(bad))
    raise InputError(
        "input.time",
        f"{int(bad.sum())} of {stamps.size} times are no finite numbers, first row {first}: {stamps.flat[first]!r}",
        "give seconds as float or nanoseconds as int; leave out rows without a time",
    )


def _refuse_sd(sd: Array, position: Array | None, velocity: Array | None) -> None:
    """Raise for a standard deviation of a component that is there which is zero, negative or NaN."""
    absent = np.full(3, np.nan)
    values = np.concatenate([absent if part is None else part for part in (position, velocity)])
    if sd.shape != (6,) or values.shape != (6,):
        raise InputError(
            "input.shape",
            f"a fix with sd of shape {sd.shape}, needs (6,), and {values.size} components, needs 6",
            "lla and v_n have three components, sd has six: position, then velocity, north, east, down",
        )
    bad = np.isfinite(values) & ~(sd > 0.0)
    if bad.any():
        names = [f"{part} {axis}" for part in ("position", "velocity") for axis in ("north", "east", "down")]
        first = int(np.flatnonzero(bad)[0])
        raise InputError(
            "input.sd",
            f"a fix with sd = {sd[first]:g} for {names[first]}, {int(bad.sum())} such components",
            "standard deviations are positive; leave out sd to use those of [gnss], or give NaN for the component",
            {"sd": sd.tolist()},
        )


def _vector(values: ArrayLike | None) -> Array | None:
    return None if values is None else _numbers(values, "a fix")


def _numbers(values: ArrayLike, name: str) -> Array:
    """Floats of what was given, or an :class:`InputError`."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as failure:
        raise InputError(
            "input.dtype", f"{name} is not numeric: {failure}", "give three numbers, NaN where one is absent"
        ) from None


def _configured_variances(config: Config) -> Array:
    """Variances (6,) that ``[gnss]`` gives; NaN where it gives none."""
    unknown: Sequence[float] = (np.nan,) * 3
    position, velocity = config.gnss.position_sd_m or unknown, config.gnss.velocity_sd_m_s or unknown
    return np.array([*position, *velocity]) ** 2
