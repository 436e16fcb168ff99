"""The reproduction of Al Bitar and Gavrilov (2019) on shortened drives: claims, calibration, antennas, misprints."""

import json
import math
import re
import tomllib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import gnssins
from gnssins import _core
from gnssins.analysis import OutageGrowth, place_windows, run_seed
from gnssins.config import Config
from gnssins.dataset import TruthTable
from gnssins.reproduce import al_bitar_gavrilov_2019 as al_bitar
from gnssins.reproduce.al_bitar_claims import claims
from gnssins.reproduce.al_bitar_errata import (
    ERRATA,
    Conditions,
    centrifugal_n,
    covariance_outcomes,
    polynomial_gravity,
    system_matrix,
    with_gravity_error,
)
from gnssins.reproduce.al_bitar_published import LABELS, PUBLISHED_TABLE, TIMES_S
from gnssins.reproduce.al_bitar_runs import (
    PUBLISHED,
    Drive,
    Force,
    Plan,
    Simulators,
    coast,
    drive,
    growths,
    together,
)
from gnssins.reproduce.al_bitar_tables import manoeuvres
from gnssins.reproduce.report import Job, Reproduction
from test_publication_f_al_bitar import published_f

#: The first two gaps, half as long, at half the rate of the IMU.
SHORT = Plan(
    gaps=((200.0, 230.0), (270.0, 300.0)),
    at_s=(10.0, 20.0, 30.0),
    changes={"duration_s": 310.0, "rate_hz": 100.0},
)
RUNS = 3


@cache
def short(jobs: int = 2) -> Reproduction:
    return al_bitar.experiment(Job(RUNS, 5, jobs), SHORT)


@cache
def drives() -> list[Drive]:
    simulators = Simulators.of(SHORT)
    return [drive(SHORT, simulators, 5, index) for index in range(RUNS)]


def row(table: str, **cells: str) -> list[object]:
    """The row of a table whose columns have these cells."""
    found = next(t for t in short().tables if t.name == table)
    at = {c: list(found.columns).index(c) for c in cells}
    return list(next(r for r in found.rows if all(r[at[c]] == v for c, v in cells.items())))


# ---- the report


def test_a_short_drive_is_reported_in_full():
    found = short()
    assert {t.name for t in found.tables} == {
        "outages", "gap_ends", "variants", "biases", "manoeuvres", "consistency", "errata",
    }  # fmt: skip
    assert {key[:8] for key in found.figures} >= {f"figure_{i}" for i in range(4, 9)}
    keys = {c.key for c in found.claims}
    assert keys >= {"distance_10", "distance_30", "whole_table", "nees_gaps", "calibrated", "heading_even"}
    # 10 quantities at three of the published times
    assert "all 30 figures" in found["whole_table"].text
    assert all(c.note for c in found.missed)


def test_errors_after_the_loss_of_gnss_are_those_of_the_specification():
    # 6 gaps: a mean of |error| scatters by 21 %; bounds are three times that above the reference program's figures
    found = short()
    assert 0.15 < found["distance_10"].ours < 0.70
    assert 0.8 < found["distance_30"].ours < 3.6
    # the filter's own sigma hardly depends on the draw: reference 0.47 and 2.41 m
    assert found["distance_10"].sigma == pytest.approx(0.47, rel=0.06)
    assert found["distance_30"].sigma == pytest.approx(2.41, rel=0.06)
    assert found["distance_30"].published == 8.82
    assert found["whole_table"].ours < 0.8


def test_the_filter_is_honest_with_and_without_gaps():
    # RUNS runs: NEES of 9 states at the ends of 6 gaps within 99.9 % of chi-square(54) / 6, the same for NIS
    found = short()
    assert 4.4 < found["gap_nees"].ours < 15.5
    assert 2.4 < found["first_fix_nis"].ours < 11.8
    assert 5.6 < found["nis_throughout"].ours < 6.4
    # each of 9 ratios within 99.99 % of chi-square(6) / 6
    assert 0.17 < found["gap_ratio_least"].ours <= found["gap_ratio_greatest"].ours < 2.25


def test_the_figures_do_not_depend_on_the_number_of_threads():
    simulators = Simulators.of(SHORT)
    again = Job(2, 5, 2).map(lambda k: drive(SHORT, simulators, 5, k), 2)
    for one, other in zip(drives(), again, strict=False):
        np.testing.assert_array_equal(one.gaps.errors, other.gaps.errors)
        for name, coasted in one.coasted.items():
            np.testing.assert_array_equal(coasted.growth.error, other.coasted[name].growth.error)


def test_a_short_drive_is_written_and_is_json(tmp_path):
    some = {key: short().figures[key] for key in ("figure_5_change", "growth")}
    files = replace(short(), figures=some).write(tmp_path)
    assert len(files) == 7 + 2 + 2
    summary = json.loads((tmp_path / "summary.json").read_text(), parse_constant=pytest.fail)
    assert summary["runs"] == RUNS


def test_the_plan_and_the_drive_are_those_of_the_specification():
    assert [begin for begin, _ in PUBLISHED.gaps] == [200, 295, 390, 485, 580, 675, 770]
    assert all(end - begin == 60.0 for begin, end in PUBLISHED.gaps)
    assert place_windows(0.0, 900.0, length_s=60.0, count=7, first_s=200.0, period_s=95.0) == PUBLISHED.gaps
    simulator = PUBLISHED.simulator()
    scenario = simulator.scenario
    assert (scenario.scenario.rate_hz, scenario.gnss.rate_hz, PUBLISHED.end_s) == (200.0, 5.0, 900.0)
    assert (scenario.gnss.position_sd_m[0], scenario.gnss.velocity_sd_m_s[0]) == (0.5, 0.1)
    path = simulator.truth
    speed = np.hypot(path.v_n[:, 0], path.v_n[:, 1])
    t_s = path.t_ns * 1e-9
    assert np.trapezoid(speed, t_s) == pytest.approx(7900.0, rel=0.005)
    assert speed.max() == pytest.approx(13.0, abs=0.1)
    heading = np.unwrap(_core.quat_to_euler(np.ascontiguousarray(path.q_nb))[:, 2])
    corners = np.flatnonzero(np.diff((np.abs(np.gradient(heading, t_s)) > 0.2).astype(int)) == 1)
    assert len(corners) == 13
    assert np.diff(t_s[corners]).min() > 55.0
    assert np.diff(t_s[corners]).max() < 75.0
    assert list(PUBLISHED_TABLE) == [k for k in LABELS if k not in ("north", "east")]
    assert PUBLISHED.at_s == TIMES_S


# ---- claims can be missed


def test_a_filter_that_ignores_its_calibration_misses_the_claims():
    # GIVEN sensors with scale factors and cross couplings of 1e-2, left in, in the place of the published filter
    plan, every = SHORT, drives()
    found = growths(every)
    whole, gaps = together(every, 5)
    bad = {**found, "published": found["uncalibrated 10"]}
    classes = manoeuvres(plan, whole, seen())
    missed = {c.key for c in claims(plan, whole, gaps, bad, every, classes) if c.judged and not c.met}
    right = {c.key for c in claims(plan, whole, gaps, found, every, classes) if c.judged and not c.met}
    assert missed - right >= {"distance_30", "calibrated"}
    # its own NEES tells, the sigma that it claims does not
    nees = [np.mean([d.coasted[f"{name} 10"].nees for d in every]) for name in ("calibrated", "uncalibrated")]
    assert nees[0] < 15.0
    assert nees[1] > 500.0
    ratio = found["uncalibrated 10"].value("sigma", "distance", 30.0) / found["published"].value(
        "sigma", "distance", 30.0
    )
    assert ratio < 1.3


@cache
def seen():
    from gnssins.analysis import observability

    return observability(
        gnssins.run(SHORT.one_bias(False, linearise=True), SHORT.faultless().run(1)), window=31
    )


def test_missed_claims_of_few_gaps_say_so():
    for claim in short().missed:
        assert claim.note


# ---- calibration, antennas


def test_known_matrices_taken_off_leave_nothing_of_them():
    found = growths(drives())
    for size in (1, 10):
        np.testing.assert_allclose(
            found[f"calibrated {size}"].at_end[:, 2:7],
            found["published"].at_end[:, 2:7],
            rtol=0.05,
            atol=0.02,
        )
    # estimated they do not either, but cost some certainty
    assert found["states 10"].value("at_end", "distance", 30.0) < 1.4 * found["published"].value(
        "at_end", "distance", 30.0
    )
    assert found["states 10"].value("sigma", "roll", 30.0) > found["published"].value("sigma", "roll", 30.0)


def test_the_calibration_matrix_is_that_of_the_simulated_sensors():
    # GIVEN increments of the same seed with and without matrices, THEN the difference is S times the true increments
    clean, raw = PUBLISHED.simulator(), PUBLISHED.raw(10.0)
    path = clean.trajectory
    a, b = clean.run(3).dataset.imu, raw.run(3).dataset.imu
    rows = slice(15000, 18000)  # with a corner in it
    for sensor, true in (("gyro", path.dtheta), ("accel", path.dvel)):
        s = np.array(PUBLISHED.calibration(10.0)[sensor]["matrix"])
        assert np.abs(s).max() > 0.01
        difference = getattr(b, sensor)[rows] - getattr(a, sensor)[rows]
        np.testing.assert_allclose(difference, np.asarray(true)[1:][rows] @ s.T, atol=1e-12)


def test_two_antennas_hold_the_heading():
    found = growths(drives())
    with_it, without = (found[name].value("sigma", "heading", 30.0) for name in ("heading", "published"))
    assert math.degrees(with_it) < 0.05
    assert with_it < 0.5 * without
    assert row("variants", filter="with the heading of two antennas")[-2] < 15.0  # NEES/9


# ---- heading and specific force


def test_the_heading_error_grows_in_even_motion_and_falls_with_acceleration():
    whole, _ = together(drives(), 5)
    even, *_, hard = manoeuvres(SHORT, whole, seen())
    assert even.sigma_change > 0.01
    assert hard.sigma_change < -0.04
    # |f| = g: the fixes of a window tell neither heading nor z gyro bias; with acceleration both
    assert even.flagged[0] > 0.99
    assert even.flagged[1] > 0.99
    assert hard.flagged[:2] == (0.0, 0.0)
    assert even.rank == 11
    assert hard.rank >= 14
    begin, end = SHORT.force.first_straight()
    at = [whole.at(begin), whole.at(end)]
    assert whole.sigma()[at[1], 2] > 2.0 * whole.sigma()[at[0], 2]


def test_the_specific_force_is_that_of_the_motion():
    # GIVEN a circle of radius r at speed v, THEN the acceleration is v^2 / r and |f| the root of the squares
    t = np.arange(0.0, 20.0, 0.01)
    v, r, lat = 8.0, 40.0, math.radians(45.0)
    heading = v / r * t
    v_n = np.column_stack([v * np.cos(heading), v * np.sin(heading), 0 * t])
    lla = np.column_stack([np.full_like(t, lat), np.full_like(t, 0.1), np.full_like(t, 100.0)])
    q = np.tile([1.0, 0.0, 0.0, 0.0], (t.size, 1))
    force = Force.of(TruthTable(np.rint(t * 1e9).astype(np.int64), lla, v_n, q))
    inside = slice(5, -5)
    assert force.accel[inside] == pytest.approx(v**2 / r, rel=1e-4)
    g = _core.gravity_n(np.array([lat]), np.array([100.0]), "wgs84")[0, 2]
    assert force.size[inside] == pytest.approx(math.hypot(g, v**2 / r), rel=1e-5)
    assert force.rms(np.array([5.0]), np.array([10.0])) == pytest.approx(v**2 / r, rel=1e-4)


# ---- misprints


def test_the_system_matrix_of_the_analysis_is_the_published_one():
    c = Conditions.of(PUBLISHED.simulator().truth, np.array([10.0, 60.0, 82.5, 207.0]))
    f = system_matrix(c)
    for k in range(4):
        expected = published_f(c.lat_rad[k], c.height_m[k], c.v_n[k], c.f_n[k], c.c_nb[k])
        assert np.allclose(f[k], expected, rtol=1e-6, atol=1e-15)


def test_the_polynomial_is_normal_gravity_already():
    # E1: taking the centrifugal acceleration off would make it wrong by up to 0.034 m/s^2
    for lat_deg in (0.0, 20.0, 45.05, 60.0, 90.0):
        for height in (0.0, 240.0, 3000.0):
            lat = math.radians(lat_deg)
            engine = _core.gravity_n(np.array([lat]), np.array([height]), "wgs84")[0, 2]
            assert polynomial_gravity(lat, height) == pytest.approx(engine, abs=5e-6)
    assert np.linalg.norm(centrifugal_n(0.0, 0.0)) == pytest.approx(0.0339, abs=5e-5)
    at_45 = centrifugal_n(math.radians(45.05), 240.0)
    assert at_45 == pytest.approx([-0.01699, 0.0, -0.01696], abs=2e-5)
    # E3 at 45 deg: sin for sin^2 makes 0.0108 m/s^2
    lat = math.radians(45.05)
    wrong = polynomial_gravity(lat, 240.0, printed=True) - polynomial_gravity(lat, 240.0)
    assert wrong == pytest.approx(0.0108, abs=1e-4)


def test_wrong_gravity_is_a_tilt_of_the_horizontal_part_over_g():
    # GIVEN a filter whose gravity is wrong by 0.017 m/s^2 to the south (E1), THEN it tilts by 1.7 mrad about east
    simulator = SHORT.simulator()
    simulated = simulator.run(run_seed(5, 0))
    dg = np.array([-0.017, 0.0, 0.0])
    wrong = with_gravity_error(simulated, simulator.trajectory.q_nb, dg)
    right, tilted = (gnssins.run(SHORT.config(False), each) for each in (simulated, wrong))
    difference = _core.quat_to_dcm(np.ascontiguousarray(tilted.q_nb[-1:]))[0]
    difference = difference @ _core.quat_to_dcm(np.ascontiguousarray(right.q_nb[-1:]))[0].T
    # C_wrong = (I - [phi x]) C_right with phi about east
    about_east = 0.5 * (difference[2, 0] - difference[0, 2])
    assert abs(about_east) == pytest.approx(0.017 / 9.8, rel=0.15)
    # and takes the tilt for its own: NEES of the navigation states, not sigma, tells
    found = coast(SHORT, gnssins.run(SHORT.config(True), wrong), wrong)
    assert found.nees.mean() > 50.0


def test_misprints_do_what_the_page_says():
    assert set(ERRATA) == {"", "E1", "E3", "E7 start", "E7 one"}
    nees, claimed, actual = -1, 3, 2
    right = row("errata", no="-")
    assert right[nees] < 15.0
    assert row("errata", no="E1")[nees] > 50.0
    # the z accelerometer bias takes in what E3 adds
    assert row("errata", no="E3")[nees] < 16.0
    # constants that are nowhere in P: over-confident
    start = row("errata", no="E7 start")
    assert start[nees] > 30.0
    assert start[actual] > 1.5 * right[actual]
    # one random walk per sensor does as well
    one = row("errata", no="E7 one")
    assert one[nees] < 16.0
    assert one[actual] == pytest.approx(right[actual], rel=0.2)
    assert right[claimed] == pytest.approx(row("errata", no="analysis")[claimed], rel=0.02)


def test_the_covariance_analysis_is_that_of_the_engine_and_tells_the_wrong_frame_apart():
    found = covariance_outcomes(SHORT, SHORT.simulator().truth)
    right, wrong = found["analysis"], found["E2"]
    engine = growths(drives())["published"]
    for pair, name in ((right.distance, "distance"), (right.heading, "heading")):
        assert pair[0] == pytest.approx(pair[1], rel=1e-9)
        assert pair[1] == pytest.approx(engine.value("sigma", name, 30.0), rel=0.01)
    assert wrong.distance[1] == right.distance[1]
    assert wrong.distance[0] > 10.0 * right.distance[0]


# ---- the command on the files of a simulated drive


def test_outages_of_the_command_are_those_of_the_reproduction(tmp_path):
    # GIVEN the drive as files, read back; WHEN its gaps are those of the plan, THEN the figures are the library's
    from gnssins.commands.outages import growth_of
    from gnssins.io import read_dataset
    from gnssins.simfiles import write_simulation

    simulated = SHORT.simulator().run(run_seed(5, 0))
    config = Config.load(write_simulation(simulated, tmp_path)[-1])
    assert config.filter.preset == "al-bitar-gavrilov-2019"
    config = config.replace(run={"output_rate_hz": 10.0})
    found, _ = growth_of(config, read_dataset(config), SHORT.gaps, SHORT.at_s, "truth")
    own = drives()[0].coasted["published"].growth
    assert isinstance(found, OutageGrowth)
    np.testing.assert_allclose(found.at_end[:, 2:], own.at_end[:, 2:], rtol=2e-3, atol=1e-4)


def test_configuration_of_the_page_is_valid(repository, tmp_path):
    page = (repository / "docs" / "publications" / "al-bitar-gavrilov-2019.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```toml\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    config = Config.from_dict(tomllib.loads(text), base=tmp_path)
    # the matrices are those of the scenario before calibration
    for sensor in ("gyro", "accel"):
        want = PUBLISHED.calibration()[sensor]["matrix"]
        np.testing.assert_allclose(getattr(config.imu, sensor).matrix, want, rtol=1e-12)
    engine = config.engine_config()
    assert [b["name"] for b in engine["blocks"]] == ["gyro_walk", "gyro_drift", "accel_walk", "accel_drift"]
    assert engine["blocks"][1]["sd"][0] == pytest.approx(math.radians(5.0 / 3600.0))
    assert engine["blocks"][1]["tau_s"][0] == 200.0
