"""Growth of errors in gaps: both readings of a root mean square, references, placing of windows, the command."""

import json
import re
import sys
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import gnssins
from gnssins import _core, cli
from gnssins.analysis import OutageGrowth, compare, interpolate, outage_growth, outage_table, place_windows
from gnssins.analysis.growth import QUANTITIES
from gnssins.commands import outages
from gnssins.errors import ConfigError, InputError
from gnssins.simfiles import write_simulation
from short_flight import GAP_S, config, result, simulated
from test_analysis import displaced, truth

KEYS = [q.key for q in QUANTITIES]
AT = (10.0, 20.0, 30.0, 40.0, 50.0)


def column(values: np.ndarray, key: str) -> np.ndarray:
    return values[..., KEYS.index(key)]


@cache
def growth() -> OutageGrowth:
    return outage_growth(result(), truth(), at_s=AT)


# ---- readings


def test_both_readings_are_those_of_the_errors_inside_the_gap():
    found = growth()
    errors = compare(result(), truth())
    inside = (errors.time_s >= GAP_S[0]) & (errors.time_s < GAP_S[1])
    t, p = errors.time_s[inside] - GAP_S[0], errors.position[inside]
    for i, at in enumerate(AT):
        row = np.abs(t - at).argmin()
        assert abs(t[row] - at) <= 0.1 + 1e-9
        np.testing.assert_allclose(found.error[0, i, 2:4], p[row, :2], atol=1e-8)  # rounding of the longitude
        assert column(found.error, "height")[0, i] == pytest.approx(-p[row, 2])
        assert column(found.error, "distance")[0, i] == pytest.approx(np.linalg.norm(p[row]))
        so_far = np.sqrt(np.mean(np.sum(p[: row + 1] ** 2, axis=1)))
        assert column(found.rms_so_far, "distance")[0, i] == pytest.approx(so_far)
        np.testing.assert_allclose(found.error[0, i, 10:13], errors.euler[inside][row])
        np.testing.assert_allclose(found.sd[0, i, 7:13], errors.sd[inside][row][3:], rtol=1e-9)


def test_readings_of_an_error_that_grows_with_the_square_of_time_are_known():
    # GIVEN an error a t^2 / 2 north THEN at T it is a T^2 / 2, and the root mean square so far that over sqrt(5)
    r, accel = result(), 0.02
    t = np.clip(r.time_s - GAP_S[0], 0.0, None)
    on_truth = interpolate(truth(), r.t_ns)
    dp = np.column_stack([0.5 * accel * t**2, 0 * t, 0 * t])
    moved = displaced(on_truth, dp, np.column_stack([accel * t, 0 * t, 0 * t]), np.zeros(3))
    found = outage_growth(
        replace(r, lla=moved.lla, v_n=moved.v_n, q_nb=moved.q_nb), truth(), at_s=(20.0, 40.0)
    )
    for at in (20.0, 40.0):
        assert found.value("at_end", "north", at) == pytest.approx(0.5 * accel * at**2, rel=1e-6)
        assert found.value("so_far", "north", at) == pytest.approx(
            0.5 * accel * at**2 / np.sqrt(5.0), rel=1e-2
        )
        assert found.value("at_end", "v_north", at) == pytest.approx(accel * at, rel=1e-6)
        radius = _core.radii(truth().lla[:1, 0].copy(), "wgs84")[0, 0] + 600.0
        assert found.value("at_end", "latitude", at) == pytest.approx(0.5 * accel * at**2 / radius, rel=1e-4)
        assert found.value("at_end", "east", at) == pytest.approx(0.0, abs=1e-6)


def test_means_over_gaps_and_runs():
    one = growth()
    twice = replace(one, error=-3.0 * one.error, rms_so_far=3.0 * one.rms_so_far, sd=2.0 * one.sd)
    both = OutageGrowth.combine([one, twice])
    assert both.gaps == 2
    np.testing.assert_allclose(both.at_end, 2.0 * one.at_end)
    np.testing.assert_allclose(both.so_far, 2.0 * one.so_far)
    np.testing.assert_allclose(both.rms, np.sqrt(5.0) * one.rms)
    np.testing.assert_allclose(both.sigma, np.sqrt(2.5) * one.sigma)
    other = outage_growth(result(), truth(), at_s=(10.0,))
    with pytest.raises(InputError, match="different times"):
        OutageGrowth.combine([one, other])
    with pytest.raises(InputError, match="nothing"):
        OutageGrowth.combine([])


def test_the_end_of_the_gap_is_that_of_the_outage_table():
    found = growth()
    gap = outage_table(result(), truth()).outages[0]
    # the table ends with the last epoch before GNSS is back; so does the figure at the length of the gap
    np.testing.assert_allclose(found.error[0, -1, 2:4], gap.end_position[:2])
    np.testing.assert_allclose(found.sd[0, -1, 7:13], gap.end_sd[3:])


def test_nothing_is_counted_after_gnss_is_back():
    # GIVEN a window that says 80 s although GNSS is back after 50 s
    found = outage_growth(result(), truth(), [(200.0, 280.0)], at_s=(40.0, 60.0, 70.0))
    assert np.isfinite(found.error[0, 0]).all()
    assert np.isnan(found.error[0, 1:]).all()


def test_withheld_fixes_tell_position_and_velocity_within_their_noise():
    a, b = growth(), outage_growth(result(), at_s=AT)
    assert b.reference == "the withheld fixes"
    for i in range(2, 5):
        np.testing.assert_allclose(a.error[..., i], b.error[..., i], atol=4.0 * np.sqrt(2.0))
    assert np.isnan(b.error[..., 10:]).all()
    assert "roll" not in b.table()
    assert "roll, deg" in a.table()
    assert b.to_dict()["at_end"]["roll_rad"] == [None] * 5


def test_the_run_with_all_fixes_can_be_the_reference():
    whole = gnssins.run(config(), simulated())
    found = outage_growth(result(), whole, at_s=AT)
    assert np.isfinite(found.error).all()
    # both runs have the same error where the gap begins
    assert column(found.rms_so_far, "distance")[0, 0] < column(found.error, "distance")[0, 0]


def test_what_cannot_be_counted_is_refused():
    whole = gnssins.run(config(end_s=30.0), simulated())
    with pytest.raises(InputError, match="no gaps") as caught:
        outage_growth(whole, truth())
    assert "outages" in caught.value.hint
    with pytest.raises(InputError, match="no fix was withheld"):
        outage_growth(whole, windows_s=[(5.0, 20.0)])
    for at in ((), (0.0, 10.0), (20.0, 10.0)):
        with pytest.raises(InputError, match="times since the start"):
            outage_growth(result(), truth(), at_s=at)
    with pytest.raises(InputError, match="no reference epoch"):
        outage_growth(result(), truth(), [(500.0, 560.0)])
    with pytest.raises(InputError, match="at 15 s"):
        growth().value("rms", "north", 15.0)
    with pytest.raises(InputError, match='"median"'):
        growth().value("median", "north", 10.0)


# ---- windows


def test_windows_are_spread_from_the_settled_filter_to_the_end():
    windows = place_windows(0.0, 900.0, length_s=60.0, count=7, settle_s=200.0)
    starts = [w[0] for w in windows]
    assert starts[0] == 200.0
    assert windows[-1][1] == pytest.approx(900.0)
    np.testing.assert_allclose(np.diff(starts), 640.0 / 6)
    assert all(b - a == pytest.approx(60.0) for a, b in windows)
    # the published starts
    windows = place_windows(0.0, 900.0, length_s=60.0, count=7, first_s=200.0, period_s=95.0)
    assert [w[0] for w in windows] == [200, 295, 390, 485, 580, 675, 770]
    assert place_windows(10.0, 100.0, length_s=30.0, count=1) == ((70.0, 100.0),)


@pytest.mark.parametrize(
    ("options", "fit"),
    [
        ({"length_s": 60.0, "count": 14, "settle_s": 60.0}, 13),
        ({"length_s": 60.0, "count": 8, "first_s": 200.0, "period_s": 95.0}, 7),
        ({"length_s": 600.0, "count": 1, "settle_s": 400.0}, 0),
    ],
)
def test_windows_that_do_not_fit_say_how_many_would(options, fit):
    with pytest.raises(ConfigError, match=f"room for {fit}") as caught:
        place_windows(0.0, 900.0, **options)
    assert caught.value.code == "config.windows_fit"
    assert caught.value.context["fit"] == fit
    if fit:
        assert len(place_windows(0.0, 900.0, **{**options, "count": fit})) == fit


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"length_s": 0.0, "count": 1}, "config.windows"),
        ({"length_s": 10.0, "count": 0}, "config.windows"),
        ({"length_s": 10.0, "count": 1, "settle_s": float("nan")}, "config.windows"),
        ({"length_s": 10.0, "count": 2, "first_s": -5.0}, "config.windows_fit"),
        ({"length_s": 10.0, "count": 2, "period_s": 10.5}, "config.windows_fit"),
    ],
)
def test_windows_that_make_no_sense_are_refused(options, code):
    with pytest.raises(ConfigError) as caught:
        place_windows(0.0, 900.0, **options)
    assert caught.value.code == code
    assert caught.value.hint


# ---- the command


@pytest.mark.parametrize(
    ("length", "times"),
    [
        (60.0, [10, 20, 30, 40, 50, 60]), (30.0, [5, 10, 15, 20, 25, 30]), (40.0, [10, 20, 30, 40]),
        (10.0, [2, 4, 6, 8, 10]), (7.0, [2, 4, 6, 7]), (100.0, [20, 40, 60, 80, 100]),
    ],
)  # fmt: skip
def test_times_of_the_table_are_round_and_end_with_the_window(length, times):
    assert outages._times(None, length) == pytest.approx(times)


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    return Path(write_simulation(simulated(), tmp_path_factory.mktemp("log"))[-1])


@pytest.fixture
def command(capsys, monkeypatch):
    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["gnssins", "outages", *map(str, arguments)])
        code = cli._guarded()
        out, err = capsys.readouterr()
        return code, out, err

    return call


def test_the_command_tells_where_the_windows_are_and_how_errors_grow(command, log):
    code, out, err = command(log, "--length", 40, "--count", 3, "--at", "20,40", "--settle", 100)
    assert (code, err) == (0, "")
    assert "3 windows of 40 s, the first 100.0 s after the start, then every 80.0 s" in out
    assert "100.0 to 140.0, 180.0 to 220.0, 260.0 to 300.0" in out
    assert "mean of 3 gaps, against the truth" in out
    assert "R1" in out
    assert "heading, deg" in out


def test_the_figures_of_the_command_are_those_of_the_library(command, log):
    code, out, _ = command(log, "--length", 40, "--count", 2, "--first", 120, "--period", 90, "--json")
    report = json.loads(out)
    assert code == 0
    assert report["windows_s"] == [[120.0, 160.0], [210.0, 250.0]]
    assert report["counts"]["gnss"]["withheld"] == 82  # the fix at the end of each is withheld too
    settings = gnssins.Config.load(log).replace(run={"outages": [[120.0, 160.5], [210.0, 250.5]]})
    again = outage_growth(gnssins.run(settings), truth(), at_s=report["at_s"])
    np.testing.assert_allclose(report["at_end"]["north_m"], again.at_end[:, 2], rtol=1e-4)
    np.testing.assert_allclose(report["sigma"]["heading_rad"], again.sigma[:, 12], rtol=1e-9)


def test_references_of_the_command(command, log):
    _, fixes, _ = command(log, "--length", 40, "--count", 2, "--reference", "fixes", "--json")
    _, whole, _ = command(log, "--length", 40, "--count", 2, "--reference", "run", "--json")
    assert json.loads(fixes)["at_end"]["heading_rad"] == [None] * 4
    assert None not in json.loads(whole)["at_end"]["heading_rad"]
    code, _, err = command(log, "--reference", "map")
    assert code == 1
    assert "truth, fixes, run" in err


def test_errors_of_the_command_are_one_line_with_a_hint(command, log, tmp_path):
    for words, said in (
        ((log, "--length", 60, "--count", 7), "room for"),
        ((log, "--length", 40, "--count", 2, "--at", "10,50"), "not beyond the length of 40 s"),
        ((log, "--length", 40, "--count", 2, "--at", "ten"), "rising times"),
        ((tmp_path / "none.toml",), "no such file"),
    ):
        code, _, err = command(*words)
        assert code == 1
        assert said in err
        assert "hint" in err
        assert "Traceback" not in err
    tables = tomllib.loads(log.read_text())
    no_truth = log.with_name("no-truth.toml")
    gnssins.Config.from_dict({k: v for k, v in tables.items() if k != "truth"}, base=log.parent).to_toml(
        no_truth
    )
    code, _, err = command(no_truth, "--reference", "truth")
    assert code == 1
    assert "names no reference" in err
    no_gnss = log.with_name("no-gnss.toml")
    tables["gnss"].pop("file")
    gnssins.Config.from_dict(tables, base=log.parent).to_toml(no_gnss)
    code, _, err = command(no_gnss)
    assert code == 1
    assert "input.no_gnss" in err


def test_a_packaged_scenario_needs_no_files(command):
    code, out, err = command("car-loop", "--length", 20, "--count", 2, "--settle", 30, "--json")
    assert code == 0, err
    report = json.loads(out)
    assert report["gaps"] == 2
    assert report["reference"] == "the truth"


@pytest.mark.parametrize(("name", "length", "count"), [("car-rtkx-drive", 30, 7), ("uav-umn-thor75", 30, 5)])
def test_the_command_on_recorded_data(command, shared_data, repository, tmp_path, name, length, count):
    tables = tomllib.loads((repository / "examples" / f"{name}.toml").read_text())
    for section in ("imu", "gnss", "truth"):
        if section in tables:
            tables[section]["file"] = str(shared_data / name / tables[section]["file"].rsplit("/", 1)[1])
    settings = tmp_path / f"{name}.toml"
    gnssins.Config.from_dict(tables).to_toml(settings)
    code, out, err = command(settings, "--length", length, "--count", count, "--reference", "fixes", "--json")
    assert code == 0, err
    report = json.loads(out)
    assert report["gaps"] == count
    horizontal = report["at_end"]["horizontal_m"]
    assert None not in horizontal
    assert horizontal[0] < horizontal[-1] < 300.0
    assert report["so_far"]["horizontal_m"][-1] < horizontal[-1]


def test_python_of_the_how_to_runs(repository, capsys):
    page = (repository / "docs" / "howto" / "outages.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    names = {}
    exec(compile(block, "howto/outages.md", "exec"), names)
    assert "9 gaps" in capsys.readouterr().out
    assert 0.0 < names["growth"].value("at_end", "horizontal", 40.0) < 200.0
