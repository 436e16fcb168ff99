"""What Al Bitar and Gavrilov (2019) and its specification claim, each figure beside ours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import Ensemble, OutageGrowth, chi_square_bounds
from gnssins.analysis.consistency import direction
from gnssins.reproduce.al_bitar_published import (
    LABELS,
    PUBLISHED_TABLE,
    REFERENCE_R1,
    REFERENCE_R2,
    REFERENCE_SIGMA,
    TIMES_S,
)
from gnssins.reproduce.al_bitar_runs import Drive, Plan
from gnssins.reproduce.al_bitar_tables import Manoeuvre, gap_nees, gap_ratio, mean_nees
from gnssins.reproduce.report import Claim
from gnssins.units import DEG_TO_RAD

__all__ = ["claims"]

Array = NDArray[np.float64]

#: Wanted of reading R2: E_xyz, m.
_DISTANCE: Final = {10.0: 0.55, 30.0: 2.7, 60.0: 11.0}

#: Gaps from which on the scatter of a mean (3 %) no longer decides about a claim.
_ENOUGH: Final = 140

_OTHER_DRIVE: Final = "published drive recorded, ours simulated"


def claims(
    plan: Plan,
    whole: Ensemble,
    gaps: Ensemble,
    found: Mapping[str, OutageGrowth],
    drives: Sequence[Drive],
    classes: Sequence[Manoeuvre],
) -> list[Claim]:
    """One claim per figure of the specification and of the publication."""
    every = [
        *_outage_claims(found["published"]),
        *_reference_claims(found["published"]),
        *_honesty_claims(plan, whole, gaps, drives),
        *_antenna_claims(plan, found, drives),
        *_calibration_claims(plan, found, drives),
        *_manoeuvre_claims(plan, whole, classes),
    ]
    return [_with_reason(claim, found["published"].gaps) for claim in every]


def _with_reason(claim: Claim, gaps: int) -> Claim:
    """A claim that few gaps have missed says so."""
    if claim.met or not claim.judged or claim.note or gaps >= _ENOUGH:
        return claim
    return replace(claim, note=f"{gaps} gaps only: a mean scatters by {50 / math.sqrt(gaps):.0f} %")


def _outage_claims(growth: OutageGrowth) -> list[Claim]:
    """Reading R2 at the times that the specification names, and the whole table."""
    out = []
    for time, target in _DISTANCE.items():
        if time in growth.at_s:
            out.append(_distance(growth, time, target))
    if 60.0 in growth.at_s:
        values = np.abs(growth.values("heading", 60.0)) / DEG_TO_RAD
        out.append(
            Claim(
                "heading_60",
                f"heading 60 s after the loss of GNSS, R2 ({_OTHER_DRIVE})",
                "deg",
                growth.value("at_end", "heading", 60.0) / DEG_TO_RAD,
                0.20,
                published=PUBLISHED_TABLE["heading"][5],
                sigma=growth.value("sigma", "heading", 60.0) / DEG_TO_RAD,
                median=float(np.median(values)),
                p95=float(np.quantile(values, 0.95)),
            )
        )
    share, cell, count = _worst_cell(growth)
    out.append(
        Claim(
            "whole_table",
            f"all {count} figures of the published table: largest of R2 over the published one",
            "",
            share,
            1.0,
            note=f"{cell}; {_OTHER_DRIVE}",
        )
    )
    return out


def _distance(growth: OutageGrowth, time: float, target: float) -> Claim:
    values = growth.values("distance", time)
    return Claim(
        f"distance_{time:g}",
        f"E_xyz {time:g} s after the loss of GNSS, R2 ({_OTHER_DRIVE})",
        "m",
        growth.value("at_end", "distance", time),
        target,
        published=PUBLISHED_TABLE["distance"][TIMES_S.index(time)],
        sigma=growth.value("sigma", "distance", time),
        median=float(np.median(values)),
        p95=float(np.quantile(values, 0.95)),
    )


def _worst_cell(growth: OutageGrowth) -> tuple[float, str, int]:
    """Largest share of a published figure, which one it is, and of how many."""
    shares = {
        (key, time): LABELS[key][2] * growth.value("at_end", key, time) / row[TIMES_S.index(time)]
        for key, row in PUBLISHED_TABLE.items()
        for time in growth.at_s.tolist()
        if time in TIMES_S
    }
    if not shares:
        return math.nan, "no time of the published table", 0
    key, time = max(shares, key=lambda cell: shares[cell])
    return shares[key, time], f"{LABELS[key][0]} at {time:g} s", len(shares)


def _reference_claims(growth: OutageGrowth) -> list[Claim]:
    """Against an independent program with the same sensor values on another route."""
    if 60.0 not in growth.at_s:
        return []
    out = []
    for key, label, reading, reference, room in (
        ("sigma", "the filter's sigma", "sigma", REFERENCE_SIGMA[5], 0.05),
        ("r2", "R2", "at_end", REFERENCE_R2["distance"][5], 0.15),
        ("r1", "R1", "so_far", REFERENCE_R1["distance"][5], 0.15),
    ):
        out.append(
            Claim(
                f"reference_{key}",
                f"E_xyz at 60 s, {label}, as the independent program says ({reference:g} m)",
                "m",
                growth.value(reading, "distance", 60.0),
                sense="within",
                low=(1.0 - room) * reference,
                high=(1.0 + room) * reference,
            )
        )
    return out


def _honesty_claims(plan: Plan, whole: Ensemble, gaps: Ensemble, drives: Sequence[Drive]) -> list[Claim]:
    """NEES, NIS, errors at the ends of the gaps over the filter's own sigma."""
    out = []
    for variant, found in (("throughout", whole), ("gaps", gaps)):
        where = f"{len(plan.gaps)} gaps" if variant == "gaps" else "GNSS throughout"
        for group, low, high in (("navigation", 8.0, 10.0), ("all", None, None)):
            mean, dof, bounds = mean_nees(plan, found, group)
            key = f"nees_{variant}" + ("_21" if group == "all" else "")
            verdict = direction(mean, dof, bounds)
            text = f"NEES of {dof} states, {where}"
            low, high = bounds if low is None else (low, high)
            out.append(Claim(key, text, "", mean, sense="within", low=low, high=high, chi_square=verdict))
        joint = found.nis["gnss, 6 components"]
        out.append(
            Claim(
                f"nis_{variant}",
                f"NIS of a fix, {where}",
                "",
                joint.mean,
                sense="within",
                low=5.9,
                high=6.1,
                chi_square=joint.verdict,
            )
        )
    ratio = gap_ratio(plan, gaps)[:9]
    count = gaps.runs * len(plan.gaps)
    low, high = (math.sqrt(v) for v in chi_square_bounds(1, count, 0.99))
    where = "attitude, velocity, position at the ends of the gaps, rms over sigma"
    note = f"99 % of one ratio of {count} independent gaps: {low:.2f} .. {high:.2f}"
    for key, value in (("least", float(ratio.min())), ("greatest", float(ratio.max()))):
        out.append(
            Claim(
                f"gap_ratio_{key}",
                f"{key} of 9 ratios: {where}",
                "",
                value,
                sense="within",
                low=0.85,
                high=1.15,
                chi_square=direction(value**2, 1, (low**2, high**2)),
                note=note,
            )
        )
    out.append(
        _within_chi("gap_nees", "NEES of 9 states, ends of the gaps", 9, gap_nees(drives, "published"), count)
    )
    first = float(np.mean([d.first_nis for d in drives]))
    out.append(_within_chi("first_fix_nis", "NIS of the first fix after a gap", 6, first, count))
    out.append(_sum_claim(plan, drives))
    return out


def _within_chi(key: str, text: str, dof: int, mean: float, count: int) -> Claim:
    """A mean of so many chi-square numbers within its 99 % bounds."""
    low, high = chi_square_bounds(dof, count, 0.99)
    verdict = direction(mean, dof, (low, high))
    return Claim(key, text, "", mean, sense="within", low=low, high=high, chi_square=verdict)


def _sum_claim(plan: Plan, drives: Sequence[Drive]) -> Claim:
    """Sums of the two random components over their sigma, the worst of six."""
    rows = [i for i, t in enumerate(plan.epochs) if t >= plan.after_s and t % 50.0 == 0.0]
    over = np.array([d.sums.error[rows] / d.sums.sigma[rows] for d in drives])
    ratio = np.sqrt(np.mean(over**2, axis=(0, 1)))
    worst = int(np.argmax(np.abs(np.log(ratio))))
    name = f"{('gyro', 'accelerometer')[worst // 3]} {'xyz'[worst % 3]}"
    bounds = chi_square_bounds(1, len(drives), 0.99)
    return Claim(
        "bias_sums",
        "walk + Markov error of each sensor, rms over sigma, GNSS throughout: worst of six",
        "",
        float(ratio[worst]),
        sense="within",
        low=math.sqrt(bounds[0]),
        high=math.sqrt(bounds[1]),
        chi_square=direction(float(ratio[worst]) ** 2, 1, bounds),
        note=f"{name}; only the sums act on the navigation errors",
    )


def _antenna_claims(plan: Plan, found: Mapping[str, OutageGrowth], drives: Sequence[Drive]) -> list[Claim]:
    """What the heading of two antennas gives at the end of a gap."""
    last = plan.at_s[-1]
    with_it, without = found["heading"], found["published"]
    heading = [g.value("rms", "heading", last) / DEG_TO_RAD for g in (with_it, without)]
    distance = [g.value("rms", "distance", last) for g in (with_it, without)]
    mean, count = gap_nees(drives, "heading"), with_it.gaps
    return [
        Claim(
            "antennas_heading",
            f"two antennas: heading error {last:g} s after the loss, rms, over that without them",
            "",
            heading[0] / heading[1],
            0.5,
            note=f"{heading[0]:.3f} and {heading[1]:.3f} deg",
        ),
        Claim(
            "antennas_distance",
            f"two antennas: E_xyz {last:g} s after the loss, rms, over that without them",
            "",
            distance[0] / distance[1],
            1.0,
            note="tilt and gyro x, y biases drive the position, heading hardly does",
        ),
        _within_chi("antennas_nees", "two antennas: NEES of 9 states, ends of the gaps", 9, mean, count),
    ]


def _calibration_claims(
    plan: Plan, found: Mapping[str, OutageGrowth], drives: Sequence[Drive]
) -> list[Claim]:
    """Matrices taken off, left out, estimated."""
    last = plan.at_s[-1]

    def ratio(name: str) -> float:
        reference = found["published"].value("at_end", "distance", last)
        return found[name].value("at_end", "distance", last) / reference

    applied = max((ratio(f"calibrated {size}") for size in (1, 10)), key=lambda v: abs(math.log(v)))
    out = [
        Claim(
            "calibrated",
            f"K + G known and taken off: E_xyz at {last:g} s, R2, over that of sensors without them",
            "",
            applied,
            sense="within",
            low=0.98,
            high=1.02,
        )
    ]
    for size, what in ((1, "1e-3"), (10, "1e-2")):
        nees = gap_nees(drives, f"uncalibrated {size}")
        out.append(
            Claim(
                f"uncalibrated_{size}",
                f"K + G of {what} left in: E_xyz at {last:g} s, R2, over that of calibrated sensors",
                "",
                ratio(f"uncalibrated {size}"),
                note=f"NEES of 9 states {nees:.0f}",
            )
        )
    for size, what in ((1, "1e-3"), (10, "1e-2")):
        out.append(
            Claim(
                f"estimated_{size}",
                f"K + G of {what} estimated: E_xyz at {last:g} s, R2, over that of calibrated sensors",
                "",
                ratio(f"states {size}"),
                1.1,
                note=f"NEES of 9 states {gap_nees(drives, f'states {size}'):.1f}",
            )
        )
    return out


def _manoeuvre_claims(plan: Plan, whole: Ensemble, classes: Sequence[Manoeuvre]) -> list[Claim]:
    """Figure 5 of the publication: heading against the specific force."""
    even, hard = classes[0], classes[-1]
    begin, end = plan.force.first_straight()
    heading = whole.column("phi_d")
    rms, sigma = (v[[whole.at(begin), whole.at(end)], heading] for v in (whole.rms(), whole.sigma()))
    return [
        Claim(
            "heading_first_straight",
            f"z gyro bias not yet known, no acceleration, {begin:g} s to {end:g} s: heading error rises so many times",
            "",
            float(rms[1] / rms[0]),
            2.0,
            "at least",
            sigma=float(sigma[1] / sigma[0]),
            note=f"rms {rms[0] / DEG_TO_RAD:.2f} to {rms[1] / DEG_TO_RAD:.2f} deg",
        ),
        Claim(
            "heading_even",
            f"heading error grows without acceleration (below {even.high:g} m/s^2): change per 10 s",
            "%",
            100.0 * math.expm1(even.error_change),
            50.0 * math.expm1(even.sigma_change),
            "at least",
            sigma=100.0 * math.expm1(even.sigma_change),
            note="wanted half of the filter's own",
        ),
        Claim(
            "heading_accelerated",
            f"heading error falls with acceleration (above {hard.low:g} m/s^2): change per 10 s",
            "%",
            100.0 * math.expm1(hard.error_change),
            50.0 * math.expm1(hard.sigma_change),
            "at most",
            sigma=100.0 * math.expm1(hard.sigma_change),
            note="wanted half of the filter's own",
        ),
        Claim(
            "gyro_z_even",
            "windows of 31 fixes without acceleration that leave the z gyro bias open",
            "%",
            100.0 * even.flagged[1],
            99.0,
            "at least",
            note=f"the heading itself in {100 * even.flagged[0]:.0f} %",
        ),
        Claim(
            "gyro_z_accelerated",
            "windows of 31 fixes with acceleration that leave the z gyro bias open",
            "%",
            100.0 * hard.flagged[1],
            5.0,
            "at most",
            note=f"the heading itself in {100 * hard.flagged[0]:.0f} %",
        ),
    ]
