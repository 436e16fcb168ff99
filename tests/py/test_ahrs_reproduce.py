"""The reproduction of Aleshkin et al. (2021): its figures, its verdicts, its files."""

import json

import numpy as np
import pytest

from gnssins.ahrs import Positional
from gnssins.reproduce import aleshkin_runs as runs
from gnssins.reproduce import publication, reproduce


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("aleshkin")
    seen = []
    found = reproduce("aleshkin-2021", runs=1, seed=4, jobs=2, out=folder, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0)
    return found, folder


def test_what_the_publication_cannot_reach_is_told_and_everything_else_is_reached(report):
    found, _ = report
    assert {c.key for c in found.missed} == {"butterworth", "roll_off", "ripple"}
    assert all(c.note for c in found.missed)
    assert found["roll_off"].ours == pytest.approx(-20.0, abs=0.01)
    assert found["ripple"].ours == pytest.approx(3.14, abs=0.01)
    assert found["bound"].ours == pytest.approx(-29.5)
    assert found["stable"].ours == 0
    assert found["noise_heading"].verdict == "measured"


def test_every_law_converges_in_a_fast_turn(report):
    found, _ = report
    assert found["fast_turn"].ours < 1e-4
    # 30 deg off at the start, gains of 42.8/s: within a second to 30 exp(-29.5) deg at most, and no further off later
    assert runs.turned_fast(runs.CROSS, "elements") < 1e-9
    assert runs.turned_fast(Positional(4.28), None) == pytest.approx(30.0 * np.exp(-4.28), rel=0.05)


def test_corners_are_those_of_the_running_law(report):
    found, _ = report
    for key, corner in (("pitch", 7.91), ("heading", 7.91), ("roll", 6.59), ("positional", 6.82)):
        assert found[f"corner_{key}"].ours == pytest.approx(corner, rel=0.005)
    table = next(t for t in found.tables if t.name == "tunings")
    for row in table.rows:
        if row[3] is not None:
            assert row[3] == pytest.approx(row[2], rel=2e-3), row[0]


def test_noise_is_the_lyapunov_solution_and_half_the_published_one(report):
    found, _ = report
    assert 0.98 <= found["noise_lyapunov"].ours <= 1.02
    assert found["noise_heading"].ours == pytest.approx(0.686, rel=0.02)
    # explicit Euler of the same law at 100 Hz: 1.547e-6 for roll by the discrete Lyapunov equation
    step = np.eye(3) - runs.CROSS.matrix() * runs.NOISE_S
    p = np.zeros((3, 3))
    drive = np.array([[0, 1, 0], [0, 0, 0], [-1, 0, 0]]) * runs.NOISE_S * runs.NOISE_DEG_S
    for _ in range(200):
        p = step @ p @ step.T + drive @ drive.T
    assert p[2, 2] == pytest.approx(1.547e-6, rel=1e-3)
    assert runs.stepped_noise(3)[0] == pytest.approx(p[2, 2], rel=0.03)
    assert runs.stepped_noise(3)[1] == pytest.approx(p[0, 0], rel=0.03)


def test_schuler_table_is_that_of_the_specification(report):
    found, _ = report
    table = next(t for t in found.tables if t.name == "schuler")
    np.testing.assert_allclose([row[1] for row in table.rows], [0.0, 0.0073, 0.158, 0.143], atol=6e-4)


def test_files_hold_what_the_report_says(report):
    found, folder = report
    summary = json.loads((folder / "summary.json").read_text())
    assert [c["key"] for c in summary["claims"]] == [c.key for c in found.claims]
    for name in summary["files"]:
        assert (folder / name).stat().st_size > 0, name
    assert {"bode_measured.png", "bode_gyro.png", "steps.png", "stability.png", "comparison.png"} <= set(
        summary["files"]
    )


def test_seed_decides_and_threads_do_not():
    first = runs.simulated_noise(runs.CROSS, 1e-3, "gyro", 0.01, 1000, 5)
    np.testing.assert_array_equal(first, runs.simulated_noise(runs.CROSS, 1e-3, "gyro", 0.01, 1000, 5))
    assert (first != runs.simulated_noise(runs.CROSS, 1e-3, "gyro", 0.01, 1000, 6)).all()
    assert publication("aleshkin-2021").runs == 20
