"""Rotations: quaternion [w, x, y, z], rotation vector, matrix, Euler angles (Z-Y-X)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def skew(v: Array) -> Array:
    """Matrix (3, 3) of the cross product ``v x``."""
    z = v[0] * 0.0
    return np.array([[z, -v[2], v[1]], [v[2], z, -v[0]], [-v[1], v[0], z]])


def exp_quat(rotvec: Array) -> Array:
    """Quaternion (4,) of a rotation vector (3,), rad."""
    half = np.sqrt(np.sum(rotvec**2)) / 2.0
    # sin(x)/x by its series near zero, where the quotient would be 0/0
    sinc = 1.0 - half**2 / 6.0 + half**4 / 120.0 if half < 1e-3 else np.sin(half) / half
    return np.concatenate([[np.cos(half)], 0.5 * sinc * rotvec])


def log_quat(q: Array) -> Array:
    """Rotation vector (3,), rad, shorter than or equal to pi, of a unit quaternion (4,)."""
    q = -q if q[0] < 0.0 else q
    n = np.sqrt(np.sum(q[1:] ** 2))
    if n < 1e-9:
        return 2.0 * q[1:]
    return 2.0 * np.arctan2(n, q[0]) / n * q[1:]


def quat_mul(p: Array, q: Array) -> Array:
    """Hamilton product (4,): the rotation q first, then p."""
    w = p[0] * q[0] - p[1:] @ q[1:]
    return np.concatenate([[w], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])


def quat_inv(q: Array) -> Array:
    """Inverse (4,) of a unit quaternion."""
    return np.concatenate([q[:1], -q[1:]])


def quat_to_dcm(q: Array) -> Array:
    """Rotation matrix (3, 3) of a unit quaternion (4,)."""
    s = skew(q[1:])
    return np.eye(3) + 2.0 * q[0] * s + 2.0 * s @ s


def exp_dcm(rotvec: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,), rad."""
    return quat_to_dcm(exp_quat(rotvec))


def dcm_to_quat(c: Array) -> Array:
    """Unit quaternion (4,) of a rotation matrix (3, 3), by the largest pivot: Shepperd (1978)."""
    tr = np.trace(c)
    pivots = [tr, c[0, 0], c[1, 1], c[2, 2]]
    i = int(np.argmax(pivots))
    q = np.empty(4, dtype=c.dtype)
    if i == 0:
        q[0] = 1.0 + tr
        q[1:] = [c[2, 1] - c[1, 2], c[0, 2] - c[2, 0], c[1, 0] - c[0, 1]]
    else:
        a, b, d = i - 1, i % 3, (i + 1) % 3
        q[0] = c[d, b] - c[b, d]
        q[1 + a] = 1.0 + 2.0 * c[a, a] - tr
        q[1 + b] = c[b, a] + c[a, b]
        q[1 + d] = c[d, a] + c[a, d]
    return q / np.sqrt(np.sum(q**2))


def euler_to_quat(roll: Any, pitch: Any, heading: Any) -> Array:
    """Quaternion q_nb (4,) of roll, pitch and heading (rad), rotations in the order Z-Y-X."""
    x, y, z = np.eye(3)
    return quat_mul(exp_quat(heading * z), quat_mul(exp_quat(pitch * y), exp_quat(roll * x)))


def quat_to_euler(q: Array) -> Array:
    """Roll, pitch, heading (3,), rad; heading in [-pi, pi]."""
    c = quat_to_dcm(q)
    pitch = np.arctan2(-c[2, 0], np.hypot(c[2, 1], c[2, 2]))
    return np.array([np.arctan2(c[2, 1], c[2, 2]), pitch, np.arctan2(c[1, 0], c[0, 0])])
