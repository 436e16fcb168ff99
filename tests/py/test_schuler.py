"""Single errors of a free INS by the full mechanisation: the published table, the pendulum, symmetry, the command."""

import json

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

from gnssins import plots
from gnssins.analysis import schuler_curves
from gnssins.analysis.schuler import CASES, SchulerCase
from gnssins.cli import app
from gnssins.errors import ConfigError


@pytest.fixture(scope="module")
def curves():
    return schuler_curves()


def test_full_model_gives_the_corrected_table_within_a_percent(curves):
    expected = {
        "tilt": 12690.0,
        "gyro-horizontal": 1346.0,
        "gyro-vertical": 73.0,
        "velocity": 806.0,
        "accelerometer": 1270.0,
    }
    assert set(curves.curves) == set(expected)
    for key, metres in expected.items():
        assert curves[key].full_m == pytest.approx(metres, rel=0.01), key


def test_full_model_lies_within_a_percent_of_the_pendulum(curves):
    for key, curve in curves.curves.items():
        if key == "gyro-vertical":
            assert curve.pendulum_m is None  # it drives the channel only through the Earth rate
        else:
            assert curve.full_m == pytest.approx(curve.pendulum_m, rel=0.01), key
            # along the axis itself the signs agree, and the turn of the swing over the Earth costs 5 %
            assert np.abs(curve.main_m - curve.closed_m).max() < 0.05 * np.abs(curve.closed_m).max(), key


def test_the_published_tilt_is_ten_times_too_large_for_its_distance():
    tenth = SchulerCase("tilt", "1e-4 rad", tilt_rad=(0.0, 1e-4, 0.0))
    small = schuler_curves(cases=[tenth])["tilt"].full_m
    assert small == pytest.approx(1269.0, rel=0.01)
    assert schuler_curves(cases=CASES[:1])["tilt"].full_m / small == pytest.approx(10.0, rel=1e-3)


def test_both_horizontal_axes_and_both_signs_behave_alike():
    cases = [
        SchulerCase("north", "", accel_m_s2=(1e-3, 0.0, 0.0)),
        SchulerCase("east", "", accel_m_s2=(0.0, 1e-3, 0.0), axis=1),
        SchulerCase("minus", "", accel_m_s2=(-1e-3, 0.0, 0.0)),
        SchulerCase("roll", "", tilt_rad=(1e-4, 0.0, 0.0), axis=1),
        SchulerCase("pitch", "", tilt_rad=(0.0, 1e-4, 0.0)),
        SchulerCase("gyro", "", gyro_rad_s=(1e-7, 0.0, 0.0), axis=1),
        SchulerCase("none", ""),
    ]
    found = schuler_curves(cases=cases)
    assert found["north"].full_m == pytest.approx(found["east"].full_m, rel=5e-3)
    np.testing.assert_allclose(found["minus"].position_m, -found["north"].position_m, atol=0.2)
    assert found["roll"].full_m == pytest.approx(found["pitch"].full_m, rel=5e-3)
    # signs: the main axis follows the pendulum, not its mirror image
    for key in ("east", "roll", "pitch", "gyro"):
        curve = found[key]
        assert np.sign(curve.main_m[1000]) == np.sign(curve.closed_m[1000]) != 0.0, key
    assert found["none"].full_m < 1e-6  # the rest is a rest


def test_the_step_of_the_curves_does_not_matter(curves):
    coarse = schuler_curves(step_s=8.0)
    for key, curve in curves.curves.items():
        assert coarse[key].full_m == pytest.approx(curve.full_m, rel=1e-3), key


def test_no_curve_is_refused():
    for figures in ({"duration_s": 1.0, "step_s": 2.0}, {"step_s": 0.0}, {"duration_s": -5.0}):
        with pytest.raises(ConfigError, match="no curve"):
            schuler_curves(**figures)


def test_command_writes_table_curves_and_figure(tmp_path, curves):
    done = CliRunner().invoke(app, ["schuler", "--out", str(tmp_path / "out"), "--json"])
    told = json.loads(done.stdout)
    assert told["cases"]["tilt"]["full_m"] == pytest.approx(curves["tilt"].full_m)
    assert [
        (tmp_path / "out" / name).stat().st_size > 100
        for name in ("schuler.txt", "schuler.csv", "schuler.png")
    ]
    frame = pl.read_csv(tmp_path / "out" / "schuler.csv")
    assert frame.columns[:4] == ["time_s", "tilt_north_m", "tilt_east_m", "tilt_pendulum_m"]
    assert frame["velocity_north_m"].max() == pytest.approx(curves["velocity"].main_m.max(), rel=1e-6)
    text = CliRunner().invoke(app, ["schuler", "--lat", "0"]).stdout
    assert "at 0 deg" in text
    assert "1300 m belongs to 1e-4 rad" in text
    assert len(plots.schuler(curves).axes) == len(CASES)
