"""Forms of the strapdown equations: an independent flight, the cost of each form and rate, Earth variants."""

from functools import cache

import numpy as np
import pytest
from reference import attitude as att
from reference import earth

import gnssins
from gnssins import _core
from gnssins.analysis import agile_flight, attitude_forms, compare, earth_variants, three_rates
from gnssins.analysis.earth import gravity_down, gravity_north, inverse_radii
from gnssins.analysis.errors import Track, ned_difference
from gnssins.analysis.forms import ATTITUDE_FORMS
from gnssins.errors import ConfigError, NavigationError, StateError
from gnssins.sim import build_trajectory, scenario_from_dict, simulate

# attitude: mean, amplitude (rad), period (s) of roll, pitch, heading
ANGLES = ((0.1, 0.6, 7.3), (0.05, 0.35, 11.1), (1.2, 2.5, 61.0))


def motion(t):
    """Latitude, longitude, height, velocity, its rate, angles and their rates in closed form; all (n,) or (n, 3)."""
    w = 2.0 * np.pi / 600.0
    lat, lat1, lat2 = np.radians(55.0) + 4e-3 * np.sin(w * t), 4e-3 * w * np.cos(w * t), -4e-3 * w**2 * np.sin(w * t)
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
    """Increments by Gauss-Legendre quadrature of the closed forms, and the closed forms: nothing of the engine's step."""
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


def flown(form, rate_hz=100):
    t_ns, dtheta, dvel, truth = independent(rate_hz)
    start = truth.lla[0], truth.v_n[0], truth.q_nb[0]
    out = _core.strapdown(
        "ned", "wgs84", "normal", "two-sample", t_ns, dtheta, dvel, *start, attitude_form=form
    )
    return np.linalg.norm(ned_difference(out[0][-1:], truth.lla[-1:])[0])
