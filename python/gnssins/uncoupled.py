"""Separated operation: INS and GNSS side by side without a filter, the baseline of every coupled scheme.

The INS runs free and keeps its own attitude; GNSS restarts it or holds it, an outer height tames its vertical channel.
Nothing estimates sensor errors, so every outage shows them in full. The result is an ordinary
:class:`gnssins.Result` without standard deviations, for :func:`gnssins.analysis.compare`,
:func:`gnssins.analysis.outage_table` and the figures.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.analysis.errors import ned_difference
from gnssins.dataset import Dataset
from gnssins.errors import ConfigError, InputError
from gnssins.increments import increments_after, joined, output_rows
from gnssins.result import STATUS, WITHHELD, Covariance, Records, Result
from gnssins.runner import Start, as_initial, versions
from gnssins.tables import State, wrap_pi
from gnssins.units import NS_PER_S, ms_to_ns, seconds_to_ns

if TYPE_CHECKING:
    from gnssins.alignment import InitialState
    from gnssins.sim import Simulated

__all__ = ["MODES", "Mode", "separated"]

Array = NDArray[np.float64]
Times = NDArray[np.int64]

Mode = Literal["free", "restart", "restart-at-gap", "slaved"]
Vertical = Literal["free", "gnss", "baro"]

#: All modes.
MODES: Final[tuple[Mode, ...]] = get_args(Mode)

_USED, _REJECTED, _LATE, _BAD = (STATUS.index(name) for name in ("used", "rejected", "late", "bad"))
_NAVIGATION: Final = tuple(
    State(f"{name}_{axis}", unit, "navigation", "navigation")
    for name, unit in (("phi", "rad"), ("dv", "m/s"), ("dp", "m"))
    for axis in "ned"
)


@dataclass(frozen=True)
class _Setup:
    """What the run needs to know beside the data."""

    mode: Mode
    period_ns: int
    position_time_s: float
    velocity_time_s: float
    windows_ns: tuple[tuple[int, int], ...]
    lever_b: Array
    latency_ns: int
    vertical: Vertical
    vertical_tau_s: float | None
    equations: Mapping[str, str]
    interval_ns: int


def separated(
    data: Dataset | Simulated,
    mode: Mode = "slaved",
    *,
    initial: Start | None = None,
    outages: Sequence[tuple[float, float]] | None = None,
    period_s: float = 0.0,
    position_time_s: float = 10.0,
    velocity_time_s: float = 10.0,
    vertical: Vertical = "gnss",
    vertical_tau_s: float | None = 20.0,
    height: tuple[Times, Array] | None = None,
    lever_ba_b_m: Sequence[float] | None = None,
    latency_ms: float | None = None,
    equations: Mapping[str, str] | None = None,
    output_rate_hz: float | None = None,
) -> Result:
    """Run a free INS beside GNSS, without a filter.

    Parameters
    ----------
    data : Dataset or Simulated
        IMU and fixes. A simulation brings its initial state with drawn errors, its outages, lever arm, latency and
        the equations of its truth.
    mode : {"free", "restart", "restart-at-gap", "slaved"}
        ``"free"``: GNSS touches nothing horizontal. ``"restart"``: position and velocity are set to the fix, every
        ``period_s`` or at every fix. ``"restart-at-gap"``: the INS runs free from its initial state and is set to the
        last fix before each outage, once. ``"slaved"``: a share ``1 - exp(-dt/T)`` of the difference to every fix is
        taken out. The attitude is the INS's own in every mode.
    initial : InitialState, mapping, optional
        State to start from; needed for a recording, see :func:`gnssins.initial_state`.
    outages : sequence of (from, to), optional
        Times of validity [from, to) without fixes, s; fixes in them are withheld. Left out: those of the simulation.
    period_s : float
        ``"restart"``: least time between two restarts, s; 0: every fix.
    position_time_s, velocity_time_s : float
        ``"slaved"``: time constants T of position and velocity, s; 0 takes the whole difference out.
    vertical : {"gnss", "baro", "free"}
        Outer height of the vertical channel: that of the fixes (none in an outage), a barometer, or none. With one,
        ``"slaved"`` leaves the vertical to it; restarts set all three axes in any case.
    vertical_tau_s : float or None
        Time constant of the third-order loop of the vertical channel, s; None: the outer height replaces the own one.
    height : (t_ns, height_m), optional
        Readings of the barometer at their times of validity, shapes (b,); left out: those of the dataset.
    lever_ba_b_m : sequence of float, optional
        Antenna from the IMU, body axes (m); left out: that of the simulation, else 0.
    latency_ms : float, optional
        Taken off the stamps of the fixes; left out: that of the simulation, else 0.
    equations : mapping, optional
        ``model``, ``ellipsoid``, ``gravity``, ``coning``, ``attitude_form``, where they differ from those of the
        simulation, or from the defaults of ``[filter]``.
    output_rate_hz : float, optional
        Rate of the result; left out: every IMU row.

    Returns
    -------
    Result
        Standard deviations are NaN, there are no block states and no covariance. Records hold the difference of each
        fix to the INS as ``innovation``; a fix that the mode does not use is ``"rejected"`` with the reason.

    Raises
    ------
    ConfigError
        An unknown mode or figure out of range, ``"restart-at-gap"`` without outages.
    InputError
        No initial state, no IMU row after it, no height readings for ``vertical = "baro"``.

    Notes
    -----
    The difference to a fix is formed at its time of validity, the INS taken as linear between its samples, and taken
    out at the next sample. Of several fixes within one IMU interval the last counts.

    Height readings are joined by straight lines, across 2.5 usual intervals at most. The height of an antenna is
    brought to the IMU with the arm of a level vehicle.
    """
    dataset, start, common = _inputs(data, initial)
    given = dict(common["equations"]) | dict(equations or {})
    windows = common["outages"] if outages is None else outages
    setup = _Setup(
        mode=mode,
        period_ns=seconds_to_ns(period_s),
        position_time_s=position_time_s,
        velocity_time_s=velocity_time_s,
        windows_ns=tuple((seconds_to_ns(a), seconds_to_ns(b)) for a, b in windows),
        lever_b=np.asarray(common["lever"] if lever_ba_b_m is None else lever_ba_b_m, dtype=np.float64),
        latency_ns=ms_to_ns(common["latency_ms"] if latency_ms is None else latency_ms),
        vertical=vertical,
        vertical_tau_s=vertical_tau_s,
        equations=given,
        interval_ns=0 if output_rate_hz is None else seconds_to_ns(1.0 / output_rate_hz),
    )
    _check(setup)
    return _Run(dataset, start, setup, height).result()


def _inputs(data: Dataset | Simulated, initial: Start | None) -> tuple[Dataset, InitialState, dict[str, Any]]:
    equations = {
        "model": "ned",
        "ellipsoid": "wgs84",
        "gravity": "normal",
        "coning": "two-sample",
        "attitude_form": "rotation-vector",
    }
    common: dict[str, Any] = {
        "equations": equations,
        "outages": (),
        "lever": np.zeros(3),
        "latency_ms": 0.0,
    }
    if isinstance(data, Dataset):
        if initial is None:
            raise InputError(
                "input.initial",
                "a recording needs an initial state",
                "give initial=gnssins.initial_state(config, dataset)",
            )
        return data, as_initial(initial), common
    truth, gnss = data.scenario.truth, data.scenario.gnss
    for key in ("model", "ellipsoid", "gravity", "coning"):
        equations[key] = str(getattr(truth, key))
    common["outages"] = data.outages
    if gnss is not None:
        common |= {"lever": gnss.lever_ba_b_m, "latency_ms": gnss.latency_ms}
    return data.dataset, as_initial(initial) if initial is not None else data.initial, common


def _check(setup: _Setup) -> None:
    if setup.mode not in MODES:
        known = ", ".join(MODES)
        raise ConfigError("config.choice", f'mode "{setup.mode}" is not known', f"use one of {known}")
    if setup.vertical not in get_args(Vertical):
        known = ", ".join(get_args(Vertical))
        raise ConfigError("config.choice", f'vertical "{setup.vertical}" is not known', f"use one of {known}")
    figures = {"position_time_s": setup.position_time_s, "velocity_time_s": setup.velocity_time_s}
    for name, value in {**figures, "period_s": setup.period_ns / NS_PER_S}.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ConfigError("config.range", f"{name} = {value}: must be finite and at least 0")
    if setup.mode == "restart-at-gap" and not setup.windows_ns:
        raise ConfigError(
            "config.missing_key",
            'mode "restart-at-gap" without outages',
            "give outages=[(from_s, to_s), ...], or simulate a variant that has them",
        )


class _Run:
    """One run: increments, the fixes that count, and the track as it grows."""

    def __init__(
        self, dataset: Dataset, start: InitialState, setup: _Setup, height: tuple[Times, Array] | None
    ) -> None:
        self.start, self.setup = start, setup
        self.imu_rows = len(dataset.imu)
        self.t_ns, self.dtheta, self.dvel = increments_after(dataset.imu, start.t_ns)
        self.gnss = dataset.gnss
        self.valid_ns = self.gnss.t_ns - setup.latency_ns
        self.meta = dataset.meta
        self.height = self._heights(dataset, height)
        form = {"attitude_form": setup.equations["attitude_form"]}
        names = (setup.equations[key] for key in ("model", "ellipsoid", "gravity", "coning"))
        model, ellipsoid, gravity, coning = names
        self.ellipsoid = ellipsoid
        self.ins = _core.FreeIns(
            model,
            ellipsoid,
            gravity,
            coning,
            start.t_ns,
            start.lla,
            start.v_n,
            start.q_nb,
            attitude_form=form["attitude_form"],
            vertical_tau_s=setup.vertical_tau_s,
        )
        rows = self.t_ns.size
        self.lla, self.v_n, self.q_nb = np.empty((rows, 3)), np.empty((rows, 3)), np.empty((rows, 4))
        self.done = 0
        self.innovation = np.full((len(self.gnss), 6), np.nan)
        self.status = np.full(len(self.gnss), _LATE, dtype=np.uint8)
        self.reason = ["valid outside the time span of the INS"] * len(self.gnss)

    def result(self) -> Result:
        """Run to the end."""
        used_ns: int | None = None
        usable = self._usable()
        chosen = self._chosen(usable)
        for row in usable:
            take = row in chosen
            if self.setup.mode == "restart" and used_ns is not None:
                # a tenth of an interval of grace: stamps of a receiver are not exact
                take = self.valid_ns[row] - used_ns >= 0.999 * self.setup.period_ns
            if take:
                elapsed = (self.valid_ns[row] - (self.start.t_ns if used_ns is None else used_ns)) / NS_PER_S
                self._correct(int(row), float(elapsed))
                used_ns = int(self.valid_ns[row])
                self.status[row], self.reason[row] = _USED, ""
            else:
                self.status[row] = _REJECTED
                self.reason[row] = f"mode {self.setup.mode} does not use it"
        self._advance(self.t_ns.size)
        return self._result()

    def _usable(self) -> NDArray[np.intp]:
        """Fixes that the INS could be set to, in order of time; marks all others."""
        inside = (self.valid_ns > self.start.t_ns) & (self.valid_ns <= self.t_ns[-1])
        held = self._held()
        good = self.gnss.has_position
        for row in np.flatnonzero(inside & ~good):
            self.status[row], self.reason[row] = _BAD, "no position"
        for row in np.flatnonzero(inside & held):
            self.status[row], self.reason[row] = WITHHELD, "withheld by the outages"
        rows = np.flatnonzero(inside & good & ~held)
        rows = rows[np.argsort(self.valid_ns[rows], kind="stable")]
        interval = np.searchsorted(self.t_ns, self.valid_ns[rows])
        last = np.append(interval[1:] != interval[:-1], True) if rows.size else np.zeros(0, dtype=np.bool_)
        for row in rows[~last]:
            self.status[row], self.reason[row] = _REJECTED, "another fix follows within the IMU interval"
        return np.asarray(rows[last])

    def _held(self) -> NDArray[np.bool_]:
        held = np.zeros(self.valid_ns.size, dtype=np.bool_)
        for begin, end in self.setup.windows_ns:
            held |= (self.valid_ns >= begin) & (self.valid_ns < end)
        return held

    def _chosen(self, usable: NDArray[np.intp]) -> set[int]:
        """Rows that the mode uses, apart from the period of restarts."""
        if self.setup.mode == "free":
            return set()
        if self.setup.mode != "restart-at-gap":
            return set(usable.tolist())
        before = [usable[self.valid_ns[usable] < begin] for begin, _ in self.setup.windows_ns]
        return {int(rows[-1]) for rows in before if rows.size}

    def _advance(self, end: int) -> None:
        """Integrate up to, not including, row ``end`` of the increments."""
        part = slice(self.done, end)
        if end > self.done:
            height = None if self.height is None else self.height[part]
            rows = self.ins.run(self.t_ns[part], self.dtheta[part], self.dvel[part], height)
            self.lla[part], self.v_n[part], self.q_nb[part] = rows
            self.done = end

    def _correct(self, row: int, elapsed_s: float) -> None:
        """Take the difference to a fix out at the first sample at or after it."""
        k = int(np.searchsorted(self.t_ns, self.valid_ns[row]))
        self._advance(k + 1)
        position, velocity = self._difference(row, k)
        self.innovation[row] = np.concatenate([-position, -velocity])
        share = np.ones(2)
        if self.setup.mode == "slaved":
            times = (self.setup.position_time_s, self.setup.velocity_time_s)
            share = np.array([1.0 if t == 0.0 else -math.expm1(-elapsed_s / t) for t in times])
            if self.height is not None:
                position[2] = velocity[2] = 0.0
        velocity = np.where(np.isfinite(velocity), velocity, 0.0)
        self.lla[k] = self._moved(self.lla[k], -share[0] * position, self.gnss.lla[row])
        self.v_n[k] = self.v_n[k] - share[1] * velocity
        self.ins.restart(self.lla[k], self.v_n[k])

    def _difference(self, row: int, k: int) -> tuple[Array, Array]:
        """INS minus fix at the antenna, at the time of the fix, along north, east, down: m, m/s."""
        if k > 0:
            before = self.t_ns[k - 1], self.lla[k - 1], self.v_n[k - 1]
        else:
            before = np.int64(self.start.t_ns), self.start.lla, self.start.v_n
        back = float((self.t_ns[k] - self.valid_ns[row]) / (self.t_ns[k] - before[0]))
        c_nb = _core.quat_to_dcm(self.q_nb[k : k + 1])[0]
        dt_s = float(self.t_ns[k] - before[0]) / NS_PER_S
        swing = c_nb @ np.cross(self.dtheta[k] / dt_s, self.setup.lever_b)
        fix = self.gnss.lla[row : row + 1]
        # differences of both ends, so that a longitude may wrap in between
        ends = [
            ned_difference(lla[None], fix, self.ellipsoid)[0] + c_nb @ self.setup.lever_b
            for lla in (self.lla[k], before[1])
        ]
        position = ends[0] + back * (ends[1] - ends[0])
        velocity = self.v_n[k] + back * (before[2] - self.v_n[k]) + swing - self.gnss.v_n[row]
        return np.asarray(position), np.asarray(velocity)

    def _moved(self, lla: Array, ned_m: Array, at: Array) -> Array:
        """Position moved along the coordinate lines, metres counted at ``at``: undoes :func:`ned_difference`."""
        radii = _core.radii(at[:1].copy(), self.ellipsoid)[0] + at[2]
        step = [ned_m[0] / radii[0], ned_m[1] / (radii[1] * math.cos(at[0])), -ned_m[2]]
        moved = lla + step
        moved[1] = wrap_pi(moved[1])
        return np.asarray(moved)

    def _heights(self, dataset: Dataset, given: tuple[Times, Array] | None) -> Array | None:
        """Outer height at the stamps of the increments, NaN where there is none; None for a free channel."""
        if self.setup.vertical == "free":
            return None
        if self.setup.vertical == "gnss":
            keep = np.isfinite(self.gnss.lla[:, 2]) & ~self._held()
            return joined(self.t_ns, self.valid_ns[keep], self.gnss.lla[keep, 2] + self.setup.lever_b[2])
        if given is None:
            given = dataset.baro.t_ns, dataset.baro.height_m
        if not given[0].size:
            raise InputError(
                "input.no_height",
                'vertical = "baro", but there are no height readings',
                'give height=(t_ns, height_m), or use vertical = "gnss"',
            )
        return joined(self.t_ns, given[0], given[1])

    def _result(self) -> Result:
        rows = output_rows(self.t_ns, self.setup.interval_ns)
        t_ns, q_nb = self.t_ns[rows], np.ascontiguousarray(self.q_nb[rows])
        seen = np.arange(len(self.gnss))
        counts = {name: int((self.status == i).sum()) for i, name in enumerate(STATUS)}
        records = Records(
            row=seen.astype(np.int64),
            t_ns=self.valid_ns,
            status=self.status,
            refused=np.zeros(seen.size, dtype=np.uint8),
            dof=np.isfinite(self.innovation).sum(axis=1).astype(np.uint8),
            nis=np.full(seen.size, np.nan),
            innovation=self.innovation,
            innovation_cov=np.full((seen.size, 6, 6), np.nan),
            reason=tuple(self.reason),
            lla=self.gnss.lla,
            v_n=self.gnss.v_n,
        )
        integrated = int(self.t_ns.size)
        imu = {"in": self.imu_rows, "used": integrated, "rejected": 0, "bad": 0}
        imu["late"] = self.imu_rows - integrated
        return Result(
            t_ns=t_ns,
            lla=self.lla[rows],
            v_n=self.v_n[rows],
            rpy=np.asarray(_core.quat_to_euler(q_nb)),
            q_nb=q_nb,
            sd=np.full((t_ns.size, 9), np.nan),
            x=np.zeros((t_ns.size, 0)),
            x_sd=np.zeros((t_ns.size, 0)),
            states=_NAVIGATION,
            covariance=Covariance(np.zeros(0, dtype=np.int64), np.zeros((0, 9, 9))),
            records=records,
            log=(),
            counts={"imu": imu, "gnss": {"in": int(seen.size), **counts}},
            metadata=self._metadata(),
        )

    def _metadata(self) -> dict[str, Any]:
        setup = self.setup
        about: dict[str, Any] = {
            "mode": setup.mode,
            "vertical": setup.vertical,
            "equations": dict(setup.equations),
        }
        if setup.mode == "slaved":
            about |= {"position_time_s": setup.position_time_s, "velocity_time_s": setup.velocity_time_s}
        if setup.mode == "restart":
            about["period_s"] = setup.period_ns / NS_PER_S
        if setup.vertical != "free" and setup.vertical_tau_s is not None:
            about["vertical_tau_s"] = setup.vertical_tau_s
        run = {key: self.meta[key] for key in ("scenario", "variant", "seed") if key in self.meta}
        return {
            "run": run,
            "versions": versions(),
            "ellipsoid": self.ellipsoid,
            "lever_ba_b_m": setup.lever_b.tolist(),
            "outages_ns": [list(window) for window in setup.windows_ns],
            "separated": about,
        }
