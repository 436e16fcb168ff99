"""The reproduction of Fomichev and Tan (2017) on a shortened flight: claims, restarted INS, readings, misprints."""

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gnssins import Simulator
from gnssins.reproduce import fomichev_tan_2017 as fomichev
from gnssins.reproduce.fomichev_tan_errata import ERRATA, Conditions, outcomes, system_matrix
from gnssins.reproduce.fomichev_tan_runs import PUBLISHED, READINGS, Plan, realise, restarted_errors
from gnssins.reproduce.report import Job, Reproduction
from gnssins.sim import scenario_from_dict
from test_publication_f import published_f

#: A tenth of the flight in everything that costs time.
SHORT = Plan(
    gaps=((300.0, 360.0), (420.0, 470.0)), after_s=200.0, changes={"duration_s": 620.0, "rate_hz": 20.0}
)


@cache
def short(jobs: int = 2) -> Reproduction:
    return fomichev.experiment(Job(4, 11, jobs), SHORT)


def test_a_short_flight_is_reported_in_full():
    found = short()
    keys = {c.key for c in found.claims}
    assert keys >= {
        "position",
        "velocity",
        "level",
        "heading",
        "nees_gaps",
        "nis_gaps",
        "north_gap_1",
        "gain",
    }
    assert {t.name for t in found.tables} == {
        "accuracy", "states", "gaps", "restarted", "readings", "consistency", "errata",
    }  # fmt: skip
    # figures 1 to 8 of the publication, and the comparison
    assert [key[:8] for key in found.figures if key.startswith("figure_")] == [
        f"figure_{i}" for i in range(1, 9)
    ]
    assert all(c.note for c in found.missed)
    assert 4.0 < found["nees_gaps"].ours < 16.0
    assert 5.6 < found["nis_throughout"].ours < 6.4
    assert found["position"].ours < 0.5
    assert found["gain"].ours > 1.0


def test_the_figures_do_not_depend_on_the_number_of_threads():
    assert short(1).to_dict() == short().to_dict()


def test_a_short_flight_is_written_and_is_json(tmp_path):
    some = dict(list(short().figures.items())[-2:])
    files = replace(short(), figures=some).write(tmp_path)
    assert len(files) == 7 + 2 + 2
    summary = json.loads((tmp_path / "summary.json").read_text(), parse_constant=pytest.fail)
    assert summary["runs"] == 4


def test_the_three_readings_are_those_of_the_specification():
    assert [READINGS[n].arw_deg_sqrt_h for n in "ABC"] == pytest.approx([1.667e-6, 1e-3, 1.667e-5], rel=1e-3)
    for name in "ABC":
        assert SHORT.simulator(name).scenario.imu.gyro.arw_deg_sqrt_h[0] == READINGS[name].arw_deg_sqrt_h
    assert PUBLISHED.end_s == 3000.0
    assert PUBLISHED.simulator().scenario.scenario.rate_hz == 100.0


def test_a_perfect_ins_restarted_from_a_perfect_fix_stays_on_the_truth():
    # GIVEN a flight without any error, THEN the INS is on the truth to what its own step leaves
    tables = SHORT.simulator().scenario.model_dump(mode="json", exclude_none=True)
    tables["imu"] = {}
    tables["gnss"] |= {"position_sd_m": 1e-9, "velocity_sd_m_s": 1e-9}
    tables["initial_error"] = {"attitude_sd_arcmin": 0.0, "velocity_sd_m_s": 0.0, "position_sd_m": 0.0}
    flight = Simulator(scenario_from_dict(tables)).run(1)
    errors = restarted_errors(flight, SHORT.gaps)
    assert [e.shape for e in errors] == [(59, 3), (49, 3)]
    assert max(np.abs(e).max() for e in errors) < 1e-4
    # BUT WHEN the velocity of the last fix is 0.1 m/s off, THEN north runs off by 0.1 m/s and no other axis does
    gnss = flight.dataset.gnss
    wrong = gnss.v_n.copy()
    wrong[:, 0] += 0.1
    moved = type(gnss)(gnss.t_ns, gnss.lla, wrong, gnss.var)
    other = replace(flight, dataset=replace(flight.dataset, gnss=moved))
    drift = restarted_errors(other, SHORT.gaps)[0]
    assert drift[-1, 0] == pytest.approx(0.1 * 60.0, rel=0.01)
    assert np.abs(drift[:, 1]).max() < 0.1


def test_the_realisation_of_the_publication_has_errors_of_plus_one_sigma():
    one = realise(SHORT, 3)
    start = one.simulated.initial_error
    assert start[:3] == pytest.approx([math.radians(1 / 60)] * 3)
    assert start[3:] == pytest.approx([0.05] * 3 + [1.0] * 3)
    drift = one.simulated.truth_blocks["gyro_bias"]
    assert np.allclose(drift, math.radians(0.01 / 3600), rtol=1e-9)
    assert one.fix_errors.std(axis=0) == pytest.approx([1.0] * 3 + [0.05] * 3, rel=0.2)


def test_the_system_matrix_of_the_errata_is_the_published_one():
    truth = SHORT.simulator().truth
    c = Conditions.of(truth, np.array([100.0, 215.0, 430.0]))
    f = system_matrix(c)
    for k in range(3):
        expected = published_f(c.lat_rad[k], c.height_m[k], c.v_u[k], c.f_u[k], c.c_ub[k])
        assert np.allclose(f[k], expected, rtol=1e-6, atol=1e-15)
    # level flight: gravity along up, and a coordinated turn feels no lateral force
    assert np.abs(c.f_u[:, 2] - 9.79).max() < 0.05


@pytest.mark.parametrize(
    ("number", "at"),
    [("E2", (0, 1)), ("E3", (3, 3)), ("E4", (4, 3)), ("E5", (4, 6)), ("E6", (5, 3)), ("E7", (7, 6))],
)
def test_a_misprint_changes_its_own_entry_only(number, at):
    c = Conditions.of(SHORT.simulator().truth, np.array([215.0]))
    changed = np.argwhere(system_matrix(c, frozenset({number}))[0] != system_matrix(c)[0])
    assert [tuple(map(int, place)) for place in changed] == [at]


def test_the_covariance_analysis_claims_what_the_engine_claims_and_tells_the_misprints_apart():
    found = outcomes(SHORT.simulator().truth, (300.0, 360.0))
    assert set(found) == {"", *ERRATA}
    right = found[""]
    # GIVEN the right matrix, THEN errors are as large as claimed, and as the engine says
    for actual, claimed in (right.steady_north, right.steady_heading, right.end_north, right.end_up):
        assert actual == pytest.approx(claimed, rel=1e-9)
    engine = short().tables[2].rows
    north, up = (
        next(float(row[6]) for row in engine if row[1] == f"position {a}") for a in ("north", "down")
    )
    assert right.end_north[1] == pytest.approx(north, rel=0.01)
    assert right.end_up[1] == pytest.approx(up, rel=0.01)
    # WHEN P stands still in the gap, THEN the filter claims what it had before
    assert found["E16"].end_north[1] == pytest.approx(found["E16"].steady_north[1], rel=1e-4)
    assert found["E16"].end_north[0] == pytest.approx(right.end_north[0], rel=1e-9)
    # noise 100 times too small: over-confident
    assert found["E10"].end_north[0] > 1.1 * found["E10"].end_north[1]
