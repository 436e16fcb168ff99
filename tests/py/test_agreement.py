"""The engine against the dense reference: state, covariance and innovations over 1000 steps with updates.

Two independent programs: scalar whitened updates and block-wise prediction here, full matrices there. All
differences are relative to what matters: covariance elements to sqrt(P_ii P_jj), block estimates to their
initial standard deviation, position to the 300 m flown, velocity to 30 m/s, attitude to one radian.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gnssins import _core
from reference import attitude as att
from reference import earth
from reference import filter as reference_filter
from reference.cases import CASES, ned22
from reference.differences import LD, differences, ecef_error_rates, ned_error_rates, noise_of
from reference.differences import near as compare
from reference.make_golden import GOLDEN
from reference.strapdown import NavState, coning_sculling, step

Array = NDArray[Any]
TOLERANCE = 1e-9
RUNS = list(CASES)


def load(name: str) -> dict[str, Any]:
    return json.loads((GOLDEN / f"{name}.json").read_text())


def array(value: Any) -> Array:
    """Nested lists as float64, null as NaN."""
    return np.array(value, dtype=np.float64)


def inputs(golden: dict[str, Any]) -> tuple[dict[str, Array], dict[str, Array]]:
    imu, gnss = ({k: array(v) for k, v in golden[t].items() if k != "t_ns"} for t in ("imu", "gnss"))
    for table, name in ((imu, "imu"), (gnss, "gnss")):
        table["t_ns"] = np.array(golden[name]["t_ns"], dtype=np.int64)
    return imu, gnss


def engine_run(config: dict[str, Any], imu: dict[str, Array], gnss: dict[str, Array]) -> dict[str, Any]:
    return _core.run(
        json.dumps(config),
        imu["t_ns"],
        imu["gyro"],
        imu["accel"],
        gnss["t_ns"],
        gnss["pos"],
        gnss["vel"],
        gnss["var"],
        None,
    )


def initial_sd(config: dict[str, Any]) -> Array:
    return array([s for b in config["blocks"] for s in b["initial_sd"]])


def pick(times: Array, wanted: Any) -> Array:
    """Rows of the times that are wanted; each must be there."""
    rows = np.searchsorted(times, wanted)
    assert np.array_equal(times[rows], wanted)
    return rows


def state_misfit(got: dict[str, Array], want: dict[str, Array], sd_x: Array) -> dict[str, float]:
    """Largest relative difference of each part of the state."""
    lla, ref = got["lla"], want["lla"]
    metres = np.column_stack(
        [
            (lla[:, 0] - ref[:, 0]) * 6.4e6,
            earth.wrap(lla[:, 1] - ref[:, 1]) * 6.4e6 * np.cos(ref[:, 0]),
            lla[:, 2] - ref[:, 2],
        ]
    )
    turn = [
        att.log_quat(att.quat_mul(a, att.quat_inv(b))) for a, b in zip(got["q_nb"], want["q_nb"], strict=True)
    ]
    return {
        "position": float(np.abs(metres).max() / 300.0),
        "velocity": float(np.abs(got["v_n"] - want["v_n"]).max() / 30.0),
        "attitude": float(np.abs(turn).max()),
        "blocks": float((np.abs(got["x"] - want["x"]) / sd_x).max()),
    }


def covariance_misfit(got: Array, want: Array) -> float:
    sd = np.sqrt(np.array([np.diag(p) for p in want]))
    return float((np.abs(got - want) / (sd[:, :, None] * sd[:, None, :])).max())


def measurement_misfit(got: dict[str, Any], want: dict[str, Any]) -> dict[str, float]:
    """Largest difference of innovations over their sd, of their covariance, and of NIS."""
    s = array(want["innovation_cov"])
    sd = np.sqrt(np.array([np.diag(a) for a in s]))
    innovation, present = array(want["innovation"]), np.isfinite(array(want["innovation"]))
    assert np.array_equal(np.isfinite(got["innovation"]), present)
    nis = array(want["nis"])
    return {
        "innovation": float(np.nanmax(np.abs(got["innovation"] - innovation) / sd)),
        "innovation_cov": float(
            np.nanmax(np.abs(got["innovation_cov"] - s) / (sd[:, :, None] * sd[:, None, :]))
        ),
        "nis": float(np.max(np.abs(got["nis"] - nis) / np.maximum(nis, 1.0))),
    }


@pytest.fixture(scope="module", params=RUNS)
def pair(request: Any) -> dict[str, Any]:
    """One golden run and the engine's output for the same input."""
    golden = load(request.param)
    return {"golden": golden, "engine": engine_run(golden["config"], *inputs(golden))}


def test_reference_still_gives_the_golden_numbers():
    # GIVEN the files in the repository  WHEN the reference runs on their inputs  THEN they are not stale
    for name in RUNS:
        golden = load(name)
        out = reference_filter.run(golden["config"], *inputs(golden))
        rows = pick(out["t_ns"], golden["states"]["t_ns"])
        got = {k: out[k][rows] for k in ("lla", "v_n", "q_nb", "x")}
        want = {k: array(v) for k, v in golden["states"].items()}
        assert max(state_misfit(got, want, initial_sd(golden["config"])).values()) < TOLERANCE / 10
        rows = pick(out["t_ns"], golden["cov"]["t_ns"])
        assert covariance_misfit(out["cov"][rows], array(golden["cov"]["cov"])) < TOLERANCE / 10


def test_engine_state_agrees_with_the_reference(pair):
    golden, out = pair["golden"], pair["engine"]
    rows = pick(out["t_ns"], golden["states"]["t_ns"])
    got = {k: out[k][rows] for k in ("lla", "v_n", "q_nb", "x")}
    want = {k: array(v) for k, v in golden["states"].items()}
    misfit = state_misfit(got, want, initial_sd(golden["config"]))
    assert max(misfit.values()) < TOLERANCE, misfit


def test_engine_covariance_agrees_with_the_reference(pair):
    golden, out = pair["golden"], pair["engine"]
    rows = pick(out["cov_t_ns"], golden["cov"]["t_ns"])
    assert covariance_misfit(out["cov"][rows], array(golden["cov"]["cov"])) < TOLERANCE


def test_engine_standard_deviations_agree_with_the_reference(pair):
    golden, out = pair["golden"], pair["engine"]
    rows = pick(out["t_ns"], golden["sd"]["t_ns"])
    want = array(golden["sd"]["sd"])
    got = np.hstack([out["sd"][rows][:, 3:6], out["sd"][rows][:, 0:3], out["x_sd"][rows]])
    assert np.abs(got / want[:, 3:] - 1.0).max() < TOLERANCE


def test_engine_angle_deviations_follow_from_the_tilt_covariance(pair):
    # a small turn w of b resolved in n moves roll by (w_N cos psi + w_E sin psi) / cos theta, and so on
    golden, out = pair["golden"], pair["engine"]
    rows = pick(out["t_ns"], golden["cov"]["t_ns"])
    for row, p in zip(rows, array(golden["cov"]["cov"]), strict=True):
        _, pitch, heading = out["rpy"][row]
        c, s = np.cos(heading), np.sin(heading)
        j = np.array(
            [
                [c / np.cos(pitch), s / np.cos(pitch), 0.0],
                [-s, c, 0.0],
                [c * np.tan(pitch), s * np.tan(pitch), 1.0],
            ]
        )
        assert out["sd"][row, 6:9] == pytest.approx(np.sqrt(np.diag(j @ p[:3, :3] @ j.T)), rel=1e-8)


def test_engine_innovations_and_gate_agree_with_the_reference(pair):
    golden, meas = pair["golden"], pair["engine"]["meas"]
    assert list(meas["status"]) == golden["meas"]["status"]
    assert list(meas["dof"]) == golden["meas"]["dof"]
    misfit = measurement_misfit(meas, golden["meas"])
    # one unit in the last place of a longitude is 1e-9 m, and the fixes are half a metre good
    assert max(misfit.values()) < 10 * TOLERANCE, misfit


def as_rates(imu: dict[str, Array]) -> dict[str, Array]:
    """Increments as rates; the first row, which point rates use, repeats the second."""
    rates = {key: imu[key] / 0.01 for key in ("gyro", "accel")}
    for value in rates.values():
        value[0] = value[1]
    return imu | rates


VARIANTS: dict[str, tuple[dict[str, Any], str]] = {
    "phi order 1": ({"phi_order": 1}, "increments"),
    "phi order 2": ({"phi_order": 2}, "increments"),
    "one-sample coning": ({"coning": "one-sample"}, "increments"),
    "normal gravity": ({"gravity": "normal"}, "increments"),
    "mean rates": ({}, "mean-rates"),
    "point rates": ({}, "rates"),
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_engine_options_agree_with_the_reference(variant):
    golden = load("ned21")
    change, kind = VARIANTS[variant]
    config = golden["config"] | change
    config["imu"] = config["imu"] | {"input": kind}
    imu, gnss = inputs(golden)
    if kind != "increments":
        imu = as_rates(imu)
    want, got = reference_filter.run(config, imu, gnss), engine_run(config, imu, gnss)
    rows = pick(got["t_ns"], want["t_ns"][1:])
    parts = ("lla", "v_n", "q_nb", "x")
    misfit = state_misfit(
        {k: got[k][rows] for k in parts}, {k: want[k][1:] for k in parts}, initial_sd(config)
    )
    assert max(misfit.values()) < TOLERANCE, misfit
    rows = pick(want["t_ns"], got["cov_t_ns"])
    assert covariance_misfit(got["cov"], want["cov"][rows]) < TOLERANCE


# ---- building stones ---------------------------------------------------------------------------------------


def near(got: Array, want: Array, floor: float) -> None:
    """Within 1e-9 of each element or, for those that cancel, within a floor."""
    bad = np.abs(got - want) > TOLERANCE * np.abs(want) + floor
    assert not bad.any(), f"{np.argwhere(bad)}: {got[bad]} against {want[bad]}"


POINTS = load("jacobians")["points"]


@pytest.mark.parametrize("model", ["ned", "ecef"])
@pytest.mark.parametrize("point", range(len(POINTS)))
def test_engine_error_dynamics_agree_with_the_reference(model, point):
    p = {k: array(v) for k, v in POINTS[point].items() if k not in ("ned", "ecef")}
    want = {k: array(v) for k, v in POINTS[point][model].items()}
    got = _core.error_dynamics(model, "wgs84", "normal", p["lla"], p["v_n"], p["q_nb"], p["f_b"])
    # attitude and position rows, and columns of position, are far smaller than the velocity rows
    for rows, columns, floor in (
        (slice(0, 3), slice(0, 6), 1e-18),
        (slice(0, 3), slice(6, 9), 1e-24),
        (slice(3, 6), slice(0, 3), 1e-14),
        (slice(3, 6), slice(3, 6), 1e-17),
        (slice(3, 6), slice(6, 9), 1e-20),
        (slice(6, 9), slice(0, 9), 1e-17),
    ):
        near(got["f"][rows, columns], want["f"][rows, columns], floor)
    near(got["gyro"], want["gyro"], 1e-15)
    near(got["accel"], want["accel"], 1e-15)


@pytest.mark.parametrize("model", ["ned", "ecef"])
@pytest.mark.parametrize("point", range(len(POINTS)))
def test_engine_aiding_jacobians_agree_with_the_reference(model, point):
    p = {k: array(v) for k, v in POINTS[point].items() if k not in ("ned", "ecef")}
    want = {k: array(v) for k, v in POINTS[point][model].items()}
    got = _core.aiding_jacobians(model, "wgs84", p["lla"], p["v_n"], p["q_nb"], p["w_ib_b"], p["lever_b"])
    for key in ("position", "velocity", "velocity_gyro", "position_lever", "velocity_lever"):
        # the floor also covers the turn of the Earth rate with latitude, 1e-11 per metre of lever arm
        near(got[key], want[key], 1e-10 if key == "velocity" else 1e-14)


def test_engine_earth_agrees_with_the_reference():
    lat = np.radians(np.linspace(-89.0, 89.0, 41))
    h = np.linspace(-100.0, 20000.0, 41)
    radii = _core.radii(lat, "wgs84")
    assert np.abs(radii / np.column_stack(earth.radii(lat)) - 1.0).max() < 1e-14
    for kind in ("normal", "vertical"):
        got = _core.gravity_n(lat, h, "wgs84", kind)
        want = np.array([earth.gravity_n(a, b, kind=kind) for a, b in zip(lat, h, strict=True)])
        assert np.abs(got - want).max() < 1e-14


@pytest.mark.parametrize("coning", ["two-sample", "one-sample"])
def test_engine_strapdown_agrees_with_the_reference(coning):
    imu, _ = inputs(load("ned21"))
    start = POINTS[2]
    s = NavState(*start["lla"], array(start["v_n"]), array(start["q_nb"]))
    lla, v, q = _core.strapdown(
        "ned",
        "wgs84",
        "normal",
        coning,
        imu["t_ns"],
        imu["gyro"],
        imu["accel"],
        array(start["lla"]),
        s.v,
        s.q,
    )
    want: dict[str, list[Any]] = {"lla": [], "v_n": [], "q_nb": []}
    before = None
    for k in range(1, len(imu["t_ns"])):
        alpha, u = coning_sculling(imu["gyro"][k], imu["accel"][k], 0.01, before)
        if coning == "two-sample":
            before = (imu["gyro"][k], imu["accel"][k], 0.01)
        s, _ = step(s, alpha, u, 0.01)
        want["lla"].append([s.lat, s.lon, s.h])
        want["v_n"].append(s.v)
        want["q_nb"].append(s.q)
    got = {"lla": lla[1:], "v_n": v[1:], "q_nb": q[1:], "x": np.zeros((1000, 1))}
    misfit = state_misfit(got, {k: array(w) for k, w in want.items()} | {"x": got["x"]}, np.ones(1))
    assert max(misfit.values()) < TOLERANCE / 10, misfit


@pytest.mark.parametrize("model", ["ned", "ecef"])
@pytest.mark.parametrize("point", range(len(POINTS)))
def test_engine_dynamics_are_the_differences_of_the_equations_of_motion(model, point):
    p = {k: array(v).astype(LD) for k, v in POINTS[point].items() if k not in ("ned", "ecef")}
    lat, lon, h = p["lla"]
    c_nb, c_en = att.quat_to_dcm(p["q_nb"] / np.sqrt(np.sum(p["q_nb"] ** 2))), earth.c_en(lat, lon)
    if model == "ned":
        at, rates = (lat, h, p["v_n"], c_nb), ned_error_rates
    else:
        at, rates = (earth.lla_to_ecef(lat, lon, h), c_en @ p["v_n"], c_en @ c_nb), ecef_error_rates
    numeric = differences(lambda e: rates(e, *at, p["w_ib_b"], p["f_b"]))
    d = _core.error_dynamics(
        model, "wgs84", "normal", *(array(POINTS[point][k]) for k in ("lla", "v_n", "q_nb", "f_b"))
    )
    # the floor is the rounding of the engine's own double precision
    floor = noise_of([1.0, 50.0, 400.0]) + 1e-14 * np.abs(numeric).max(axis=1, keepdims=True)
    floor[3:6, 6:9] = 1e-20
    compare(np.hstack([d["f"], d["gyro"], d["accel"]]), numeric, floor, rel=1e-7)


def test_other_aids_jumps_floors_and_gates_by_part_agree():
    # barometer, headings, errors correlated over the way, lower bounds: nothing of it is in the golden runs
    config, imu, gnss, aids = ned22()
    want = reference_filter.run(config, imu, gnss, aids)
    got = _core.run(
        json.dumps(config),
        imu["t_ns"],
        imu["gyro"],
        imu["accel"],
        gnss["t_ns"],
        gnss["pos"],
        gnss["vel"],
        gnss["var"],
        None,
        gnss_new=gnss["new"],
        **{name: (t["t_ns"], t["value"], t["var"]) for name, t in aids.items()},
    )
    assert len(config["blocks"]) == 5
    assert got["cov"].shape[1] == 22
    rows = pick(want["t_ns"], got["t_ns"])
    misfit = state_misfit(got, {k: want[k][rows] for k in ("lla", "v_n", "q_nb", "x")}, initial_sd(config))
    assert max(misfit.values()) < TOLERANCE, misfit
    assert covariance_misfit(got["cov"], want["cov"][pick(want["t_ns"], got["cov_t_ns"])]) < TOLERANCE
    for name in aids:
        records = want[name]
        assert list(got[name]["status"]) == [r["status"] for r in records]
        sd = np.sqrt([r["variance"] for r in records])
        assert np.abs(got[name]["innovation"] - [r["innovation"] for r in records]).max() < 1e-8 * sd.min()
        assert got[name]["variance"] == pytest.approx(sd**2, rel=1e-9)
        assert got[name]["nis"] == pytest.approx([r["nis"] for r in records], rel=1e-7, abs=1e-8)
    assert [int(r) for r in got["meas"]["refused"]] == [0, 0, 0, 0b111, 0, 0, 0b111_000, 0, 0, 0]
    assert list(got["baro"]["status"]).count(1) == 1
