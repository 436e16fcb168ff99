"""``gnssins budget``, ``schuler``: what an INS without GNSS can do; one function each."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from gnssins import units
from gnssins.analysis.budget import OUTAGES_S, sensor_budget
from gnssins.analysis.schuler import schuler_curves
from gnssins.outputs import make_folder
from gnssins.storage import write_atomic
from gnssins.terminal import put, put_json

__all__ = ["budget", "schuler"]

#: Files of ``gnssins schuler --out``.
SCHULER_FILES: Final = ("schuler.txt", "schuler.csv", "schuler.png")


def budget(
    position_m: float,
    outage_s: list[float] | None,
    accel_ug: float | None,
    gyro_deg_h: float | None,
    as_json: bool,
) -> None:
    """``gnssins budget``."""
    found = sensor_budget(
        position_m,
        outage_s or OUTAGES_S,
        accel_m_s2=None if accel_ug is None else accel_ug * units.ACCEL_BIAS["ug"],
        gyro_rad_s=None if gyro_deg_h is None else gyro_deg_h * units.GYRO_BIAS["deg/h"],
    )
    if as_json:
        put_json(found.to_dict())
    else:
        put(found.table())


def schuler(out: Path | None, lat_deg: float, as_json: bool) -> None:
    """``gnssins schuler``."""
    found = schuler_curves(lat_deg)
    files: list[Path] = []
    if out is not None:
        from gnssins import plots

        folder = make_folder(out)
        files = [folder / name for name in SCHULER_FILES]
        write_atomic(files[0], lambda path: path.write_text(found.table() + "\n", encoding="utf-8"))
        found.to_frame().write_csv(files[1])
        plots.save(plots.schuler(found), files[2])
    if as_json:
        put_json({**found.to_dict(), "files": [str(file) for file in files]})
        return
    put(found.table())
    for file in files:
        put(f"  {file}")
