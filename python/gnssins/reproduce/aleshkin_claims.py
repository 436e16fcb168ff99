"""What Aleshkin et al. (2021) claim, each figure beside ours; then what a filter for use does in their place."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from gnssins.ahrs.compare import TARGETS_DEG, Comparison
from gnssins.analysis.ahrs import Angle, Stability, euler_rate_limit, noise_gain, response
from gnssins.reproduce.aleshkin_runs import (
    CHEBYSHEV,
    CROSS,
    FAST_SETTLED_S,
    FAST_START_DEG,
    NOISE_DEG_S,
    NOISE_S,
    TUNINGS,
    Experiment,
    Path,
)
from gnssins.reproduce.claim import Claim, spread

__all__ = ["WANTED_POLES", "claims"]

#: Poles of a third-order Butterworth low-pass of 10 Hz, 1/s.
WANTED_POLES: Final = tuple(
    20.0 * math.pi * z for z in (-1.0, complex(-0.5, 0.75**0.5), complex(-0.5, -(0.75**0.5)))
)

_CORNERS: Final = {
    "corner_pitch": (Path("X", "pitch", "measured"), 7.91, 10.0),
    "corner_heading": (Path("X", "heading", "measured"), 7.91, 10.0),
    "corner_roll": (Path("X", "roll", "measured"), 6.59, 10.0),
    "corner_positional": (Path("P", "pitch", "measured"), 6.82, None),
}


def claims(found: Experiment, grid: Stability, compared: Comparison) -> list[Claim]:
    """One claim per figure."""
    return [
        *_stability(found, grid),
        *_frequency(found),
        *_steps(found),
        *_noise(found),
        *_schuler(found),
        *_filter(compared),
    ]


def _stability(found: Experiment, grid: Stability) -> list[Claim]:
    bound = abs(CROSS.n) - CROSS.k
    return [
        Claim(
            "stable",
            "cross-coupled law: unstable points among body rates of +-100 rad/s per axis",
            "",
            int((~grid.routh).sum()),
            0.0,
            sense="equal",
            published=0.0,
        ),
        Claim(
            "bound",
            "cross-coupled law: largest real part on that grid, bound n - k",
            "1/s",
            grid.worst,
            bound,
            sense="equal",
            tolerance=1e-9 * abs(bound),
        ),
        Claim(
            "fast_turn",
            f"largest attitude error of any law {FAST_SETTLED_S:g} to 5 s after a start {FAST_START_DEG:g} deg off, "
            "turning at 100 rad/s, sampled at 100 Hz",
            "deg",
            max(found.fast.values()),
            1e-4,
            note=f"by explicit Euler at 100 Hz the law diverges above {euler_rate_limit(CROSS.k, 0.01):.0f} rad/s",
        ),
    ]


def _frequency(found: Experiment) -> list[Claim]:
    out = []
    for key, (path, target, published) in _CORNERS.items():
        note = "the published gains do not give the published 10 Hz" if published else ""
        out.append(
            Claim(
                key,
                f"-3 dB of the running law, {path.text}",
                "Hz",
                found.corners[path],
                target,
                sense="equal",
                tolerance=0.005 * target,
                published=published,
                note=note,
            )
        )
    poles = np.linalg.eigvals(-CROSS.matrix())
    distance = max(float(np.abs(poles - p).min()) for p in WANTED_POLES)
    out.append(
        Claim(
            "butterworth",
            "distance of the published gains' poles from those of a third-order Butterworth of 10 Hz",
            "1/s",
            distance,
            0.0,
            note="no gains of this law have these poles and are stable: matching two coefficients needs n = 1.22 k",
        )
    )
    out.append(
        Claim(
            "roll_off",
            "final slope of the published third-order low-pass",
            "dB/decade",
            response(CROSS).slope_db_decade,
            published=-60.0,
            note="three poles and two zeros: every path falls as one pole does",
        )
    )
    out.append(
        Claim(
            "ripple",
            'peak of the integral law tuned as "Chebyshev, 1 dB"',
            "dB",
            response(CHEBYSHEV).peak[0],
            published=1.0,
            note="the zero at -k_int/k is not in the prototype",
        )
    )
    return out


def _steps(found: Experiment) -> list[Claim]:
    wanted: dict[tuple[str, Angle], tuple[str, float]] = {
        ("P", "pitch"): ("step_positional", 0.070),
        ("X", "pitch"): ("step_pitch", 0.057),
        ("X", "roll"): ("step_roll", 0.077),
        ("PI", "pitch"): ("step_integral", 0.066),
    }
    out = [
        Claim(
            key,
            f"{law}: initial error of {angle} within 5 %",
            "s",
            found.steps[law, angle].settled_s(),
            target,
            sense="equal",
            tolerance=0.001,
        )
        for (law, angle), (key, target) in wanted.items()
    ]
    out.append(
        Claim(
            "leak",
            "X: share of an initial error of pitch thrown into roll",
            "%",
            100.0 * found.steps["X", "pitch"].leak("roll"),
            9.7,
            sense="equal",
            tolerance=0.1,
            note="the cost of cross-coupling: 0 for law P",
        )
    )
    return out


def _noise(found: Experiment) -> list[Claim]:
    ratios = []
    for name, law in TUNINGS.items():
        want = noise_gain(law, dt_s=NOISE_S).gyro * NOISE_DEG_S**2 * NOISE_S
        ratios.extend(found.noise.variance[name].mean(axis=0) / want)
    worst = max(ratios, key=lambda r: abs(r - 1.0))
    heading = found.noise.variance["X"][:, 2]
    over = noise_gain(CROSS).gyro * 2.0 * CROSS.k
    return [
        Claim(
            "noise_lyapunov",
            "variance of an angle over the Lyapunov solution, three laws, three angles, the farthest from 1",
            "",
            float(worst),
            sense="within",
            low=0.98,
            high=1.02,
        ),
        Claim(
            "noise_heading",
            "heading variance under gyro noise of 0.1 deg/s at 100 Hz",
            "mdeg²",
            1e6 * float(heading.mean()),
            sense="beside",
            published=1.548,
            **spread(1e6 * heading),
            note="not judged: printed for a gyro variance of 0.1, both in (deg/s)²; explicit Euler at 100 Hz gives "
            f"{1e6 * found.noise.stepped[:, 0].mean():.3f} "
            f"(roll) and {1e6 * found.noise.stepped[:, 2].mean():.3f} (heading)",
        ),
        Claim(
            "noise_benefit",
            "noise of the cross-coupled law (heading, gyro) over that of the plain positional one, continuous",
            "",
            float(over[2]),
            note=f"pitch {over[1]:.3f}, roll {over[0]:.3f}: no benefit",
        ),
    ]


def _schuler(found: Experiment) -> list[Claim]:
    wanted = {
        "schuler_undamped": 0.0,
        "schuler_damped": 0.0073,
        "schuler_mixed": 0.158,
        "schuler_positional": 0.143,
    }
    tolerance = {"schuler_undamped": 5e-5, "schuler_damped": 1e-4}
    out = [
        Claim(
            key,
            f"tilt after 2 m/s² for 10 s, {name}",
            "deg",
            tilt,
            target,
            sense="equal",
            tolerance=tolerance.get(key, 1e-3),
        )
        for (key, target), (name, tilt) in zip(wanted.items(), found.schuler.items(), strict=True)
    ]
    out.append(
        Claim(
            "schuler_drift",
            "tilt that 1 deg/h of gyro drift costs a positional law at the Schuler frequency",
            "deg",
            found.drift_deg,
            0.22,
            sense="equal",
            tolerance=0.005,
        )
    )
    return out


def _filter(compared: Comparison) -> list[Claim]:
    """The filter for use on the comparison scenario, others beside it."""
    out = []
    for (phase, length), target in TARGETS_DEG.items():
        row = compared.row("filter", length)
        others = [
            r for r in compared.rows if r.manoeuvre_s == length and r.method in ("VQF", "Mahony", "Madgwick")
        ]
        beside = ", ".join(
            f"{r.method} {r.rms_deg[phase]:.2f}" + ("" if r.runs == row.runs else f" in {r.runs} run")
            for r in others
        )
        out.append(
            Claim(
                f"filter_{phase}_{length:g}s",
                f"filter for use, {phase}, manoeuvres of {length:g} s: total attitude error rms",
                "deg",
                row.rms_deg[phase],
                target,
                note=beside,
            )
        )
    return out
