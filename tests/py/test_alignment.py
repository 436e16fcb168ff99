"""The state to start from: found from data whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gnssins
from gnssins import Config, Dataset, GnssTable, ImuTable, _core, initial_state
from gnssins.alignment import InitialState
from gnssins.analysis.errors import interpolate, ned_difference, phi_between
from gnssins.errors import DataQualityError, InputError
from gnssins.leveling import level, mean_specific_force
from short_flight import config, simulated, simulator

S = 1_000_000_000
G_N = np.array([0.0, 0.0, 9.8])


def tables(**initial: object) -> dict:
    """A configuration of a MEMS filter with some keys of [initial]."""
    return {
        "filter": {"preset": "ned-15"},
        "gnss": {"position_sd_m": 1.0, "velocity_sd_m_s": 0.05},
        "initial": initial,
    }


def error_free(lever: tuple[float, float, float] = (0.0, 0.0, 0.0), gnss_rate_hz: float = 5.0) -> Dataset:
    """The flight with perfect sensors, fixes of the antenna without noise."""
    path = simulator().trajectory
    imu = ImuTable(path.t_ns[1:], path.dtheta[1:], path.dvel[1:], "increments")
    rows = np.arange(0, len(path), round(50 / gnss_rate_hz))
    c_nb = _core.quat_to_dcm(path.q_nb)
    dt = np.diff(path.t_ns, prepend=path.t_ns[0] - 20_000_000) / S
    offset = c_nb @ np.array(lever)
    swing = np.einsum("kij,kj->ki", c_nb, np.cross(path.dtheta / dt[:, None], lever))
    radii = _core.radii(path.lla[:, 0].copy(), "wgs84") + path.lla[:, 2:]
    lla = path.lla + np.column_stack(
        [offset[:, 0] / radii[:, 0], offset[:, 1] / radii[:, 1] / np.cos(path.lla[:, 0]), -offset[:, 2]]
    )
    var = np.tile([1.0, 1.0, 1.0, 0.05**2, 0.05**2, 0.05**2], (rows.size, 1))
    gnss = GnssTable(path.t_ns[rows], lla[rows], (path.v_n + swing)[rows], var)
    return Dataset(imu, gnss, simulated().dataset.truth)


def at_rest(roll: float, pitch: float, seconds: float = 5.0) -> ImuTable:
    q = _core.euler_to_quat(np.array([[roll, pitch, 0.3]]))
    f_b = _core.quat_to_dcm(q)[0].T @ -G_N
    t = np.arange(1, round(seconds * 100) + 1) * 10_000_000
    return ImuTable(t, np.zeros((t.size, 3)), np.tile(f_b, (t.size, 1)), "rates")


def given_start(**more: object) -> dict:
    return {
        "position": {"lat_deg": 48.0, "lon_deg": 9.0, "height_m": 300.0},
        "position_sd_m": 1.0,
        "velocity": [0.0, 0.0, 0.0],
        "velocity_sd_m_s": 0.05,
        "heading_deg": 20.0,
        **more,
    }


angle = st.floats(-3.0, 3.0)


@given(
    roll=st.floats(-3.1, 3.1), pitch=st.floats(-1.4, 1.4), heading=angle, north=angle, east=angle, down=angle
)
def test_leveling_inverts_any_attitude_and_acceleration(roll, pitch, heading, north, east, down):
    f_n = np.array([north, east, down]) - G_N
    c_nb = _core.quat_to_dcm(_core.euler_to_quat(np.array([[roll, pitch, heading]])))[0]
    found = level(c_nb.T @ f_n, f_n, heading)
    again = _core.quat_to_dcm(_core.euler_to_quat(np.array([[*found, heading]])))[0]
    # two attitudes share a heading and a specific force; the one found must reproduce the force
    assert np.allclose(again @ (c_nb.T @ f_n), f_n, atol=1e-9)
    if abs(roll) < 1.0:
        assert np.allclose(found, (roll, pitch), atol=1e-9)


def test_at_rest_the_accelerometer_gives_roll_and_pitch():
    roll, pitch = np.radians([3.0, -5.0])
    data = Dataset(at_rest(roll, pitch))
    start = initial_state(Config.from_dict(tables(**given_start())), data)
    rpy = _core.quat_to_euler(start.q_nb[None])[0]
    assert np.allclose(rpy, [roll, pitch, np.radians(20.0)], atol=1e-9)
    assert start.t_ns == data.imu.t_ns[0]
    assert np.allclose(np.degrees(start.sd_phi), [2.0, 2.0, 10.0], atol=0.05)


def test_a_known_accelerometer_bias_is_taken_off_before_leveling():
    whole = tables(**given_start())
    whole["imu"] = {"accel": {"bias_mg": [50.0, 0.0, 0.0]}}
    imu = at_rest(0.0, 0.0)
    biased = replace(imu, accel=imu.accel + [50e-3 * 9.80665, 0.0, 0.0])
    rpy = _core.quat_to_euler(initial_state(Config.from_dict(whole), Dataset(biased)).q_nb[None])[0]
    # the normal gravity of the engine leans by 2e-7 rad at this height
    assert np.allclose(rpy[:2], 0.0, atol=1e-6)


def test_the_sd_of_leveling_grows_with_the_accelerometer_bias():
    whole = tables(**given_start())
    whole["filter"]["block"] = [{"kind": "accel_bias", "unit": "mg", "initial_sd": 100.0}]
    start = initial_state(Config.from_dict(whole), Dataset(at_rest(0.0, 0.0)))
    assert np.degrees(start.sd_phi[0]) == pytest.approx(np.degrees(0.1), rel=0.1)


def test_sds_that_the_configuration_gives_are_taken_as_they_are():
    keys = given_start(roll_sd_deg=0.5, pitch_sd_deg=0.25, heading_sd_deg=1.0, heading_deg=0.0)
    start = initial_state(Config.from_dict(tables(**keys)), Dataset(at_rest(0.0, 0.0)))
    assert np.allclose(np.degrees(start.sd_phi), [0.5, 0.25, 1.0])


@pytest.mark.parametrize("start_s", [20.0, 100.0, 215.0])
@pytest.mark.parametrize("lever", [(0.0, 0.0, 0.0), (2.0, -1.0, -3.0)])
def test_in_flight_the_state_is_found_from_fixes_and_sensors(start_s, lever):
    # straight, climbing, and in a turn of 2 deg/s
    data = error_free(lever)
    whole = {**tables(heading="course"), "run": {"start_s": start_s}}
    whole["gnss"]["lever_ba_b_m"] = list(lever)
    start = initial_state(Config.from_dict(whole), data)
    true = interpolate(data.truth, np.array([start.t_ns]))
    assert start.t_ns in data.imu.t_ns
    assert 0 < start.t_ns - start_s * S <= 0.22 * S
    assert np.linalg.norm(ned_difference(start.lla[None], true.lla)) < 0.05
    assert np.linalg.norm(start.v_n - true.v_n[0]) < 0.15
    assert np.degrees(np.abs(phi_between(start.q_nb[None], true.q_nb))).max() < 0.3


def test_positions_alone_give_velocity_and_course():
    data = error_free(gnss_rate_hz=10.0)
    whole = tables(heading="course")
    whole["gnss"]["use"] = "position"
    start = initial_state(Config.from_dict(whole), data)
    true = interpolate(data.truth, np.array([start.t_ns]))
    assert np.linalg.norm(start.v_n - true.v_n[0]) < 0.05
    assert np.degrees(np.abs(phi_between(start.q_nb[None], true.q_nb))).max() < 0.3
    assert (start.sd_v > 0.5).all()


def test_the_fix_that_starts_the_filter_is_not_used_again():
    data = error_free()
    r = gnssins.run(Config.from_dict(tables(heading="course")), data)
    before = r.records.t_ns < r.t_ns[0]
    assert r.t_ns[0] - r.records.t_ns[before][-1] == 20_000_000
    assert r.records.is_status("late")[before].all()
    assert r.records.is_status("used")[~before].all()


def test_the_start_waits_for_motion_that_shows_a_course():
    data = error_free()
    v_n = np.array(data.gnss.v_n)
    v_n[:50] = 0.0
    start = initial_state(
        Config.from_dict(tables(heading="course")), replace(data, gnss=replace(data.gnss, v_n=v_n))
    )
    assert start.t_ns == data.gnss.t_ns[50] + 20_000_000


def test_a_withheld_fix_does_not_start_the_filter():
    whole = {**tables(heading="course"), "run": {"outages": [[0.0, 10.0]]}}
    assert initial_state(Config.from_dict(whole), error_free()).t_ns == 10 * S + 20_000_000


def test_latency_is_taken_off_before_the_fix_is_used():
    data = error_free()
    shifted = replace(data, gnss=replace(data.gnss, t_ns=data.gnss.t_ns + 500_000_000))
    whole = tables(heading="course")
    expected = initial_state(Config.from_dict(whole), data)
    whole["gnss"]["latency_ms"] = 500.0
    found = initial_state(Config.from_dict(whole), shifted)
    assert found.t_ns == expected.t_ns
    assert np.array_equal(found.lla, expected.lla)


@pytest.mark.parametrize("fault", ["null", "infinite", "zero variance", "negative variance", "no variance"])
def test_fixes_that_are_none_do_not_start_the_filter(fault):
    data = error_free()
    lla, var = np.array(data.gnss.lla), np.array(data.gnss.var)
    first = slice(0, 30)
    if fault == "null":
        lla[first, :2] = 0.0
    elif fault == "infinite":
        lla[first, 2] = np.inf
    else:
        var[first] = {"zero variance": 0.0, "negative variance": -1.0, "no variance": np.nan}[fault]
    broken = replace(data, gnss=replace(data.gnss, lla=lla, var=var))
    whole = Config.from_dict(tables(heading="course"))
    start = initial_state(whole, broken)
    assert start.t_ns == data.gnss.t_ns[30] + 20_000_000
    assert start.lla[0] == pytest.approx(data.gnss.lla[30, 0], abs=1e-5)


def test_fixes_that_are_all_none_are_counted():
    data = error_free()
    nowhere = replace(data, gnss=replace(data.gnss, lla=np.zeros_like(data.gnss.lla)))
    with pytest.raises(InputError, match="of them at 0, 0") as caught:
        initial_state(Config.from_dict(tables(heading="course")), nowhere)
    assert caught.value.code == "input.no_start_fix"


def test_motion_after_the_end_does_not_start_the_filter():
    data = error_free()
    v_n = np.array(data.gnss.v_n)
    v_n[:200] = 0.0
    late = replace(data, gnss=replace(data.gnss, v_n=v_n))
    whole = {**tables(heading="course"), "run": {"start_s": 5.0, "end_s": 30.0}}
    words = "no fix faster than course_min_speed_m_s = 1 .* between 5 and 30 s"
    with pytest.raises(InputError, match=words) as caught:
        gnssins.run(Config.from_dict(whole), late)
    assert caught.value.code == "input.no_start_fix"
    assert "heading_deg" in caught.value.hint
    assert "end_s" in caught.value.hint


def test_the_recorded_drive_without_motion_before_the_end_is_an_error(repository, shared_data):
    text = Config.load(repository / "examples" / "car-rtkx-drive.toml")
    folder = shared_data / "car-rtkx-drive"
    files = {name: {"file": str(folder / f"{name}.csv.gz")} for name in ("imu", "gnss")}
    with pytest.raises(InputError, match="between 5 and 30 s") as caught:
        gnssins.run(text.replace(run={"start_s": 5.0, "end_s": 30.0}, **files))
    assert caught.value.code == "input.no_start_fix"


def test_clear_errors_say_what_is_missing():
    data = error_free()
    still = replace(data, gnss=replace(data.gnss, v_n=np.zeros_like(data.gnss.v_n)))
    cases = [
        (tables(heading="course"), still, InputError, "input.no_course", "fastest 0.00 m/s"),
        (tables(), replace(data, gnss=GnssTable.empty()), InputError, "input.no_start_fix", "0 fixes in all"),
        (
            tables(**given_start(position_sd_m=None)),
            Dataset(at_rest(0, 0)),
            InputError,
            "input.no_sd",
            "position",
        ),
        (tables(), Dataset(at_rest(0, 0).select(slice(0, 1))), InputError, "input.empty", "1 rows"),
    ]
    for keys, dataset, kind, code, words in cases:
        keys["initial"] = {k: v for k, v in keys["initial"].items() if v is not None}
        with pytest.raises(kind, match=words) as caught:
            initial_state(Config.from_dict(keys), dataset)
        assert caught.value.code == code
        assert caught.value.hint


def test_an_accelerometer_in_g_is_found_out():
    imu = at_rest(0.0, 0.0)
    with pytest.raises(DataQualityError, match="accel_unit"):
        initial_state(Config.from_dict(tables(**given_start())), Dataset(replace(imu, accel=imu.accel / 9.8)))


def test_rates_and_increments_give_the_same_mean_force():
    imu = error_free().imu
    rates = ImuTable(imu.t_ns, imu.gyro / 0.02, imu.accel / 0.02, "mean-rates")
    a, b = (mean_specific_force(table, 5 * S, 7 * S) for table in (imu, rates))
    assert np.allclose(a[0], b[0], rtol=1e-12)
    assert a[1] == b[1] == pytest.approx(2.0)


def test_a_state_survives_the_way_through_the_engine_configuration():
    start = simulated().initial
    again = InitialState.from_engine(start.to_engine())
    assert again.to_engine() == start.to_engine()
    assert config().engine_config(start.to_engine())["initial"]["t_ns"] == 0


def test_a_receiver_at_rest_with_a_noisy_velocity_shows_no_course():
    parked = gnssins.simulate("static", seed=3)
    random = np.random.default_rng(3)
    gnss = parked.dataset.gnss
    noisy = replace(
        gnss,
        v_n=random.normal(0.0, 0.5, gnss.v_n.shape),
        var=np.hstack([gnss.var[:, :3], np.full((len(gnss), 3), 0.25)]),
    )
    assert np.hypot(*noisy.v_n[:, :2].T).max() > 1.0
    config = gnssins.Config.from_dict(
        {"imu": {"kind": "increments"}, "filter": {"preset": "ned-15"}, "initial": {"heading": "course"}}
    )
    with pytest.raises(InputError, match="course"):
        gnssins.initial_state(config, replace(parked.dataset, gnss=noisy))
