"""Checks of the inertial samples: units, axes, missing and saturated values."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..config import Config, axes_matrix, proper_letters
from ..dataset import Array
from ..units import DEG_TO_RAD, STANDARD_GRAVITY_M_S2
from .findings import Finding
from .look import ImuLook
from .motion import Fit, Steps, Windows, fit

_G = STANDARD_GRAVITY_M_S2
_LIKE = 0.15
"""Relative distance to a wrong-unit value that still counts as a match."""

_MANY_TOO_FAST = 0.001
"""Share of angular rates beyond what any gyro reads that is more than a few spikes."""

_LARGEST_BIAS_DEG_S = 3.0
"""Gyro bias that is told; even cheap sensors stay below."""

_AT_REST_RAD_S = 0.03
"""Rate below which a calm second counts as rest."""

_READ_AS_RAD_S = '[imu] gyro_unit = "deg/s" (now read as rad/s)'

_REVERSED = 0.9
"""Share of gravity along the wrong sense of the z axis above which the axes are wrong for certain."""

_TURNS = 0.9
"""Correlation of gyro turn and GNSS turn above which their ratio is believed."""


def check_imu(look: ImuLook, config: Config | None) -> Iterator[Finding]:
    """Judge the inertial samples, alone and against GNSS.

    Parameters
    ----------
    look : ImuLook
        What was seen of the data.
    config : Config, optional
        For ranges, axes and the share of bad rows.

    Yields
    ------
    Finding
        ``data.imu_bad``, ``data.imu_saturated``, ``data.imu_repeated``, ``data.accel_unit``,
        ``data.accel_scale``, ``data.gyro_unit``, ``data.gyro_sign``, ``data.gyro_bias``, ``data.axes``.
    """
    yield from _bad_rows(look, config)
    yield from _saturation(look, config)
    yield from _repeats(look)
    parts = look.windows()
    if parts is None or not parts.t_s.size:
        return
    force = np.median(np.linalg.norm(parts.accel, axis=1))
    if force == 0.0:
        yield Finding(
            "stop", "data.accel_unit", "imu: the accelerometer reads zero all the time", "check the columns"
        )
        return
    yield from _accel_unit(look, parts)
    up = _up(parts)
    steps = look.steps(up)
    yield from _gyro_unit(look, steps)
    yield from _gyro_bias(parts)
    yield from _axes(up, steps, config)


def _bad_rows(look: ImuLook, config: Config | None) -> Iterator[Finding]:
    if not look.bad:
        return
    limit = 0.01 if config is None else config.imu.max_bad_share
    share = look.bad / look.rows
    over = share > limit
    yield Finding(
        "stop" if over else "warn",
        "data.imu_bad",
        f"imu: {look.bad} of {look.rows} rows ({share:.2%}) have a missing or infinite value, first row "
        f"{look.first_bad + 1}" + (f"; allowed {limit:.2%}" if over else ""),
        "repair the log, or set [imu] max_bad_share" if over else "these rows are counted as bad and bridged",
        look.bad,
    )


def _saturation(look: ImuLook, config: Config | None) -> Iterator[Finding]:
    for name, count in look.saturated.items():
        if count and config is not None:
            gyro = name == "gyro"
            limit = config.imu.gyro.range_deg_s if gyro else config.imu.accel.range_g
            text = f"imu: {count} rows at or beyond the {name} range of {limit:g} {'deg/s' if gyro else 'g'}"
            yield Finding("warn", "data.imu_saturated", text, "motion beyond the range is lost", count)


def _repeats(look: ImuLook) -> Iterator[Finding]:
    count = look.repeated
    if look.rows >= 10 and count > 0.01 * look.rows:
        yield Finding(
            "warn" if count > 0.1 * look.rows else "info",
            "data.imu_repeated",
            f"imu: {count} of {look.rows} rows repeat all six values of the row before",
            "the log is sampled faster than the sensor, or the sensor was stuck",
            count,
        )


def _accel_unit(look: ImuLook, parts: Windows) -> Iterator[Finding]:
    """Size of the specific force: its median must be near 1 g, whatever the vehicle does."""
    size = np.linalg.norm(parts.accel, axis=1)
    rest = parts.steady & (np.linalg.norm(parts.gyro, axis=1) < _AT_REST_RAD_S)
    calm = rest if rest.sum() >= 3 else parts.steady
    seen = float(np.median(size[calm] if calm.sum() >= 3 else size))
    where = f"over {int(calm.sum())} calm seconds" if calm.sum() >= 3 else f"over {size.size} s"
    if abs(seen / _G - 1.0) < _LIKE:
        if calm is rest and abs(seen / _G - 1.0) > 0.02:
            yield Finding(
                "warn",
                "data.accel_scale",
                f"imu: median specific force {seen:.3f} m/s^2 {where}, {seen / _G - 1.0:+.1%} off gravity",
                "scale error or bias: calibrate ([imu.accel] matrix, bias_mg), or estimate it (accel_scale block)",
                int(rest.sum()),
            )
        return
    step = look.step_s
    likely = {
        '[imu] accel_unit = "g"': 1.0,
        'milli-g; divide the columns by 1000 and set accel_unit = "g"': 1e3,
        "cm/s^2; divide the columns by 100": 100.0 * _G,
        "ft/s^2; multiply the columns by 0.3048": _G / 0.3048,
        '[imu] accel_unit = "m/s^2" (now read as g)': _G * _G,
    }
    if look.kind == "increments":
        likely['[imu] kind = "rates" or "mean-rates" (now read as increments)'] = _G / step
    else:
        likely['[imu] kind = "increments" (velocity increments, m/s)'] = _G * step
    fits = [name for name, value in likely.items() if abs(seen / value - 1.0) < _LIKE]
    text = f"imu: median specific force {seen:.4g} m/s^2 {where}, should be near 9.8"
    if fits:
        yield Finding("stop", "data.accel_unit", text, f"likely: {' or '.join(fits)}", size.size)
    elif not 0.5 < seen / _G < 2.0:
        hint = "check accel_unit, kind and accel_columns; specific force includes gravity"
        yield Finding("warn", "data.accel_unit", text, hint, size.size)


def _gyro_unit(look: ImuLook, steps: Steps) -> Iterator[Finding]:
    """Size of the rates: against what gyros can read, and against the turns that GNSS shows."""
    turns = fit(steps.gyro_turn, steps.course_turn)
    believed = turns.pairs >= 10 and _rms(steps.course_turn) > 0.05 and abs(turns.correlation) > _TURNS
    step = look.step_s
    likely = {
        _READ_AS_RAD_S: DEG_TO_RAD,
        '[imu] gyro_unit = "rad/s" (now read as deg/s)': 1.0 / DEG_TO_RAD,
    }
    if look.kind == "increments":
        likely['[imu] kind = "rates" or "mean-rates" (now read as increments)'] = step
    else:
        likely['[imu] kind = "increments" (angle increments)'] = 1.0 / step
    fits = [name for name, ratio in likely.items() if abs(turns.slope / ratio - 1.0) < 2.0 * _LIKE]
    ratio = (
        f"GNSS course turns {turns.slope:.3g} times as far as the gyro says ({turns.pairs} pairs of fixes)"
    )
    if believed and fits:
        yield Finding("stop", "data.gyro_unit", f"imu: {ratio}", f"likely: {' or '.join(fits)}", turns.pairs)
    elif look.too_fast > _MANY_TOO_FAST * 3 * look.used:
        text = f"imu: angular rates reach {look.fastest_rad_s:.0f} rad/s, more than any gyro can read"
        yield Finding("stop", "data.gyro_unit", text, f"likely: {_READ_AS_RAD_S}", look.used)
    elif believed and turns.slope < 0.0:
        text = f"imu: gyro and GNSS turn in opposite directions: {ratio}"
        hint = "gyro and accelerometer in different axes, or a left-handed sensor: check columns and axes"
        yield Finding("warn", "data.gyro_sign", text, hint, turns.pairs)
    elif believed and not 0.5 < turns.slope < 2.0:
        yield Finding(
            "warn", "data.gyro_unit", f"imu: {ratio}", "check gyro_unit, kind and axes", turns.pairs
        )


def _gyro_bias(parts: Windows) -> Iterator[Finding]:
    """Rate across gravity while gravity does not turn in the body: bias, or a wrong unit."""
    pairs = parts.steady[1:] & parts.steady[:-1] & (np.diff(parts.t_s) < 1.5)
    if pairs.sum() < 3:
        return
    up = parts.accel / np.linalg.norm(parts.accel, axis=1, keepdims=True)
    still = pairs & (np.linalg.norm(np.diff(up, axis=0), axis=1) < 0.01)
    if still.sum() < 3:
        return
    rate, axis = 0.5 * (parts.gyro[1:] + parts.gyro[:-1])[still], up[1:][still]
    across = np.cross(axis, rate)
    # a turn on the level shows along gravity first; only what is mostly across it cannot be motion
    odd = np.linalg.norm(across, axis=1) > np.abs((axis * rate).sum(axis=1))
    if odd.sum() < 10:
        return
    seen = float(np.linalg.norm(np.median(across[odd], axis=0))) / DEG_TO_RAD
    if seen > _LARGEST_BIAS_DEG_S:
        yield Finding(
            "warn",
            "data.gyro_bias",
            f"imu: the gyro turns at {seen:.3g} deg/s across gravity during {int(still.sum())} s in which "
            "gravity "
            "does not turn",
            f"a large bias ([imu.gyro] bias_deg_h), or {_READ_AS_RAD_S}",
            int(odd.sum()),
        )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _up(parts: Windows) -> Array:
    """Mean direction of the specific force in body axes: up, for a vehicle that is level on average."""
    use = parts.steady if parts.steady.sum() >= 3 else np.ones(parts.t_s.size, dtype=np.bool_)
    mean = np.median(parts.accel[use], axis=0)
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-9), dtype=np.float64)


def _axes(up: Array, steps: Steps, config: Config | None) -> Iterator[Finding]:
    """Direction of gravity, and of the push when the vehicle gains speed, against the configured axes."""
    axis = int(np.argmax(np.abs(up)))
    upright = axis == 2 and up[2] < -0.7
    forward = _forward(steps, axis)
    ahead = forward is None or forward == (0, 1)
    if upright and ahead:
        return
    text = f"imu: at level +z (down) should read -1 g; the mean direction of the force is {_signs(up)}"
    if upright and forward is not None:
        push = f"{'+' if forward[1] > 0 else '-'}{'xyz'[forward[0]]}"
        text = f"imu: when GNSS gains speed the push is felt along {push}, not along +x (forward)"
    candidates = _letters(up, forward, config)
    hint = (
        f"likely [imu] axes: {', '.join(candidates)}"
        if candidates
        else "check [imu] axes; is the unit tilted?"
    )
    # a roll beyond 90 deg in the configuration says that the body really lies on its back
    told = None if config is None else config.initial.roll_deg
    reversed_sign = up[2] > _REVERSED and (told is None or abs(told) < 90.0)
    if reversed_sign:
        hint += "; if +z of the body really points up, say so with [initial] roll_deg = 180 and pitch_deg"
    yield Finding("stop" if reversed_sign else "warn", "data.axes", text, hint, steps.speed_gain.size)


def _signs(vector: Array) -> str:
    """Write a direction as multiples of the axes."""
    return " ".join(f"{value:+.2f}{name}" for value, name in zip(vector, "xyz", strict=True))


def _forward(steps: Steps, up_axis: int) -> tuple[int, int] | None:
    """Body axis and sign that feels the gain of speed; None if no axis stands out."""
    if steps.speed_gain.size < 20 or np.std(steps.speed_gain) < 0.3:
        return None
    gain = steps.speed_gain - steps.speed_gain.mean()
    fits: dict[int, Fit] = {}
    for axis in range(3):
        if axis != up_axis:
            fits[axis] = fit(gain, steps.force[:, axis] - steps.force[:, axis].mean())
    best = max(fits, key=lambda key: abs(fits[key].correlation))
    if abs(fits[best].correlation) < 0.7 or not 0.5 < abs(fits[best].slope) < 1.5:
        return None
    return best, 1 if fits[best].slope > 0.0 else -1


def _letters(up: Array, forward: tuple[int, int] | None, config: Config | None) -> list[str]:
    """Axis letters of the sensor that would put up, and if known forward, where they belong."""
    axes = "FRD" if config is None else config.imu.axes
    to_body = axes_matrix(axes)
    sensor_up = to_body.T @ up
    ahead = None if forward is None else to_body.T @ (np.eye(3)[forward[0]] * forward[1])
    found = []
    for letters in proper_letters():
        to_frd = axes_matrix(letters)
        good = (to_frd @ sensor_up)[2] < -0.7
        if good and (ahead is None or (to_frd @ ahead)[0] > 0.7):
            found.append(f'"{letters}"')
    return found
