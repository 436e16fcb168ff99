"""The ``gnssins`` command. Everything heavy is imported inside the commands: ``--help`` answers at once."""

from __future__ import annotations

import sys
import traceback
from pathlib import Path
from typing import Annotated

import typer

__all__ = ["app", "main"]

app = typer.Typer(
    name="gnssins",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    help="INS/GNSS integration: from an IMU and GNSS log, or a simulated flight, to a trusted trajectory.",
    epilog="Start with: gnssins demo",
)

Json = Annotated[bool, typer.Option("--json", metavar="", help="Print one JSON document instead of text.")]


def _version(wanted: bool) -> None:
    if wanted:
        import gnssins

        typer.echo(f"gnssins {gnssins.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None: ...


@app.command(
    epilog="Example: gnssins demo --out demo-output",
    help="Fly a simulated UAV for 3000 s with and without GNSS gaps, and show how good the solution is.\n\n"
    "Sensors at 100 Hz, fixes at 1 Hz, a filter with 18 states. Needs no data; takes some ten seconds.",
)
def demo(
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for pictures and results.")
    ] = Path("demo-output"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 2017,
    json: Json = False,
) -> None:
    """Fly a simulated UAV for 3000 s with and without GNSS gaps, and show how good the solution is."""
    from gnssins.commands import filtering

    filtering.demo(out, seed, json)


@app.command(
    epilog="Example: gnssins simulate fomichev-tan-2017 --seed 7 --out flight",
    help="Simulate a log: IMU, fixes and the truth as CSV files, and a configuration that is ready to run.\n\n"
    "Writes imu.csv.gz, gnss.csv.gz, ref.csv.gz and SCENARIO.toml. The same seed gives the same files.",
)
def simulate(
    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="Name of a packaged scenario, or a TOML file.")
    ] = "",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="DIR", help="Folder to write; default: SCENARIO.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 0,
    variant: Annotated[
        str | None, typer.Option(help="Variant that the scenario defines, such as other GNSS gaps.")
    ] = None,
    names: Annotated[
        bool, typer.Option("--list", metavar="", help="List the packaged scenarios and leave.")
    ] = False,
    json: Json = False,
) -> None:
    """Simulate a log: IMU, fixes and the truth as CSV files, and a configuration that is ready to run."""
    from gnssins.commands import filtering

    if names:
        filtering.list_scenarios(json)
        return
    if not scenario:
        raise typer.BadParameter("name a scenario; gnssins simulate --list shows them", param_hint="SCENARIO")
    filtering.simulate(scenario, out, seed, variant, json)


@app.command(
    epilog="Example: gnssins run drive.toml --out result --figures --kml",
    help="Process a recorded log: IMU and GNSS in, trajectory with its accuracy out.\n\n"
    "Writes navigation.parquet, measurements.parquet, covariance.parquet, events.csv, state.bin and run.toml. "
    "If the configuration names a reference it prints the errors; if it withholds fixes in outages, how far the "
    "solution drifts without them.",
)
def run(
    config: Annotated[
        Path, typer.Argument(metavar="CONFIG.toml", help="Configuration; it names the input files.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="Folder for the result; default: CONFIG-result."),
    ] = None,
    csv: Annotated[
        bool, typer.Option("--csv", metavar="", help="Also write navigation.csv and measurements.csv.")
    ] = False,
    kml: Annotated[
        bool, typer.Option("--kml", metavar="", help="Also write track.kml for Google Earth and the like.")
    ] = False,
    figures: Annotated[
        bool, typer.Option("--figures", metavar="", help="Also draw the figures as PNG.")
    ] = False,
    chunk_rows: Annotated[
        int | None,
        typer.Option(
            "--chunk-rows",
            metavar="N",
            min=1000,
            help="For IMU logs larger than memory: read, filter and write N rows at a time; same numbers. "
            "Not with --csv, --kml, --figures.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Process a recorded log: IMU and GNSS in, trajectory with its accuracy out."""
    from gnssins.commands import filtering

    if chunk_rows is None:
        filtering.run(config, out, csv, kml, figures, json)
        return
    if csv or kml or figures:
        raise typer.BadParameter(
            "needs the whole result in memory; leave it out and read navigation.parquet piece by piece",
            param_hint="--csv, --kml or --figures with --chunk-rows",
        )
    filtering.run_in_pieces(config, out, chunk_rows, json)


@app.command(
    epilog="Example: gnssins compare result flight/ref.csv.gz --after 600",
    help="Compare a result with a reference trajectory or with another result.\n\n"
    "A reference file has the columns time_s, lat_deg, lon_deg, height_m and, if known, vn, ve, vd, roll_deg, "
    "pitch_deg, heading_deg; its clock is that of the IMU log.",
)
def compare(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Folder that gnssins run has written.")],
    reference: Annotated[
        Path, typer.Argument(metavar="REFERENCE", help="Truth as CSV file, or the folder of another result.")
    ],
    after: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Leave out everything up to this time.")
    ] = None,
    json: Json = False,
) -> None:
    """Compare a result with a reference trajectory or with another result."""
    from gnssins.commands import filtering

    filtering.compare(result, reference, after, json)


@app.command(
    epilog="Example: gnssins reproduce fomichev-tan-2017 --runs 20 --out report",
    help="Repeat a published experiment by Monte Carlo and hold every figure against the publication.\n\n"
    "Writes tables as CSV, figures as PNG, report.txt and summary.json. A claim that is missed is told, with the "
    "reason; the command still leaves with 0.",
)
def reproduce(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="A publication of gnssins reproduce --list.")
    ] = "",
    runs: Annotated[
        int | None,
        typer.Option(min=1, help="Monte Carlo runs; default: what the publication's figures need."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of all random numbers.")] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Threads; default: one per core. The figures do not depend on it."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="Folder to write; default: NAME-reproduction."),
    ] = None,
    names: Annotated[
        bool, typer.Option("--list", metavar="", help="List the publications and leave.")
    ] = False,
    json: Json = False,
) -> None:
    """Repeat a published experiment by Monte Carlo and hold every figure against the publication."""
    from gnssins.commands import reproducing

    if names:
        reproducing.list_publications(json)
        return
    if not name:
        raise typer.BadParameter("name a publication; gnssins reproduce --list shows them", param_hint="NAME")
    reproducing.reproduce(name, runs, seed, jobs, out, json)


@app.command(
    epilog="Example: gnssins montecarlo fomichev-tan-2017 --variant gaps --runs 1000 --after 600 --store sweep.npz",
    help="Simulate, filter and compare a scenario many times: accuracy, and whether the filter knows its errors.\n\n"
    "Runs on all cores inside the compiled core; the figures do not depend on the number of threads. Ctrl-C prints "
    "what is finished; with --store the same command goes on from there.",
)
def montecarlo(
    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="Name of a packaged scenario, or a TOML file.")
    ],
    config: Annotated[
        Path | None,
        typer.Argument(
            metavar="[CONFIG.toml]", help="Filter; default: the one that models the errors of the scenario."
        ),
    ] = None,
    runs: Annotated[int, typer.Option(min=1, help="Number of runs.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the set.")] = 0,
    jobs: Annotated[int | None, typer.Option(min=1, help="Threads; default: one per core.")] = None,
    covariance: Annotated[
        str, typer.Option(help="full: every run has its own; shared: all have that of the errorless run.")
    ] = "full",
    after: Annotated[
        float, typer.Option(metavar="SECONDS", help="Root mean squares and NIS count times after this one.")
    ] = 0.0,
    variant: Annotated[str | None, typer.Option(help="Variant that the scenario defines.")] = None,
    store: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Keep finished runs here, and go on from there.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="Also write the figures as JSON.")
    ] = None,
    json: Json = False,
) -> None:
    """Simulate, filter and compare a scenario many times."""
    from gnssins.commands import sweeping

    sweeping.montecarlo(scenario, config, variant, runs, seed, jobs, covariance, after, store, out, json)


@app.command(
    epilog="Example: gnssins outages drive.toml --length 60 --count 7",
    help="How fast the errors grow when GNSS is lost: withhold the fixes of several windows, and tell the errors after "
    "so many seconds.\n\n"
    "Works on any recording that gnssins run can process. The errors are those against the reference of the "
    "configuration, or against the withheld fixes. CONFIG.toml may also be the name of a packaged scenario.",
)
def outages(
    config: Annotated[
        str, typer.Argument(metavar="CONFIG.toml", help="Configuration; it names the input files.")
    ],
    length: Annotated[float, typer.Option(metavar="SECONDS", help="Length of a window without GNSS.")] = 60.0,
    count: Annotated[int, typer.Option(help="Number of windows.")] = 7,
    first: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Start of the first window; default: after --settle."),
    ] = None,
    period: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="From start to start; default: spread over the recording."),
    ] = None,
    settle: Annotated[
        float, typer.Option(metavar="SECONDS", help="Time that the filter has before the first window.")
    ] = 60.0,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="S,S,...", help="Times since the start of a window; default: four to six of them."
        ),
    ] = None,
    reference: Annotated[
        str,
        typer.Option(
            help="truth; fixes: the withheld ones, at the antenna; run: the same filter with all fixes; auto: "
            "truth if the configuration names one, else fixes."
        ),
    ] = "auto",
    seed: Annotated[int, typer.Option(min=0, help="Seed of a packaged scenario.")] = 0,
    json: Json = False,
) -> None:
    """How fast the errors grow when GNSS is lost."""
    from gnssins.commands import outages as command

    windows = command.Windows(length, count, first, period, settle)
    command.outages(config, windows, at, reference, seed, json)


@app.command(
    epilog="Example: gnssins budget --position 5 --outage 100 --accel-ug 25 --gyro-deg-h 0.003",
    help="Show which accelerometer and gyro errors a position requirement allows for an outage of GNSS.\n\n"
    "With the errors of given sensors: how long an outage they bridge. One horizontal channel, constant errors.",
)
def budget(
    position: Annotated[
        float, typer.Option(metavar="METRES", help="Largest position error of one horizontal axis.")
    ] = 5.0,
    outage: Annotated[
        list[float] | None,
        typer.Option(metavar="SECONDS", help="Length of the outage; may be repeated. Default: 10 s to 1 h."),
    ] = None,
    accel_ug: Annotated[
        float | None, typer.Option(metavar="UG", help="Constant error of the accelerometer, micro-g.")
    ] = None,
    gyro_deg_h: Annotated[
        float | None, typer.Option(metavar="DEG/H", help="Constant drift of the gyro, deg/h.")
    ] = None,
    json: Json = False,
) -> None:
    """Show which accelerometer and gyro errors a position requirement allows for an outage of GNSS."""
    from gnssins.commands import inertial

    inertial.budget(position, outage, accel_ug, gyro_deg_h, json)


@app.command(
    epilog="Example: gnssins schuler --out schuler",
    help="Show how single errors grow in an INS without GNSS: tilt, gyro, velocity, accelerometer.\n\n"
    "The full equations of a vehicle at rest, height held, beside the 84-minute pendulum. With --out: table, curves as "
    "CSV and a figure.",
)
def schuler(
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="DIR", help="Folder for table, curves and figure.")
    ] = None,
    lat: Annotated[float, typer.Option(metavar="DEG", help="Latitude.")] = 55.0,
    json: Json = False,
) -> None:
    """Show how single errors grow in an INS without GNSS: tilt, gyro, velocity, accelerometer."""
    from gnssins.commands import inertial

    inertial.schuler(out, lat, json)


def main() -> None:
    """Run the command line and leave with 0 (done), 1 (something the user can change) or 2 (a bug)."""
    sys.exit(_guarded())


def _guarded() -> int:
    try:
        app(prog_name="gnssins")
    except SystemExit as leaving:
        # wrong options and arguments: the parser has printed what is wrong and leaves with 2
        return 1 if leaving.code == 2 else int(leaving.code or 0)
    except KeyboardInterrupt:
        return 130
    except Exception as error:
        return _failed(error)
    return 0


def _failed(error: Exception) -> int:
    """Tell a user's error in one line and its hint, a bug with its trace."""
    from gnssins.errors import GnssinsError
    from gnssins.terminal import message, put_json

    as_json = "--json" in sys.argv
    if isinstance(error, GnssinsError):
        if as_json:
            put_json(
                {
                    "error": {
                        "code": error.code,
                        "message": error.message,
                        "hint": error.hint,
                        "context": error.context,
                    }
                }
            )
        message(str(error), "red")
        return 1
    if isinstance(error, OSError) and not isinstance(error, ConnectionError):
        where = f"{error.filename}: " if error.filename else ""
        if as_json:
            put_json({"error": {"code": "os.error", "message": f"{where}{error.strerror or error}"}})
        message(f"{where}{error.strerror or error}", "red")
        return 1
    if as_json:
        put_json({"error": {"code": "bug", "message": f"{type(error).__name__}: {error}"}})
    traceback.print_exception(error)
    message("This is a bug in gnssins. Please report it with the lines above.", "red")
    return 2


if __name__ == "__main__":
    main()
