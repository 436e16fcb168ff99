"""What comes out of a run: the columns of the core as a :class:`~gnssins.result.Result`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins.dataset import Dataset, GnssTable
from gnssins.feed import Cut
from gnssins.result import WITHHELD, AidRecords, Covariance, Event, Linearisation, Records, Result, finite
from gnssins.tables import State

__all__ = ["collect", "collect_epochs", "no_epochs"]

EPOCH_COLUMNS: Final = ("t_ns", "lla", "v_n", "rpy", "q_nb", "sd", "x", "x_sd")


def collect(columns: dict[str, Any], dataset: Dataset, cut: Cut, metadata: dict[str, Any]) -> Result:
    """Make the result of a run from what the core gave."""
    counts = {table: dict(values) for table, values in columns["counts"].items()}
    counts["gnss"]["withheld"] = int(cut.withheld.size)
    for name, held in cut.aid_withheld.items():
        if name in counts:
            counts[name]["withheld"] = held
    epochs = collect_epochs(columns, columns["states"])
    return replace(
        epochs,
        records=_records(columns["meas"], dataset.gnss, cut),
        log=_events(columns["events"], columns["meas"], cut),
        counts=counts,
        metadata=metadata,
        final_state=columns["final_state"],
        aids={
            name: _aid_records(columns[name], rows) for name, rows in cut.aid_rows.items() if name in counts
        },
        linearisation=_linearisation(columns.get("lin"), str(metadata["model"]), epochs.states),
    )


def collect_epochs(columns: Mapping[str, Any], states: Sequence[Mapping[str, Any]]) -> Result:
    """Make a result of what the core gives over time, without anything else."""
    none = np.zeros(0, dtype=np.int64)
    marks, unknown, wide = none.astype(np.uint8), np.zeros(0), np.zeros((0, 6))
    fixes = np.zeros((0, 3))
    return Result(
        **{name: columns[name] for name in EPOCH_COLUMNS},
        states=tuple(State(s["name"], s["unit"], s["block"], s["kind"]) for s in states),
        covariance=Covariance(columns["cov_t_ns"], columns["cov"]),
        records=Records(
            none, none, marks, marks, unknown, wide, np.zeros((0, 6, 6)), (), fixes, fixes, marks
        ),
        log=(),
        counts={},
    )


def no_epochs(states: int) -> dict[str, NDArray[Any]]:
    """Columns over time without a row, for a filter of so many states."""
    widths = {"lla": 3, "v_n": 3, "rpy": 3, "q_nb": 4, "sd": 9, "x": states - 9, "x_sd": states - 9}
    none = np.zeros(0, dtype=np.int64)
    columns = {name: np.zeros((0, width)) for name, width in widths.items()}
    return {"t_ns": none, **columns, "cov_t_ns": none, "cov": np.zeros((0, states, states))}


def _aid_records(meas: Mapping[str, Any], rows: NDArray[np.intp]) -> AidRecords:
    """Records of an aid with one value, in the order of its table."""
    return AidRecords(
        row=rows[meas["row"]].astype(np.int64),
        t_ns=meas["t_ns"],
        status=meas["status"],
        nis=meas["nis"],
        innovation=meas["innovation"],
        variance=meas["variance"],
        reason=tuple(meas["reason"]),
    )


def _linearisation(
    columns: Mapping[str, Any] | None, axes: str, states: tuple[State, ...]
) -> Linearisation | None:
    return None if columns is None else Linearisation(axes=axes, states=states, **columns)


def _records(meas: Mapping[str, Any], gnss: GnssTable, cut: Cut) -> Records:
    """Records of the engine and of the withheld rows together, in the order of the GNSS table."""
    fed = cut.fed[meas["row"]]
    row = np.concatenate([fed, cut.withheld])
    order = np.argsort(row, kind="stable")
    held = cut.withheld.size

    def joined(values: NDArray[Any], filler: float) -> NDArray[Any]:
        tail = np.full((held, *values.shape[1:]), filler, dtype=values.dtype)
        return np.concatenate([values, tail])[order]

    reason = [*meas["reason"], *["withheld by [run] outages"] * held]
    row = row[order]
    return Records(
        row=row.astype(np.int64),
        t_ns=cut.valid_ns[row],
        status=joined(meas["status"], WITHHELD),
        dof=joined(meas["dof"], 0),
        nis=joined(meas["nis"], np.nan),
        innovation=joined(meas["innovation"], np.nan),
        innovation_cov=joined(meas["innovation_cov"], np.nan),
        reason=tuple(reason[i] for i in order),
        lla=gnss.lla[row],
        v_n=gnss.v_n[row],
        refused=joined(meas["refused"], 0),
    )


def _events(events: list[dict[str, Any]], meas: Mapping[str, Any], cut: Cut) -> tuple[Event, ...]:
    """Events with the rows of the tables as they were handed in, bad fixes with the reason of their record."""
    reasons = {int(row): reason for row, reason in zip(meas["row"], meas["reason"], strict=True)}
    out = []
    for event in events:
        row, message = int(event["row"]), event["message"]
        if event["code"] == "gnss.bad" and reasons.get(row):
            message = f"{message}: {reasons[row]}"
        if event["code"].startswith("imu."):
            row += cut.imu_first
        elif (aid := event["code"].partition(".")[0]) in cut.aid_rows:
            row = int(cut.aid_rows[aid][row])
        else:
            row = int(cut.fed[row])
        out.append(Event(int(event["t_ns"]), event["code"], row, message, finite(event["value"])))
    return tuple(out)
