"""How the solution drifts while GNSS is away: one row per gap, against a truth or against the withheld fixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.analysis import text
from gnssins.analysis.errors import NavErrors, Track, Trajectory, compare
from gnssins.errors import InputError
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.result import Result

__all__ = ["Outage", "OutageTable", "antenna_track", "outage_table", "withheld_track"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Outage:
    """Errors inside one gap.

    Parameters
    ----------
    start_s, end_s : float
        The gap as configured.
    epochs : int
        Reference epochs inside it; if 0, all errors are NaN.
    max_horizontal_m, rms_horizontal_m, max_vertical_m, rms_vertical_m : float
        Position error over these epochs.
    rms_velocity_m_s : float
        Horizontal velocity error over these epochs; NaN if the reference has no velocity.
    end_position, end_velocity, end_euler : ndarray, shape (3,)
        Errors at the last epoch before GNSS is back: north, east, down (m), (m/s); roll, pitch, heading (rad).
    end_sd : ndarray, shape (9,)
        What the filter claimed there, in this order.
    """

    start_s: float
    end_s: float
    epochs: int
    max_horizontal_m: float
    rms_horizontal_m: float
    max_vertical_m: float
    rms_vertical_m: float
    rms_velocity_m_s: float
    end_position: Array
    end_velocity: Array
    end_euler: Array
    end_sd: Array

    @property
    def end_sigmas(self) -> Array:
        """Errors at the end over their standard deviations, shape (9,)."""
        return np.concatenate([self.end_position, self.end_velocity, self.end_euler]) / self.end_sd


@dataclass(frozen=True, eq=False)
class OutageTable:
    """All gaps of a run and what they have in common.

    ``horizontal_m``, ``vertical_m``, ``velocity_m_s`` are root mean squares over all epochs of all gaps;
    ``max_horizontal_m`` is the root mean square of the largest horizontal error of each gap.
    """

    outages: tuple[Outage, ...]
    horizontal_m: float
    vertical_m: float
    velocity_m_s: float
    max_horizontal_m: float

    def table(self, title: str = "Errors without GNSS") -> str:
        """One line per gap, and the totals."""
        head = [
            "gap, s",
            "horizontal max m",
            "rms m",
            "vertical max m",
            "rms m",
            "velocity rms m/s",
            "end N, E, D m",
            "sd m",
        ]
        rows = [
            [
                f"{o.start_s:.1f} to {o.end_s:.1f}",
                text.number(o.max_horizontal_m),
                text.number(o.rms_horizontal_m),
                text.number(o.max_vertical_m),
                text.number(o.rms_vertical_m),
                text.number(o.rms_velocity_m_s),
                "  ".join(f"{v:+.2f}" for v in o.end_position),
                "  ".join(f"{v:.2f}" for v in o.end_sd[:3]),
            ]
            for o in self.outages
        ]
        caption = (
            f"{len(self.outages)} gaps: horizontal {text.number(self.horizontal_m)} m rms, "
            f"{text.number(self.max_horizontal_m)} m rms of the largest; vertical {text.number(self.vertical_m)} m; "
            f"velocity {text.number(self.velocity_m_s)} m/s"
        )
        return text.table(title, head, rows, caption)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, units in the names; None where unknown."""
        return {
            "horizontal_m": _number(self.horizontal_m),
            "vertical_m": _number(self.vertical_m),
            "velocity_m_s": _number(self.velocity_m_s),
            "max_horizontal_m": _number(self.max_horizontal_m),
            "outages": [
                {
                    "start_s": o.start_s,
                    "end_s": o.end_s,
                    "epochs": o.epochs,
                    "max_horizontal_m": _number(o.max_horizontal_m),
                    "rms_horizontal_m": _number(o.rms_horizontal_m),
                    "max_vertical_m": _number(o.max_vertical_m),
                    "rms_vertical_m": _number(o.rms_vertical_m),
                    "rms_velocity_m_s": _number(o.rms_velocity_m_s),
                    "end_position_m": [_number(v) for v in o.end_position],
                    "end_velocity_m_s": [_number(v) for v in o.end_velocity],
                    "end_position_sd_m": [_number(v) for v in o.end_sd[:3]],
                    "end_velocity_sd_m_s": [_number(v) for v in o.end_sd[3:6]],
                }
                for o in self.outages
            ],
        }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def outage_table(
    result: Result,
    truth: Trajectory | None = None,
    windows_s: Sequence[tuple[float, float]] | None = None,
    *,
    ellipsoid: str | None = None,
) -> OutageTable:
    """Errors inside the gaps of a run.

    An epoch counts if it lies in the window and before the first fix that the filter used after the window began:
    what is measured is coasting, never the correction that ends it.

    Parameters
    ----------
    result : Result
        Of a run with gaps.
    truth : Trajectory, optional
        Reference at the IMU. Left out: the withheld fixes, compared at the antenna (lever arm of the run).
    windows_s : sequence of (float, float), optional
        Gaps, seconds; left out: those of the configuration (``[run] outages``).
    ellipsoid : str, optional
        Left out: that of the run.

    Returns
    -------
    OutageTable

    Raises
    ------
    InputError
        No gaps, or no reference epoch inside any of them.
    """
    windows = gap_windows(result, windows_s)
    ellipsoid = ellipsoid or str(result.metadata.get("ellipsoid", "wgs84"))
    if truth is None:
        found = compare(antenna_track(result, ellipsoid), withheld_track(result), ellipsoid=ellipsoid)
        found = _with_sd(found, result)
    else:
        found = compare(result, truth, ellipsoid=ellipsoid)
    used = result.records.t_ns[result.records.is_status("used")]
    rows, inside = [], []
    for start, end in windows:
        first_used = used[used >= start].min(initial=np.iinfo(np.int64).max)
        keep = (found.t_ns >= start) & (found.t_ns <= end) & (found.t_ns < first_used)
        inside.append(keep)
        rows.append(_outage(found, keep, float(start / NS_PER_S), float(end / NS_PER_S)))
    together = np.logical_or.reduce(inside)
    if not together.any():
        raise InputError(
            "input.no_overlap",
            f"no reference epoch inside any of the {len(windows)} gaps",
            "the gaps must lie inside the run, and the reference must cover them",
        )
    return OutageTable(
        outages=tuple(rows),
        horizontal_m=_rms(np.hypot(*found.position[together, :2].T)),
        vertical_m=_rms(found.position[together, 2]),
        velocity_m_s=_rms(np.hypot(*found.velocity[together, :2].T)),
        max_horizontal_m=_rms(np.array([o.max_horizontal_m for o in rows])),
    )


def _outage(found: NavErrors, keep: NDArray[np.bool_], start_s: float, end_s: float) -> Outage:
    position, velocity = found.position[keep], found.velocity[keep]
    horizontal = np.hypot(position[:, 0], position[:, 1])
    if not keep.any():
        unknown, nan = np.full(9, np.nan), float("nan")
        return Outage(
            start_s, end_s, 0, nan, nan, nan, nan, nan, unknown[:3], unknown[:3], unknown[:3], unknown
        )
    last = np.flatnonzero(keep)[-1]
    return Outage(
        start_s=start_s,
        end_s=end_s,
        epochs=int(keep.sum()),
        max_horizontal_m=float(horizontal.max()),
        rms_horizontal_m=_rms(horizontal),
        max_vertical_m=float(np.abs(position[:, 2]).max()),
        rms_vertical_m=_rms(position[:, 2]),
        rms_velocity_m_s=_rms(np.hypot(velocity[:, 0], velocity[:, 1])),
        end_position=found.position[last],
        end_velocity=found.velocity[last],
        end_euler=found.euler[last],
        end_sd=found.sd[last],
    )


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def gap_windows(result: Result, windows_s: Sequence[tuple[float, float]] | None) -> NDArray[np.int64]:
    """Gaps to look at (o, 2), ns: those given in seconds, else those of the run.

    Raises
    ------
    InputError
        ``input.no_outages``: there are none.
    """
    if windows_s is None:
        windows = result.outages()
    else:
        windows = np.rint(np.asarray(windows_s, dtype=np.float64).reshape(-1, 2) * NS_PER_S).astype(np.int64)
    if not len(windows):
        raise InputError(
            "input.no_outages",
            "the run has no gaps to look at",
            "give [run] outages = [[from_s, to_s], ...] in the configuration, or windows_s",
        )
    return windows


def withheld_track(result: Result) -> Track:
    """The fixes that the configuration kept from the filter, at the antenna; attitude unknown.

    Raises
    ------
    InputError
        None was withheld.
    """
    held = result.records.is_status("withheld") & np.isfinite(result.records.lla).all(axis=1)
    if not held.any():
        raise InputError(
            "input.no_reference",
            "no truth was given and no fix was withheld",
            "give a truth, or [run] outages in the configuration",
        )
    r = result.records
    order = np.flatnonzero(held)[np.argsort(r.t_ns[held], kind="stable")]
    return Track(r.t_ns[order], r.lla[order], r.v_n[order], np.full((order.size, 4), np.nan))


def antenna_track(result: Result, ellipsoid: str = "wgs84") -> Track:
    """The trajectory of the antenna: p + C l, v + C (w x l), w from the change of attitude between epochs.

    The lever arm is that of the configuration plus the estimate of lever-arm states, if the filter has them.
    """
    lever = np.tile(np.asarray(result.metadata.get("lever_ba_b_m", (0.0, 0.0, 0.0))), (len(result), 1))
    kinds = np.array([s.kind == "gnss_lever_arm" for s in result.block_states], dtype=np.bool_)
    if kinds.any():
        lever = lever + result.x[:, kinds].reshape(len(result), -1, 3).sum(axis=1)
    if not lever.any():
        return Track(result.t_ns, result.lla, result.v_n, result.q_nb)
    c_nb = _core.quat_to_dcm(result.q_nb)
    offset = np.einsum("kij,kj->ki", c_nb, lever)
    radii = _core.radii(np.ascontiguousarray(result.lla[:, 0]), ellipsoid) + result.lla[:, 2:3]
    lla = result.lla.copy()
    lla[:, 0] += offset[:, 0] / radii[:, 0]
    lla[:, 1] += offset[:, 1] / (radii[:, 1] * np.cos(result.lla[:, 0]))
    lla[:, 2] -= offset[:, 2]
    turning = np.cross(_body_rate(result), lever)
    return Track(result.t_ns, lla, result.v_n + np.einsum("kij,kj->ki", c_nb, turning), result.q_nb)


def _body_rate(result: Result) -> Array:
    """Angular rate of b against n in b (rad/s), (k, 3), from neighbouring epochs; the last one repeats."""
    if len(result) < 2:
        return np.zeros((len(result), 3))
    first = result.q_nb[:-1] * np.array([1.0, -1.0, -1.0, -1.0])
    turn = _core.quat_to_rotvec(_core.quat_mul(first, np.ascontiguousarray(result.q_nb[1:])))
    rate = turn / (np.diff(result.t_ns) / NS_PER_S)[:, None]
    return np.vstack([rate, rate[-1:]])


def _with_sd(found: NavErrors, result: Result) -> NavErrors:
    """The standard deviations of the run at the epochs of the errors."""
    at = np.clip(np.searchsorted(result.t_ns, found.t_ns, side="right") - 1, 0, len(result) - 1)
    return NavErrors(found.t_ns, found.position, found.velocity, found.phi, found.euler, result.sd[at])
