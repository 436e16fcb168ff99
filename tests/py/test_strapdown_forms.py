"""Forms of the strapdown equations: an independent flight, the cost of each form and rate, Earth variants."""

from functools import cache

import numpy as np
import pytest

import gnssins
from gnssins import _core
from gnssins.analysis import agile_flight, attitude_forms, compare, earth_variants, three_rates
from gnssins.analysis.earth import gravity_down, gravity_north, inverse_radii
from gnssins.analysis.errors import Track, ned_difference
from gnssins.analysis.forms import ATTITUDE_FORMS
from gnssins.errors import ConfigError, NavigationError, StateError
from gnssins.sim import build_trajectory, scenario_from_dict, simulate
from reference import earth

# attitude: mean, amplitude (rad), period (s) of roll, pitch, heading
ANGLES = ((0.1, 0.6, 7.3), (0.05, 0.35, 11.1), (1.2, 2.5, 61.0))


def motion(t):
    """Latitude, longitude, height, velocity, its rate, angles and their rates in closed form; all (n,) or (n, 3)."""
    w = 2.0 * np.pi / 600.0
    lat, lat1, lat2 = (
        np.radians(55.0) + 4e-3 * np.sin(w * t),
        4e-3 * w * np.cos(w * t),
        -4e-3 * w**2 * np.sin(w * t),
    )
    lon1 = 4e-5
    lon = 0.5 + lon1 * t
    h, h1, h2 = 5000.0 * (1 - np.cos(w * t)), 5000.0 * w * np.sin(w * t), 5000.0 * w**2 * np.cos(w * t)
    rm, rn = earth.radii(lat)
    s, c = np.sin(lat), np.cos(lat)
    e2 = earth.WGS84.e2
    share = e2 * s * c / (1.0 - e2 * s * s) * lat1
    rm1, rn1 = 3.0 * share * rm, share * rn
    v = np.stack([lat1 * (rm + h), lon1 * (rn + h) * c, -h1], axis=-1)
    v1 = np.stack(
        [lat2 * (rm + h) + lat1 * (rm1 + h1), lon1 * ((rn1 + h1) * c - (rn + h) * s * lat1), -h2], axis=-1
    )
    angles = [m + a * np.sin(2.0 * np.pi * t / p) for m, a, p in ANGLES]
    rates = [a * 2.0 * np.pi / p * np.cos(2.0 * np.pi * t / p) for m, a, p in ANGLES]
    return lat, lon, h, v, v1, angles, rates, (rm, rn)


def sensors(t):
    """Angular rate and specific force in body axes (n, 3), from the equations of motion written out."""
    lat, _, h, v, v1, (roll, pitch, heading), (roll1, pitch1, heading1), (rm, rn) = motion(t)
    s, c = np.sin(lat), np.cos(lat)
    zero = np.zeros_like(t)
    w_ie = earth.WGS84.omega * np.stack([c, zero, -s], axis=-1)
    w_en = np.stack([v[:, 1] / (rn + h), -v[:, 0] / (rm + h), -v[:, 1] * s / c / (rn + h)], axis=-1)
    g = np.array(_core.gravity_n(lat, h, "wgs84"))
    f_n = v1 + np.cross(2.0 * w_ie + w_en, v) - g
    c_nb = np.array(_core.quat_to_dcm(_core.euler_to_quat(np.stack([roll, pitch, heading], axis=-1))))
    w_nb = np.stack(
        [
            roll1 - heading1 * np.sin(pitch),
            pitch1 * np.cos(roll) + heading1 * np.cos(pitch) * np.sin(roll),
            heading1 * np.cos(pitch) * np.cos(roll) - pitch1 * np.sin(roll),
        ],
        axis=-1,
    )
    to_body = np.swapaxes(c_nb, 1, 2)
    return w_nb + np.einsum("nij,nj->ni", to_body, w_ie + w_en), np.einsum("nij,nj->ni", to_body, f_n)


@cache
def independent(rate_hz=100, duration_s=900.0):
    """Increments by Gauss-Legendre quadrature of the closed forms, and these: nothing of the engine's step."""
    t_ns = np.arange(int(duration_s * rate_hz) + 1) * (1_000_000_000 // rate_hz)
    t, dt = t_ns / 1e9, 1.0 / rate_hz
    dtheta, dvel = np.zeros((t.size, 3)), np.zeros((t.size, 3))
    nodes, weights = np.polynomial.legendre.leggauss(4)
    for node, weight in zip(nodes, weights, strict=True):
        w, f = sensors(t[:-1] + 0.5 * dt * (1.0 + node))
        dtheta[1:] += 0.5 * dt * weight * w
        dvel[1:] += 0.5 * dt * weight * f
    lat, lon, h, v, _, angles, _, _ = motion(t)
    q = np.array(_core.euler_to_quat(np.stack(angles, axis=-1)))
    return t_ns, dtheta, dvel, Track(t_ns, np.stack([lat, lon, h], axis=-1), v, q)


def closed(form="rotation-vector", coning="two-sample", rate_hz=100):
    """Position error (m) after 900 s on the independent flight."""
    t_ns, dtheta, dvel, truth = independent(rate_hz)
    start = truth.lla[0], truth.v_n[0], truth.q_nb[0]
    out = _core.strapdown("ned", "wgs84", "normal", coning, t_ns, dtheta, dvel, *start, attitude_form=form)
    return float(np.linalg.norm(ned_difference(out[0][-1:], truth.lla[-1:])[0]))


def test_agile_flight_in_closed_form_closes_within_a_centimetre_after_900_s():
    assert closed(coning="third-order") < 0.01
    # the forms of fourth order too: what is left is the step of the velocity
    assert closed("quaternion", "third-order") < 0.01
    assert closed("euler", "third-order") < 0.01
    # what is left falls with the third power of the interval
    assert closed(coning="third-order", rate_hz=50) / closed(coning="third-order") == pytest.approx(
        8.0, rel=0.05
    )


def test_sculling_to_second_order_costs_what_the_third_order_term_says():
    # (w dt)^2/6 of the specific force across the turn: metres at 100 Hz, four times as much at 50 Hz
    assert 10.0 < closed() < 14.0
    assert closed(rate_hz=50) / closed() == pytest.approx(4.0, rel=0.01)


def test_second_order_forms_miss_on_the_independent_flight():
    t_ns, dtheta, dvel, truth = independent(100)
    start = truth.lla[0], truth.v_n[0], truth.q_nb[0]
    ends = {}
    for form in ATTITUDE_FORMS:
        q = _core.strapdown(
            "ned", "wgs84", "normal", "third-order", t_ns, dtheta, dvel, *start, attitude_form=form
        )[2][-1:]
        turn = _core.quat_mul(truth.q_nb[-1:], q * np.array([1.0, -1.0, -1.0, -1.0]))
        ends[form] = float(np.linalg.norm(_core.quat_to_rotvec(turn)))
    for form in ("rotation-vector", "euler", "quaternion"):
        assert ends[form] < 2e-8, ends
    for form in ("picard", "two-quaternions"):
        assert 5e-8 < ends[form] < 5e-6, ends
    assert ends["dcm"] / ends["picard"] == pytest.approx(4.0, rel=0.3)


@cache
def agile():
    return agile_flight(300.0)


def test_form_errors_on_the_agile_flight_lie_between_stated_bounds():
    found = attitude_forms(agile())
    assert [f.name for f in found.forms] == list(ATTITUDE_FORMS)
    assert found["rotation-vector"].largest_position_m < 1e-6
    for name in ("euler", "quaternion"):
        assert 1e-7 < found[name].largest_position_m < 1e-3, found.table()
    # about 1/3 of the 900 s table of the documentation: 150, 150 and 600 microradians after 900 s
    for name in ("picard", "two-quaternions"):
        assert 3e-5 < found[name].attitude_rad < 8e-5, found.table()
        assert 10.0 < found[name].largest_position_m < 40.0, found.table()
    assert found["dcm"].attitude_rad / found["picard"].attitude_rad == pytest.approx(4.0, rel=0.05)
    assert found["dcm"].largest_position_m / found["picard"].largest_position_m == pytest.approx(4.0, rel=0.1)
    assert all(f.time_ratio > 0.0 for f in found.forms)


def test_every_rate_of_the_split_costs_what_it_should():
    body = three_rates(agile(), [(1, 1), (1, 50), (5, 10)])
    turned = three_rates(agile(), [(1, 1), (1, 50), (5, 10)], gather="navigation")
    assert [f.name for f in body.forms] == ["100/100/100", "100/100/2", "100/20/2"]
    assert body["100/100/100"].largest_position_m < 1e-4
    assert 1e-5 < body["100/100/2"].largest_position_m < 1e-2
    assert 50.0 < body["100/20/2"].largest_position_m < 500.0, body.table()
    assert turned["100/20/2"].largest_position_m < 1e-2, turned.table()
    assert "gathered in body axes" in body.table()
    assert body.to_dict()["forms"]["100/20/2"]["position_m"] == body["100/20/2"].position_m


def test_what_is_no_form_is_refused():
    flight = agile_flight(2.0)
    with pytest.raises(ConfigError, match='attitude_form "matrix" is not known'):
        attitude_forms(flight, ["matrix"])
    with pytest.raises(ConfigError, match="divisor"):
        three_rates(flight, [(0, 1)])
    with pytest.raises(ConfigError, match="gather"):
        three_rates(flight, [(1, 1)], gather="earth")
    tables = {
        "scenario": {"name": "e", "duration_s": 2.0},
        "truth": {"model": "ecef"},
        "start": {"lat_deg": 10.0, "lon_deg": 0.0, "heading_deg": 0.0},
        "initial_error": {"attitude_sd_deg": 0.0, "velocity_sd_m_s": 0.0, "position_sd_m": 0.0},
    }
    path = build_trajectory(scenario_from_dict(tables))
    for function in (attitude_forms, three_rates):
        with pytest.raises(ConfigError, match="NED model"):
            function(path)
    columns = path.t_ns, path.dtheta, path.dvel, path.lla[0], path.v_n[0], path.q_nb[0]
    with pytest.raises(ConfigError, match="ECEF model has no other"):
        _core.strapdown("ecef", "wgs84", "normal", "two-sample", *columns, attitude_form="dcm")


def test_euler_form_refuses_a_loop_and_the_exact_form_flies_it():
    # pitch from 0 through the vertical at 0.2 rad/s
    t_ns = np.arange(1001) * 10_000_000
    dtheta, dvel = np.zeros((1001, 3)), np.zeros((1001, 3))
    dtheta[1:, 1], dvel[1:, 2] = 0.002, -0.098
    start = [0.9, 0.0, 1000.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    model = "ned", "wgs84", "normal", "two-sample"
    with pytest.raises(
        NavigationError, match=r"pitch of 85\.\d+ deg is beyond the limit 85\.0 deg(.|\n)*rotation-vector"
    ):
        _core.strapdown(*model, t_ns, dtheta, dvel, *start, attitude_form="euler")
    for form in ATTITUDE_FORMS:
        if form != "euler":
            q = _core.strapdown(*model, t_ns, dtheta, dvel, *start, attitude_form=form)[2]
            assert np.isfinite(q).all()
    nan = dtheta.copy()
    nan[500] = np.nan
    for form in ATTITUDE_FORMS:
        with pytest.raises(StateError, match="not finite"):
            _core.strapdown(*model, t_ns[:700], nan[:700] * [0, 1, 0], dvel[:700], *start, attitude_form=form)


def test_the_filter_runs_in_every_form_and_knows_which():
    simulated = simulate("static", seed=3)
    tables = {"filter": {"preset": "ned-15"}, "imu": {"kind": "increments"}, "run": {"end_s": 20.0}}
    results = {
        form: gnssins.run(tables | {"filter": {"preset": "ned-15", "attitude_form": form}}, simulated)
        for form in ATTITUDE_FORMS
    }
    plain = gnssins.run(tables, simulated)
    exact = results.pop("rotation-vector")
    for name in ("lla", "v_n", "q_nb", "sd"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(exact, name))
    assert plain.final_state == exact.final_state
    for form, result in results.items():
        error = compare(result, exact)
        assert 0.0 < np.abs(error.phi).max() < 1e-5, form
    with pytest.raises(ConfigError, match=r'attitude_form(.|\n)*the ECEF model has(.|\n)*model = "ned"'):
        gnssins.run(
            {"filter": {"preset": "ecef-15", "attitude_form": "dcm"}, "imu": {"kind": "increments"}},
            simulated,
        )


def test_earth_variants_have_the_published_errors():
    found = earth_variants()
    relative = {
        ("1/(R_M+h)", "short"): 4.5e-5,
        ("1/(R_P+h)", "short"): 2.5e-5,
        ("1/(R_M+h)", "short, printed"): 1.35e-2,
        ("1/(R_M+h)", "long"): 3e-7,
        ("1/(R_P+h)", "long"): 1.5e-7,
    }
    for key, expected in relative.items():
        assert abs(found[key].error) == pytest.approx(expected, rel=0.05), key
    mgal = {
        "short": (20.5, 21.5),
        "short, printed": (470.0, 485.0),
        "long": (0.3, 0.55),
        "long, printed": (23.5, 24.7),
        "regrouped": (0.3, 0.55),
        "regrouped, printed": (3350.0, 3450.0),
        "mu/a^2": (1790.0, 1815.0),
    }
    for form, (low, high) in mgal.items():
        assert low < abs(found["gravity down", form].error) / 1e-5 < high, form
    assert abs(found["gravity north", "series"].error) < 1e-6
    assert "1804 mGal" in found.table()
    assert len(found.to_dict()["errors"]) == len(found.errors) == 14


def test_earth_forms_are_what_they_stand_for():
    lat, height = np.radians([0.0, 45.0, 90.0]), np.zeros(3)
    # on the ellipsoid at the equator: a and b^2/a; g_N vanishes there, at the equator and at the pole
    m, n = inverse_radii("closed", lat, height)
    assert 1.0 / n[0] == pytest.approx(6378137.0, abs=1e-6)
    assert 1.0 / m[0] == pytest.approx(6356752.314245**2 / 6378137.0, abs=1e-3)
    assert m[2] == pytest.approx(n[2], rel=1e-14)
    for form in ("series", "closed"):
        np.testing.assert_allclose(gravity_north(form, lat, 1e4), [0.0, -8.2e-5, 0.0], atol=2e-6)
        np.testing.assert_allclose(gravity_north(form, lat, 0.0), 0.0, atol=1e-18)
    # both long series are one formula
    rng = np.random.default_rng(1)
    at = rng.uniform(-1.5, 1.5, 50), rng.uniform(0.0, 2e4, 50)
    np.testing.assert_allclose(gravity_down("long", *at), gravity_down("regrouped", *at), rtol=3e-8)
    assert gravity_down("closed", [0.0], 0.0)[0] == pytest.approx(9.7803253359, abs=1e-10)
    with pytest.raises(ConfigError, match="closed"):
        gravity_down("none", [0.0], 0.0)


def test_what_the_printed_equations_do():
    # the figures that the page of the strapdown forms quotes
    lat, _, h, v, _, _, _, (rm, rn) = motion(np.arange(0.0, 900.0, 1.0))
    s, c, zero = np.sin(lat), np.cos(lat), np.zeros_like(lat)
    w_ie = earth.WGS84.omega * np.stack([c, zero, -s], axis=-1)
    w_en = np.stack([v[:, 1] / (rn + h), -v[:, 0] / (rm + h), -v[:, 1] * s / c / (rn + h)], axis=-1)
    reversed_coriolis = 2.0 * np.cross(2.0 * w_ie + w_en, v)
    assert np.abs(reversed_coriolis[:, 1]).max() == pytest.approx(0.082, abs=0.001)
    assert np.linalg.norm(reversed_coriolis, axis=1).max() == pytest.approx(0.108, abs=0.001)
    # initial quaternion: yaw about the second axis (up), pitch about the third, against the formula of an NED frame
    yaw, pitch, roll = np.radians([-60.0, 5.0, 3.0]) / 2.0
    sy, cy, st, ct, sg, cg = (
        np.sin(yaw),
        np.cos(yaw),
        np.sin(pitch),
        np.cos(pitch),
        np.sin(roll),
        np.cos(roll),
    )
    about = [
        np.array(q)
        for q in ((np.cos(yaw), 0.0, sy, 0.0), (np.cos(pitch), 0.0, 0.0, st), (np.cos(roll), sg, 0.0, 0.0))
    ]
    product = _core.quat_mul(_core.quat_mul(about[0][None], about[1][None]), about[2][None])[0]
    right = [
        cy * ct * cg - sy * st * sg,
        cy * ct * sg + sy * st * cg,
        sy * ct * cg + cy * st * sg,
        cy * st * cg - sy * ct * sg,
    ]
    np.testing.assert_allclose(product, right, atol=1e-15)
    printed = [
        cy * ct * cg + sy * st * sg,
        cy * ct * sg - sy * st * cg,
        cy * st * cg + sy * ct * sg,
        sy * ct * cg - cy * st * sg,
    ]
    assert np.degrees(2.0 * np.arccos(abs(np.dot(right, printed)))) == pytest.approx(89.5, abs=0.1)
    # squared length without renormalisation after 900 s at 100 Hz and 1 rad/s: second order, first order
    e = 0.01**2
    assert (1.0 + e**2 / 64.0) ** 90_000 - 1.0 == pytest.approx(1.4e-5, rel=0.01)
    assert (1.0 + e / 4.0) ** 90_000 == pytest.approx(9.5, rel=0.01)
