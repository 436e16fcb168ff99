"""What Fomichev and Tan (2017) and its specification claim, each figure beside ours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import Ensemble, chi_square_bounds
from gnssins.analysis.consistency import direction
from gnssins.reproduce.claim import Claim, rms, spread, with_scatter
from gnssins.reproduce.fomichev_tan_runs import Flight, Plan, Realisation
from gnssins.reproduce.fomichev_tan_tables import ARCMIN, AXES, gap_end, mean_nees, pooled, restarted_gain

__all__ = ["claims"]

Array = NDArray[np.float64]


def claims(
    plan: Plan,
    whole: Ensemble,
    gaps: Ensemble,
    readings: Mapping[str, Ensemble],
    flights: Sequence[Flight],
    one: Realisation,
) -> list[Claim]:
    """One claim per figure of the specification and of the publication."""
    found = (
        *_accuracy_claims(whole),
        *_honesty_claims(plan, whole, gaps),
        *_gap_claims(plan, gaps, flights, one),
        *_return_claims(plan, whole, gaps, flights),
        *_comparison_claims(plan, gaps, readings, flights),
    )
    return with_scatter(found, whole.runs)


def _accuracy_claims(whole: Ensemble) -> list[Claim]:
    """Steady state with GNSS throughout: the worst axis of each quantity."""
    total, sigma = whole.over_window(0)
    errors = np.abs(pooled(whole.errors))

    def claim(key: str, label: str, unit: str, states: Sequence[int], factor: float, target: float) -> Claim:
        i = states[int(np.argmax(total[list(states)]))]
        return Claim(
            key,
            f"{label}, GNSS throughout, rms",
            unit,
            float(factor * total[i]),
            target,
            sigma=float(factor * sigma[i]),
            **spread(factor * errors[:, i]),
        )

    def mostly(key: str, label: str, unit: str, states: Sequence[int], published: float) -> Claim:
        p95 = np.quantile(errors[:, list(states)], 0.95, axis=0)
        i = list(states)[int(np.argmax(p95))]
        return Claim(
            key,
            f"{label} mostly within +-{published} {unit}: 95 % of runs and epochs",
            unit,
            float(p95.max()),
            published,
            published=published,
            sigma=float(sigma[i]),
            **spread(errors[:, i]),
        )

    return [
        claim("position", "position, worst axis", "m", (6, 7, 8), 1.0, 0.205),
        claim("velocity", "velocity, worst axis", "m/s", (3, 4, 5), 1.0, 0.0066),
        claim("level", "level, worst axis", "arcmin", (0, 1), ARCMIN, 0.042),
        claim("heading", "heading", "arcmin", (2,), ARCMIN, 0.37),
        mostly("position_mostly", "position, worst axis,", "m", (6, 7, 8), 0.5),
        mostly("velocity_mostly", "velocity, worst axis,", "m/s", (3, 4, 5), 0.05),
    ]


def _honesty_claims(plan: Plan, whole: Ensemble, gaps: Ensemble) -> list[Claim]:
    """NEES, NIS, errors at the ends of the gaps over the filter's own sigma."""
    out = []
    for variant, found in (("throughout", whole), ("gaps", gaps)):
        mean, dof, bounds = mean_nees(plan, found, "navigation")
        verdict = direction(mean, dof, bounds)
        text = f"NEES of 9 states, {'three gaps' if variant == 'gaps' else 'GNSS throughout'}"
        out.append(
            Claim(f"nees_{variant}", text, "", mean, sense="within", low=8.3, high=9.7, chi_square=verdict)
        )
    for variant, found in (("throughout", whole), ("gaps", gaps)):
        joint = found.nis["gnss, 6 components"]
        text = f"NIS of a fix, {'three gaps' if variant == 'gaps' else 'GNSS throughout'}"
        out.append(
            Claim(
                f"nis_{variant}",
                text,
                "",
                joint.mean,
                sense="within",
                low=5.9,
                high=6.1,
                chi_square=joint.verdict,
            )
        )
    ratio = np.array([gaps.ratio()[gap_end(plan, gaps, g), :9] for g in range(len(plan.gaps))])
    low, high = gaps.ratio_bounds
    where = "attitude, velocity, position at the ends of the gaps, rms over sigma"
    for key, label, value in (
        ("gap_ratio_least", "least", float(ratio.min())),
        ("gap_ratio_greatest", "greatest", float(ratio.max())),
    ):
        verdict = gaps.verdict(value)
        text = f"{label} of {ratio.size} ratios: {where}"
        note = f"99 % of one ratio: {low:.2f} .. {high:.2f}"
        out.append(
            Claim(key, text, "", value, sense="within", low=0.8, high=1.2, chi_square=verdict, note=note)
        )
    return out


def _gap_claims(plan: Plan, gaps: Ensemble, flights: Sequence[Flight], one: Realisation) -> list[Claim]:
    """What the publication says about the errors inside the gaps."""
    out = []
    for g in range(min(2, len(plan.gaps))):
        largest = gaps.window_max[:, g, 6]
        inside = one.gaps.between(*plan.gaps[g])
        shown = float(np.abs(inside.position[:, 0]).max())
        out.append(
            Claim(
                f"north_gap_{g + 1}",
                f"north position reaches about +-5 m in gap {g + 1}: median of the runs",
                "m",
                float(np.median(largest)),
                sense="within",
                low=2.5,
                high=10.0,
                published=5.0,
                sigma=float(gaps.sigma()[gap_end(plan, gaps, g), 6]),
                **spread(largest),
                note=f"about read as a factor of two; the run with +1 sigma reaches {shown:.1f} m",
            )
        )
    first = np.array([gaps.window_max[:, g, 6:9] for g in range(min(2, len(plan.gaps)))])
    share = float(np.mean((first.argmax(axis=2) == 0).all(axis=0)))
    worst = np.array([np.abs(one.gaps.between(*gap).position).max(axis=0) for gap in plan.gaps[:2]])
    in_one = " and ".join(AXES[i] for i in worst.argmax(axis=1))
    out.append(
        Claim(
            "north_largest",
            "north is the largest error in both of the first two gaps: share of the runs",
            "",
            share,
            0.5,
            "at least",
            note="not a property of the system: errors of the three axes are drawn alike and the filter's sigmas are "
            f"equal; largest in the run with +1 sigma: {in_one}",
        )
    )
    return out


def _return_claims(plan: Plan, whole: Ensemble, gaps: Ensemble, flights: Sequence[Flight]) -> list[Claim]:
    """Steps of the position where a gap begins and where it ends, and the accuracy after it."""

    def step(from_s: float, to_s: float) -> float:
        return rms(gaps.growth(from_s, to_s)[:, 6:9])

    usual = max(step(begin - 2.0, begin - 1.0) for begin, _ in plan.gaps)
    begins = max(step(begin - 1.0, begin) for begin, _ in plan.gaps)
    returns = max(step(end - 1.0, end) for _, end in plan.gaps)
    count = len(plan.gaps)
    calm = rms(gaps.window_rms[:, count:, 6:9])
    steady = rms(whole.over_window(0)[0][6:9])
    first = np.array([flight.first_nis for flight in flights])
    bounds = chi_square_bounds(6, first.size, 0.99)
    mean = float(first.mean())
    return [
        Claim(
            "no_jump_begin",
            "no jump where a gap begins: step of the position over the usual step between fixes",
            "",
            begins / usual,
            1.0,
        ),
        Claim(
            "no_jump_return",
            "no jump where GNSS returns: step of the position over the usual step between fixes",
            "",
            returns / usual,
            1.0,
            note=f"not reachable: the first fix takes out what the gap has built up, {returns:.1f} m rms; "
            "what does not step does not use the fix",
        ),
        Claim(
            "first_fix_nis",
            "the step at the return is what the filter expects: NIS of the first fix after a gap",
            "",
            mean,
            sense="within",
            low=bounds[0],
            high=bounds[1],
            chi_square=direction(mean, 6, bounds),
        ),
        Claim(
            "recovery",
            "full accuracy returns: position rms 60 s to 100 s after a gap over that with GNSS throughout",
            "",
            calm / steady,
            1.1,
        ),
    ]


def _comparison_claims(
    plan: Plan, gaps: Ensemble, readings: Mapping[str, Ensemble], flights: Sequence[Flight]
) -> list[Claim]:
    """Gain over the restarted INS in the first gap; what the reading of the gyro noise changes."""
    ours, theirs = restarted_gain(gaps, flights, 0)
    worst = int(np.argmin(theirs / ours))
    ends = {
        name: float(np.linalg.norm(found.sigma()[gap_end(plan, found, 0), 6:8]) / math.sqrt(2.0))
        for name, found in readings.items()
    }
    return [
        Claim(
            "gain",
            "gain over an INS that is only restarted, gap 1, position rms, worst axis",
            "",
            float(theirs[worst] / ours[worst]),
            1.8,
            "at least",
            note=f"worst axis: {AXES[worst]}; all three together {np.linalg.norm(theirs) / np.linalg.norm(ours):.1f}",
        ),
        Claim(
            "readings",
            "readings A, B, C of the gyro noise: largest difference of the horizontal sigma, end of gap 1",
            "m",
            max(ends.values()) - min(ends.values()),
            1.0,
            note=", ".join(f"{name} {value:.2f} m" for name, value in sorted(ends.items())),
        ),
    ]
