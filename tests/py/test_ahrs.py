"""Attitude laws over recordings: input kinds, faults in the rows, flags, errors, the Schuler tuning."""

import json
from dataclasses import asdict

import numpy as np
import pytest

import gnssins
from gnssins import _core, ahrs
from gnssins.ahrs import Cross, Integral, Levelling, Positional, Quaternion, References, Sensors
from gnssins.errors import ConfigError, GapError, InputError, TimeOrderError

G = 9.80665
NORTH = np.array([20.0, 0.0, 45.0])
LAWS = [
    Positional(42.8),
    Positional((20.0, 30.0, 40.0)),
    Integral(20.0, 100.0),
    Cross(42.8, 13.3),
    Quaternion(42.8, 13.3),
    Levelling(5.0, k_heading=5.0),
]


def turned(v_n, q_nb):
    """Vectors along n, resolved in the body axes of every row."""
    return np.einsum("kji,j->ki", _core.quat_to_dcm(q_nb), v_n)


def motion(
    n=400, dt_s=0.01, kind="rates", rate=lambda t: np.array([0.6 * np.cos(3 * t), 0.4, -0.5 * np.sin(2 * t)])
):
    """A smooth turn, integrated finely: sensors and true attitude."""
    fine = 20
    q = np.empty((n, 4))
    q[0] = _core.euler_to_quat(np.array([[0.1, -0.2, 1.0]]))[0]
    angle = np.zeros((n, 3))
    for k in range(1, n):
        at = q[k - 1 : k]
        for j in range(fine):
            t = (k - 1 + (j + 0.5) / fine) * dt_s
            step = (rate(t) * dt_s / fine)[None]
            angle[k] += step[0]
            at = _core.quat_mul(at, _core.rotvec_to_quat(step))
        q[k] = at[0]
    t_ns = (np.arange(n) * round(dt_s * 1e9)).astype(np.int64)
    gyro = (
        np.array([rate(k * dt_s) for k in range(n)])
        if kind == "rates"
        else angle / (1.0 if kind == "increments" else dt_s)
    )
    accel = turned(np.array([0.0, 0.0, -G]), q) * (dt_s if kind == "increments" else 1.0)
    return Sensors(t_ns, gyro, accel, turned(NORTH, q), kind), q


def error_deg(result, q):
    rotvec = _core.quat_to_rotvec(_core.quat_mul(result.q_nb * [1, -1, -1, -1], q))
    return np.degrees(np.linalg.norm(rotvec, axis=1))


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("kind", ["rates", "mean-rates", "increments"])
def test_every_law_follows_a_motion_in_every_kind_of_input(law, kind):
    sensors, q = motion(kind=kind)
    result = ahrs.run(sensors, law)
    assert error_deg(result, q).max() < 0.01
    assert result.has("aligned").tolist() == [True] + [False] * (len(q) - 1)
    assert result.counts["accel_used"] == result.counts["mag_used"] == result.counts["rows"] == len(q)
    assert not result.bias.any()
    np.testing.assert_allclose(result.euler, _core.quat_to_euler(result.q_nb))


@pytest.mark.parametrize("kind", ["rates", "mean-rates", "increments"])
def test_gyro_alone_keeps_the_attitude_between_samples(kind):
    # without corrections only the integration counts: increments lose the coning of the interval, rates its curvature
    sensors, q = motion(kind=kind)
    result = ahrs.run(sensors, Positional(0.0))
    assert error_deg(result, q)[-1] < {"rates": 4e-3, "mean-rates": 2e-3, "increments": 2e-3}[kind]


@pytest.mark.parametrize("form", ["rotation", "elements"])
def test_elements_are_read_as_published(form):
    sensors, _ = motion(100)
    result = ahrs.run(sensors, Cross(42.8, 13.3), form=form)
    difference = np.abs(result.element_angles - result.euler).max()
    assert difference < 1e-6  # settled: the elements are a rotation
    assert ahrs.run(sensors, Quaternion(42.8)).element_angles is None


def test_declination_turns_the_heading():
    sensors, q = motion(50)
    result = ahrs.run(sensors, Positional(10.0), references=References(declination_rad=0.2))
    heading = _core.quat_to_euler(q)[:, 2]
    # against the level, the heading is off by the declination and nothing else is
    turn = _core.quat_to_rotvec(_core.quat_mul(result.q_nb, q * [1, -1, -1, -1]))
    np.testing.assert_allclose(turn, np.tile([0.0, 0.0, 0.2], (50, 1)), atol=2e-5)
    assert heading.size == 50


def test_rows_without_magnetometer_level_only():
    # GIVEN a heading error of 20 deg and no field WHEN 4 s go by THEN the tilt is right and the heading is the gyro's
    sensors, q = motion()
    start = _core.quat_mul(_core.rotvec_to_quat(np.array([[0.02, 0.0, 0.35]])), q[:1])[0]
    nothing = np.full((len(q), 3), np.nan)
    for mag in (None, nothing, np.zeros((len(q), 3))):
        bare = Sensors(sensors.imu.t_ns, sensors.imu.gyro, sensors.imu.accel, mag)
        result = ahrs.run(bare, Cross(42.8, 13.3), initial_q_nb=start)
        turn = _core.quat_to_rotvec(_core.quat_mul(result.q_nb, q * [1, -1, -1, -1]))[-1]
        assert np.abs(turn[:2]).max() < 1e-4
        assert turn[2] == pytest.approx(0.35, abs=5e-3)
        assert result.counts["mag_bad"] == len(q) - 1
        assert result.counts["skipped"] == 1


def test_bad_rows_are_flagged_and_bridged():
    sensors, q = motion()
    gyro, accel, mag = sensors.imu.gyro.copy(), sensors.imu.accel.copy(), sensors.mag.copy()
    gyro[100:103, 1] = np.nan
    accel[200:210] = [np.inf, 0.0, 0.0]
    accel[210:220] = 0.0
    mag[300:305] = np.nan
    t_ns = sensors.imu.t_ns.copy()
    t_ns[350] = t_ns[349]
    result = ahrs.run(Sensors(t_ns, gyro, accel, mag), Cross(42.8, 13.3))
    assert np.isfinite(result.q_nb).all()
    np.testing.assert_allclose(np.linalg.norm(result.q_nb, axis=1), 1.0, atol=1e-12)
    assert np.flatnonzero(result.has("gyro_bad")).tolist() == [100, 101, 102]
    assert np.flatnonzero(result.has("accel_bad")).tolist() == list(range(200, 220))
    assert np.flatnonzero(result.has("mag_bad")).tolist() == list(range(300, 305))
    assert np.flatnonzero(result.has("skipped")).tolist() == [350]
    np.testing.assert_array_equal(result.q_nb[100:103], np.tile(result.q_nb[99], (3, 1)))
    error = error_deg(result, q)
    error[[100, 101, 102, 350]] = 0.0  # no attitude of their own
    assert error.max() < 0.03


def test_disturbed_rows_are_refused_where_a_tolerance_asks_for_it():
    sensors, q = motion()
    accel = sensors.imu.accel.copy()
    accel[100:200] += [3.0, 3.0, 0.0]
    mag = sensors.mag.copy()
    mag[250:300] += [0.0, 40.0, 0.0]
    disturbed = Sensors(sensors.imu.t_ns, sensors.imu.gyro, accel, mag)
    strict = References(accel_tolerance=0.03, field=float(np.linalg.norm(NORTH)), field_tolerance=0.02)
    refused = ahrs.run(disturbed, Positional(10.0), references=strict)
    assert error_deg(refused, q).max() < 0.2
    assert refused.counts["accel_disturbed"] > 80
    assert refused.counts["mag_disturbed"] > 40
    assert error_deg(ahrs.run(disturbed, Positional(10.0)), q).max() > 10.0


def test_time_faults_name_the_row():
    sensors, _ = motion(20)
    imu = sensors.imu
    back = imu.t_ns.copy()
    back[7] = back[5]
    with pytest.raises(TimeOrderError) as caught:
        ahrs.run(Sensors(back, imu.gyro, imu.accel), LAWS[0])
    assert caught.value.context["row"] == 7
    late = imu.t_ns.copy()
    late[9:] += 3_000_000_000
    with pytest.raises(GapError) as gap:
        ahrs.run(Sensors(late, imu.gyro, imu.accel), LAWS[0])
    assert gap.value.context["row"] == 9
    assert len(ahrs.run(Sensors(late, imu.gyro, imu.accel), LAWS[0], max_gap_s=4.0)) == 20
    # stamps at the ends of the range do not overflow
    ends = np.array([-(2**63), 2**63 - 1], dtype=np.int64)
    with pytest.raises(GapError):
        ahrs.run(Sensors(ends, imu.gyro[:2], imu.accel[:2]), LAWS[0])


def test_what_cannot_be_run_is_refused():
    sensors, _ = motion(5)
    with pytest.raises(ConfigError, match=r"law\.n"):
        ahrs.run(sensors, Cross(41.89, 51.3))
    ahrs.run(sensors, Cross(41.89, 51.3), settings={"allow_unstable": True})
    for law in (
        Positional(-1.0),
        Integral(1.0, -1.0),
        Levelling(1.0, latitude_rad=1.6),
        Quaternion(1.0, 1.1),
    ):
        with pytest.raises(ConfigError):
            ahrs.run(sensors, law)
    with pytest.raises(ConfigError, match="gyros"):
        ahrs.run(sensors, Positional(1.0), settings={"gyros": 3})
    with pytest.raises(ConfigError, match="method"):
        ahrs.run(sensors, "kalman")
    with pytest.raises(ConfigError):
        ahrs.run(sensors, Positional(float("nan")))
    with pytest.raises(ConfigError, match="initial_q_nb"):
        ahrs.run(sensors, Positional(1.0), initial_q_nb=[0.0, 0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="mag"):
        Sensors(sensors.imu.t_ns, sensors.imu.gyro, sensors.imu.accel, np.zeros((4, 3)))
    with pytest.raises(ConfigError, match="flag"):
        ahrs.run(sensors, LAWS[0]).has("happy")


def test_nothing_in_gives_nothing_out():
    empty = Sensors(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
    result = ahrs.run(empty, Positional(1.0))
    assert len(result) == 0
    assert result.q_nb.shape == (0, 4)
    assert result.to_dict()["counts"]["rows"] == 0
    one, q = motion(1)
    assert error_deg(ahrs.run(one, Positional(1.0)), q)[0] < 1e-6


def test_data_sets_and_imu_tables_go_in_too():
    sensors, q = motion(60)
    dataset = gnssins.Dataset(imu=sensors.imu, gnss=gnssins.GnssTable.empty())
    for data in (dataset, sensors.imu, sensors):
        result = ahrs.run(data, Positional(5.0), mag=sensors.mag)
        assert error_deg(result, q).max() < 0.01
    assert "aligned" in result.table()
    json.dumps(result.to_dict())


def test_references_have_the_defaults_of_the_core():
    # an unknown field would be refused, a wrong default would change the result
    sensors, _ = motion(40)
    accel = sensors.imu.accel * 1.3
    scaled = Sensors(sensors.imu.t_ns, sensors.imu.gyro, accel, sensors.mag)
    for law in LAWS:
        bare = ahrs.run(scaled, law)
        named = ahrs.run(scaled, law, settings={"references": asdict(References())})
        np.testing.assert_array_equal(bare.q_nb, named.q_nb)


RADIUS = 6.371e6
W_S = np.sqrt(G / RADIUS)


@pytest.mark.parametrize(
    ("law", "tilt_deg", "tolerance"),
    [
        (Levelling(0.0, W_S**2), 0.0, 2e-5),
        (Levelling(0.05 * W_S, W_S**2), 0.0073, 1e-4),
        (Levelling(1.1 * W_S, 1.1 * W_S**2), 0.158, 1e-3),
        (Levelling(W_S), 0.143, 1e-3),
    ],
    ids=["Schuler", "damping 0.05", "1.1", "positional"],
)
@pytest.mark.parametrize("heading_deg", [0.0, 130.0])
def test_only_the_undamped_integral_does_not_feel_acceleration(law, tilt_deg, tolerance, heading_deg):
    # 2 m/s² to the north for 10 s, the vertical turning with V/R under the level vehicle
    dt_s = 0.01
    t = np.arange(1001) * dt_s
    q = _core.euler_to_quat(np.array([[0.0, 0.0, np.radians(heading_deg)]]))
    rate = -(2.0 * (t - 0.5 * dt_s)) / RADIUS  # about east, mean of every interval
    gyro = np.column_stack([np.zeros_like(t), rate, np.zeros_like(t)]) @ _core.quat_to_dcm(q)[0]
    accel = np.tile(np.array([2.0, 0.0, -G]) @ _core.quat_to_dcm(q)[0], (t.size, 1))
    sensors = Sensors((t * 1e9).round().astype(np.int64), gyro, accel, kind="mean-rates")
    result = ahrs.run(sensors, law, initial_q_nb=q[0])
    turn = _core.quat_to_rotvec(_core.quat_mul(result.q_nb[-1:], q * [1, -1, -1, -1]))[0]
    assert np.degrees(np.linalg.norm(turn)) == pytest.approx(tilt_deg, abs=tolerance)


def test_a_degree_per_hour_costs_a_fifth_of_a_degree_at_the_schuler_frequency():
    t_ns = (np.arange(20_001) * 1_000_000_000).astype(np.int64)  # 5.6 h at 1 Hz
    gyro = np.tile([0.0, np.radians(1.0) / 3600.0, 0.0], (t_ns.size, 1))
    accel = np.tile([0.0, 0.0, -G], (t_ns.size, 1))
    result = ahrs.run(
        Sensors(t_ns, gyro, accel, kind="mean-rates"), Levelling(W_S), initial_q_nb=[1, 0, 0, 0]
    )
    assert np.degrees(result.euler[-1, 1]) == pytest.approx(0.22, abs=0.005)
