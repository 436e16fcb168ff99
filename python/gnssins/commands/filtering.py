"""``gnssins demo``, ``simulate``, ``run``, ``compare``: one function each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from gnssins import _core, export
from gnssins.alignment import InitialState
from gnssins.analysis import compare as compare_tracks
from gnssins.analysis import nis, outage_table
from gnssins.config import Config, TruthConfig
from gnssins.dataset import Dataset, TruthTable
from gnssins.errors import InputError
from gnssins.io import format_of, read_dataset
from gnssins.outputs import FIGURE_FILES, RESULT_FILES, refuse_inputs, refuse_no_folder
from gnssins.pieces import run_pieces as filter_pieces
from gnssins.result import Result
from gnssins.runner import run as run_filter
from gnssins.terminal import heading, message, progress, put, put_json
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.analysis import NavErrors
    from gnssins.checks import Finding

__all__ = ["compare", "demo", "list_scenarios", "run", "run_in_pieces", "simulate"]

#: Files of ``--csv``: trajectory and fixes.
TABLE_FILES: Final = ("navigation.csv", "measurements.csv")

#: File of ``--kml``.
KML_FILE: Final = "track.kml"


def demo(out: Path, seed: int, as_json: bool) -> None:
    """``gnssins demo``."""
    from gnssins import demo as demonstration

    report = demonstration.run_demo(out, seed)
    if as_json:
        put_json(report.to_dict())
    else:
        put(report.text())


def list_scenarios(as_json: bool) -> None:
    """``gnssins simulate --list``."""
    from gnssins.analysis.text import table
    from gnssins.sim import load_scenario, scenario_names

    scenarios = [load_scenario(name) for name in scenario_names()]
    if as_json:
        rows = [
            {"name": s.name, "description": s.scenario.description, "variants": list(s.variant)}
            for s in scenarios
        ]
        put_json({"scenarios": rows})
        return
    cells = [[s.name, ", ".join(s.variant) or "-", s.scenario.description] for s in scenarios]
    put(table("", ["scenario", "variants", "description"], cells, left=(0, 1, 2)))


def simulate(scenario: str, out: Path | None, seed: int, variant: str | None, as_json: bool) -> None:
    """``gnssins simulate``."""
    from gnssins.sim import load_scenario
    from gnssins.sim import simulate as simulate_run
    from gnssins.simfiles import output_files, write_simulation

    model = load_scenario(scenario)
    folder = out if out is not None else Path(model.name)
    refuse_no_folder(folder)
    refuse_inputs(output_files(model, folder), [scenario])
    simulated = simulate_run(model, seed, variant=variant)
    files = write_simulation(simulated, folder)
    imu, gnss = simulated.dataset.imu, simulated.dataset.gnss
    aids = {"heights": len(simulated.dataset.baro), "headings": len(simulated.dataset.heading)}
    if as_json:
        counts = {"imu": len(imu), "gnss": len(gnss), "baro": aids["heights"], "heading": aids["headings"]}
        put_json({"scenario": simulated.scenario.name, "seed": seed, "rows": counts, "files": files})
        return
    rows = [f"{len(imu)} IMU rows over {imu.duration_s:.1f} s", f"{len(gnss)} fixes"]
    rows += [f"{count} {name}" for name, count in aids.items() if count]
    put(f"{simulated.scenario.name}, seed {seed}: {', '.join(rows)}")
    for file in files:
        put(f"  {file}")
    put(f"Next: gnssins run {files[-1]}")


def run(path: Path, out: Path | None, csv: bool, kml: bool, figures: bool, as_json: bool) -> None:
    """``gnssins run``."""
    config = Config.load(path)
    folder = out if out is not None else Path(f"{path.stem}-result")
    refuse_no_folder(folder)
    names = [*RESULT_FILES, *([*TABLE_FILES] if csv else []), *([KML_FILE] if kml else [])]
    names += FIGURE_FILES if figures else ()
    inputs = [path, config.imu.file, config.gnss.file, config.truth.file]
    refuse_inputs([folder / name for name in names], inputs)
    data = read_dataset(config)
    with progress("filter") as bar:
        result = run_filter(config, data, progress=bar, told=None if as_json else _tell)
    files = _write(result, data, folder, csv, kml, figures)
    report = _summary(result, config, data, files)
    if as_json:
        put_json({"config": str(path), "out": str(folder), **report})
        return
    put(repr(result))
    put(start_line(result, config))
    put(f"filtered in {result.metadata['run']['filter_s']:.2f} s")
    put("\n".join(_count_lines(result)))
    for title, text in _tables(result, config, data):
        heading(title)
        put(text)
    heading("Written")
    put("\n".join(f"  {file}" for file in files))


def run_in_pieces(path: Path, out: Path | None, rows: int, as_json: bool) -> None:
    """``gnssins run --chunk-rows``."""
    config = Config.load(path)
    folder = out if out is not None else Path(f"{path.stem}-result")
    refuse_no_folder(folder)
    inputs = [path, config.imu.file, config.gnss.file, config.truth.file]
    refuse_inputs([folder / name for name in RESULT_FILES], inputs)
    with progress("filter") as bar:
        result = filter_pieces(path, folder, rows=rows, progress=bar, told=None if as_json else _tell)
    files = [str(folder / name) for name in RESULT_FILES]
    joint = nis(result)
    if as_json:
        report = {
            "start": _start(result),
            "states": [state.name for state in result.states],
            "counts": result.counts,
            "events": result.event_counts(),
            "findings": result.metadata["finding"],
            "times": {k: v for k, v in result.metadata["run"].items() if k.endswith("_s")},
            "nis": joint.to_dict(),
            "files": files,
        }
        put_json({"config": str(path), "out": str(folder), **report})
        return
    put(start_line(result, config))
    put(f"read and filtered in {result.metadata['run']['filter_s']:.2f} s, {rows} IMU rows at a time")
    put("\n".join(_count_lines(result)))
    if joint.groups:
        heading("NIS of the fixes, before the gate")
        put(joint.table(""))
    heading("Written")
    put("\n".join(f"  {file}" for file in files))


def _tell(findings: list[Finding]) -> None:
    """Print what the look at the data has found, before the filter starts; an error repeats the stops."""
    for finding in findings:
        text = f"{finding.level}: {finding.message}"
        message(f"{text}\n  hint: {finding.hint}" if finding.hint else text, "yellow")


def _write(result: Result, data: Dataset, folder: Path, csv: bool, kml: bool, figures: bool) -> list[str]:
    """Save the result and what else was asked for; the files in the order of their use.

    Pictures that an earlier run left in the folder go: they would show another result.
    """
    if any((folder / name).is_file() for name in RESULT_FILES):  # else the pictures there are not ours
        for name in FIGURE_FILES:
            (folder / name).unlink(missing_ok=True)
    result.save(folder)
    files = [folder / name for name in RESULT_FILES]
    if csv:
        files.append(result.to_csv(folder / TABLE_FILES[0]))
        files.append(export.write_csv(result.measurements, folder / TABLE_FILES[1]))
    if kml:
        files.append(result.to_kml(folder / KML_FILE, name=folder.name))
    if figures:
        files += draw_figures(result, folder, _compared(result, data.truth), data.truth)
    return [str(file) for file in files]


def draw_figures(
    result: Result, folder: Path, errors: NavErrors | None = None, truth: TruthTable | None = None
) -> list[Path]:
    """Draw every figure that the data allow, as PNG in ``folder``."""
    from gnssins import plots

    made = {
        "track": plots.track(result, truth),
        "innovations": plots.innovations(result),
        "nis": plots.nis(result),
    }
    if result.block_states:
        made["biases"] = plots.biases(result)
    if errors is not None and len(errors):
        made["position_errors"] = plots.position_errors(errors, result.outages())
        made["velocity_errors"] = plots.velocity_errors(errors, result.outages())
        made["attitude_errors"] = plots.attitude_errors(errors, result.outages())
    return [plots.save(figure, folder / f"{name}.png") for name, figure in made.items()]


def _compared(result: Result, truth: TruthTable | None) -> NavErrors | None:
    if truth is None or not len(truth):
        return None
    return compare_tracks(result, truth, ellipsoid=str(result.metadata["ellipsoid"]))


def start_line(result: Result, config: Config) -> str:
    """One line about the state that the filter started from, and where its parts come from."""
    start, initial = _start(result), config.initial
    asked = "" if config.run.start_s is None else f" (asked {config.run.start_s:.1f} s)"
    course = "given" if initial.heading_deg is not None else "from the course"
    tilt = "given" if initial.roll_deg is not None else "from the accelerometer"
    return (
        f"Started at {start['time_s']:.3f} s{asked}: heading {start['heading_deg']:.1f} deg, "
        f"sd {start['heading_sd_deg']:.1f} deg, {course}; "
        f"roll {start['roll_deg']:.1f} deg, pitch {start['pitch_deg']:.1f} deg, {tilt}"
    )


def _start(result: Result) -> dict[str, float]:
    """The initial state that the engine got: time and attitude."""
    start = InitialState.from_engine(json.loads(result.metadata["engine"]["json"])["initial"])
    roll, pitch, yaw = np.degrees(_core.quat_to_euler(start.q_nb[None])[0])
    return {
        "time_s": start.t_ns / NS_PER_S,
        "roll_deg": float(roll),
        "pitch_deg": float(pitch),
        "heading_deg": float(yaw % 360.0),
        "heading_sd_deg": float(np.degrees(start.sd_phi[2])),
    }


def _count_lines(result: Result) -> list[str]:
    lines = []
    for table, name in (("imu", "IMU"), ("gnss", "GNSS"), ("baro", "barometer"), ("heading", "heading")):
        if table not in result.counts:
            continue
        counts = dict(result.counts[table])
        used = counts["used"]
        total, held = counts.pop("in"), counts.pop("withheld", 0)
        parts = " + ".join(f"{count} {what}" for what, count in counts.items())
        lines.append(f"{name} rows: {total} in = {parts}" + (f"; {held} withheld" if held else ""))
        if 2 * used < total:
            lines.append(
                f"  more than half of the {name} rows were not used: see events.csv and the hints above"
            )
    parted = int(np.count_nonzero(result.records.refused[result.records.is_status("used")]))
    if parted:
        lines.append(f"  of the GNSS rows used, {parted} lost position or velocity to a test")
    events = result.event_counts()
    if events:
        lines.append("events: " + ", ".join(f"{count} {code}" for code, count in events.items()))
    return lines


def _tables(result: Result, config: Config, data: Dataset) -> list[tuple[str, str]]:
    """Titles and texts of what can be said about the accuracy."""
    out = []
    errors = _compared(result, data.truth)
    if errors is not None and len(errors):
        out.append(("Against the reference", errors.rmse().table("Root mean square")))
    if _withheld(result):
        out.append(("Without GNSS, against the withheld fixes", outage_table(result).table("")))
    joint = nis(result)
    if joint.groups:
        out.append(("NIS of the fixes, before the gate", joint.table("")))
    return out


def _withheld(result: Result) -> bool:
    return bool(len(result.outages())) and bool(result.records.is_status("withheld").any())


def _summary(result: Result, config: Config, data: Dataset, files: list[str]) -> dict[str, Any]:
    errors = _compared(result, data.truth)
    return {
        "epochs": len(result),
        "start_s": float(result.time_s[0]),
        "end_s": float(result.time_s[-1]),
        "start": _start(result),
        "states": [state.name for state in result.states],
        "counts": result.counts,
        "events": result.event_counts(),
        "findings": result.metadata["finding"],
        "times": {k: v for k, v in result.metadata["run"].items() if k.endswith("_s")},
        "rmse": errors.rmse().to_dict() if errors is not None and len(errors) else None,
        "outages": outage_table(result).to_dict() if _withheld(result) else None,
        "nis": nis(result).to_dict(),
        "files": files,
    }


def compare(folder: Path, reference: Path, after: float | None, as_json: bool) -> None:
    """``gnssins compare``."""
    result = Result.open(folder)
    other = _reference(reference)
    errors = compare_tracks(result, other, ellipsoid=str(result.metadata["ellipsoid"]))
    rmse = errors.rmse(after)
    gaps = outage_table(result, other) if len(result.outages()) else None
    if as_json:
        report = {"result": str(folder), "reference": str(reference), "rmse": rmse.to_dict()}
        put_json({**report, "outages": gaps.to_dict() if gaps is not None else None})
        return
    put(rmse.table(f"{folder} against {reference}, root mean square"))
    if gaps is not None:
        put()
        put(gaps.table("Without GNSS"))


def _reference(path: Path) -> Result | TruthTable:
    if path.is_dir():
        return Result.open(path)
    table, _ = format_of(path).read_truth(path, TruthConfig(file=path))
    if not len(table):
        raise InputError("input.empty", f"{path}: no rows")
    return table
