"""Tables of the reproduction of Aleshkin et al. (2021)."""

from __future__ import annotations

import numpy as np

from gnssins.ahrs import Cross
from gnssins.ahrs.compare import Comparison
from gnssins.ahrs.disturbed import PHASES
from gnssins.analysis import text
from gnssins.analysis.ahrs import (
    characteristic_polynomial,
    euler_rate_limit,
    noise_gain,
    printed_polynomial,
    rate_grid,
    response,
    stability,
)
from gnssins.reproduce.aleshkin_claims import WANTED_POLES
from gnssins.reproduce.aleshkin_runs import (
    CHEBYSHEV,
    CROSS,
    FAST_SETTLED_S,
    FAST_START_DEG,
    NOISE_DEG_S,
    NOISE_S,
    PATHS,
    POSITIONAL,
    TUNINGS,
    Experiment,
)
from gnssins.reproduce.report import Cell, Table

__all__ = [
    "comparison_table",
    "noise_table",
    "pole_table",
    "schuler_table",
    "stability_table",
    "step_table",
    "tables",
    "tuning_table",
]


def tables(found: Experiment, compared: Comparison) -> list[Table]:
    """All of them."""
    return [
        tuning_table(found),
        pole_table(),
        stability_table(found),
        step_table(found),
        noise_table(found),
        schuler_table(found),
        comparison_table(compared),
    ]


def tuning_table(found: Experiment) -> Table:
    """What the published tunings give: the equations, and the running law."""
    rows: list[list[Cell]] = []
    for path in PATHS:
        law = TUNINGS[path.law]
        one = response(law, path.angle, path.reading)
        kept = response(law, path.angle, path.reading, form="rotation")
        peak, at = one.peak
        rows.append(
            [
                path.text,
                one.dc,
                one.corner_hz,
                found.corners.get(path),
                kept.corner_hz,
                response(law, path.angle, path.reading, dt_s=0.01).corner_hz,
                peak,
                at if at else None,
                round(one.slope_db_decade),
            ]
        )
    columns = [
        "path",
        "DC",
        "-3 dB Hz",
        "running law Hz",
        "C kept a rotation Hz",
        "at 100 Hz",
        "peak dB",
        "at Hz",
        "dB/decade",
    ]
    note = "X: k = 42.8, n = 13.3; P: k = 42.8; PI: k = 1.1 w0, k_int = 1.1 w0², w0 = 2 pi 10. Gyro: DC in s"
    return Table(
        "tunings", "What the published tunings give (published: 10 Hz throughout)", columns, rows, note
    )


def pole_table() -> Table:
    """Poles and polynomial of the published gains, printed and right, beside the Butterworth that was meant."""
    rate = np.array([50.0, -50.0, 80.0])

    def row(name: str, polynomial: np.ndarray) -> list[Cell]:
        roots = np.roots(polynomial)
        roots = roots[np.argsort(-roots.real)]
        return [
            name,
            *(float(c) for c in polynomial),
            "  ".join(f"{p.real:.2f}{p.imag:+.2f}j" for p in roots),
        ]

    rows = [
        row("third-order Butterworth, 10 Hz", np.poly(WANTED_POLES).real),
        row("published gains, at rest", characteristic_polynomial(CROSS)),
        row("as printed, at rest (+2n³)", printed_polynomial(CROSS)),
        row("published gains, at (50, -50, 80) rad/s", characteristic_polynomial(CROSS, rate)),
        row("as printed, at that rate", printed_polynomial(CROSS, rate)),
    ]
    columns = ["polynomial", "p³", "p²", "p", "1", "roots 1/s"]
    return Table("poles", "Characteristic polynomial of the cross-coupled law", columns, rows)


def stability_table(found: Experiment) -> Table:
    """Stability over body rates: the whole Routh condition beside the published one."""
    rows: list[list[Cell]] = []
    for name, law in (
        ("X, published gains", CROSS),
        ("X, n = 0.99 k", Cross(CROSS.k, 0.99 * CROSS.k)),
        ("X, n = 1.05 k", Cross(CROSS.k, 1.05 * CROSS.k)),
        ("P", POSITIONAL),
        ("PI", CHEBYSHEV),
    ):
        one = stability(law, rate_grid(100.0, 41))
        passed = None if one.published is None else int((one.published & ~one.routh).sum())
        rows.append([name, one.worst, one.bound, int((~one.routh).sum()), passed])
    limits = ", ".join(
        f"{euler_rate_limit(42.8, t):.0f} rad/s at {1 / t:.0f} Hz" for t in (0.01, 0.005, 0.001)
    )
    worst = max(found.fast, key=lambda name: found.fast[name])
    note = (
        f"41³ points. Explicit Euler, k = 42.8, is unstable above {limits}; the running laws, started "
        f"{FAST_START_DEG:g} deg off, follow 100 rad/s at 100 Hz after {FAST_SETTLED_S:g} s within "
        f"{text.number(max(found.fast.values()))} deg ({worst})"
    )
    columns = ["law", "largest real part 1/s", "bound 1/s", "unstable points", "of them passed by ab > c"]
    return Table("stability", "Body rates within +-100 rad/s per axis", columns, rows, note)


def step_table(found: Experiment) -> Table:
    """Step responses of the running laws."""
    rows: list[list[Cell]] = []
    for (law, angle), one in found.steps.items():
        other = max(one.leak(a) for a in ("roll", "pitch", "heading") if a != angle)
        rows.append([f"{law}: {angle}", one.settled_s(), 100.0 * one.undershoot, 100.0 * other])
    columns = ["initial error", "to 5 % s", "undershoot %", "thrown into another angle %"]
    return Table("steps", "Initial error, body at rest (published as curves without numbers)", columns, rows)


def noise_table(found: Experiment) -> Table:
    """Noise of the angles: Lyapunov, running law, explicit Euler; the published claim."""
    rows: list[list[Cell]] = []
    for name, law in TUNINGS.items():
        continuous, sampled = noise_gain(law), noise_gain(law, dt_s=NOISE_S)
        for i, angle in ((0, "roll"), (2, "heading")):
            scale = 1e6 * NOISE_DEG_S**2 * NOISE_S
            rows.append(
                [
                    f"{name}: {angle}",
                    float(continuous.gyro[i]),
                    scale * float(continuous.gyro[i]),
                    scale * float(sampled.gyro[i]),
                    1e6 * float(found.noise.variance[name][:, i].mean()),
                    1e6 * float(found.noise.stepped[:, i].mean()) if name == "X" else None,
                ]
            )
    columns = [
        "angle",
        "gain s",
        "continuous mdeg²",
        "sampled mdeg²",
        "running law mdeg²",
        "explicit Euler mdeg²",
    ]
    note = (
        "gyro noise 0.1 deg/s per sample at 100 Hz; 1 mdeg² is 1e-6 deg². Published: 1.548e-6 for heading, from a "
        "gyro variance of 0.1, both in (deg/s)²"
    )
    return Table("noise", "Variance of the angles under gyro noise", columns, rows, note)


def schuler_table(found: Experiment) -> Table:
    """Tilt after an acceleration: only the undamped integral does not feel it."""
    rows: list[list[Cell]] = [[name, tilt] for name, tilt in found.schuler.items()]
    note = f"1 deg/h of gyro drift costs a positional law with k = w_s {found.drift_deg:.2f} deg"
    columns = ["law at w_s = sqrt(g/R)", "tilt deg"]
    return Table("schuler", "Tilt after 2 m/s² for 10 s", columns, rows, note)


def comparison_table(compared: Comparison) -> Table:
    """The filter for use beside others in one scenario."""
    names = (*PHASES, "all")
    rows: list[list[Cell]] = [
        [r.method, r.manoeuvre_s, r.runs, *(r.rms_deg[p] for p in names)] for r in compared.rows
    ]
    note = f"not installed: {', '.join(compared.absent)}" if compared.absent else ""
    columns = ["method", "manoeuvre s", "runs", *(f"{p} deg" for p in names)]
    title = "Total attitude error, rms, on the comparison scenario"
    return Table("comparison", title, columns, rows, note)
