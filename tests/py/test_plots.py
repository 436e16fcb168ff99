"""Figures: every function returns one, labelled, of bounded size, without touching any global state."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

import gnssins
from gnssins import plots
from gnssins.analysis import NavErrors, Parameters, compare
from gnssins.errors import InputError
from gnssins.plots import style
from gnssins.result import Result
from short_flight import config, result, simulated


def errors() -> NavErrors:
    return compare(result(), simulated().dataset.truth)


def figures(r: Result) -> dict[str, Figure]:
    windows = r.outages()
    return {
        "track": plots.track(r, simulated().dataset.truth),
        "position_errors": plots.position_errors(errors(), windows),
        "velocity_errors": plots.velocity_errors(errors(), windows),
        "attitude_errors": plots.attitude_errors(errors(), windows),
        "biases": plots.biases(r, Parameters.of(simulated())),
        "innovations": plots.innovations(r),
        "nis": plots.nis(r),
    }


def points(figure: Figure) -> int:
    """Vertices drawn as lines in the fullest axes of a figure."""
    return max(sum(len(line.get_xdata()) for line in ax.lines) for ax in figure.axes)


def test_every_figure_is_labelled_and_has_a_legend_and_a_title():
    for name, figure in figures(result()).items():
        assert isinstance(figure, Figure), name
        assert figure.get_suptitle(), name
        assert figure.legends, name
        shown = [ax for ax in figure.axes if ax.get_visible()]
        assert any(ax.get_xlabel() in ("Time (s)", "East of the start (km)") for ax in shown), name
        assert any(ax.get_ylabel() for ax in shown), name


def test_units_stand_at_the_axes():
    made = figures(result())
    assert [ax.get_ylabel() for ax in made["position_errors"].axes] == ["North (m)", "East (m)", "Down (m)"]
    assert made["velocity_errors"].axes[0].get_ylabel() == "North (m/s)"
    assert made["attitude_errors"].axes[2].get_ylabel() == "Heading (arcmin)"
    assert [made["biases"].axes[i].get_ylabel() for i in (0, 3, 6)] == ["deg/h", "deg/h", "mg"]


def test_large_attitude_errors_are_shown_in_degrees():
    wild = replace(errors(), euler=errors().euler + 0.1)
    assert plots.attitude_errors(wild).axes[0].get_ylabel() == "Roll (deg)"


def test_gaps_are_shaded():
    shaded = list(plots.position_errors(errors(), result().outages()).axes[0].patches)
    assert len(shaded) == 1
    assert shaded[0].get_x() == 200.0
    assert shaded[0].get_width() == 50.0
    assert not plots.position_errors(errors()).axes[0].patches


def test_all_errors_lie_inside_the_axes():
    figure = plots.position_errors(errors())
    for ax, values in zip(figure.axes, errors().position.T, strict=True):
        low, high = ax.get_ylim()
        assert low < values.min()
        assert values.max() < high
    assert len({ax.get_ylim() for ax in figure.axes}) == 1


def test_a_long_run_is_thinned_and_keeps_its_extremes():
    e, factor = errors(), 100
    long = NavErrors(
        np.arange(len(e) * factor) * 10_000_000,
        *(np.repeat(a, factor, axis=0) for a in (e.position, e.velocity, e.phi, e.euler, e.sd)),
    )
    assert len(long) == 300_100
    long.position[123_456, 0] = 55.0
    figure = plots.position_errors(long)
    assert points(figure) < 10_000
    assert figure.axes[0].lines[0].get_ydata().max() == 55.0


def test_a_wild_fix_does_not_flatten_the_innovations_and_is_marked():
    r = result()
    records = replace(
        r.records,
        status=r.records.status.copy(),
        nis=r.records.nis.copy(),
        innovation=r.records.innovation.copy(),
    )
    records.status[20], records.nis[20], records.innovation[20] = 1, 1e6, 1e4
    wild = replace(r, records=records)
    assert plots.innovations(wild).axes[0].get_ylim()[1] < 20.0
    nis = plots.nis(wild)
    assert nis.axes[0].get_ylim()[1] <= 12.0
    names = [text.get_text() for text in nis.legends[0].get_texts()]
    assert "beyond the axis" in names


def labels(r: Result) -> list[str]:
    return [text.get_text() for text in plots.track(r).axes[0].texts]


def test_start_and_end_share_a_label_where_they_meet():
    r = result()
    assert labels(r) == ["start", "end"]
    lla = r.lla.copy()
    lla[-1] = lla[0] + [1e-7, 1e-7, 0.0]
    assert labels(replace(r, lla=lla)) == ["start, end"]


def test_a_short_burst_of_the_band_does_not_flatten_the_estimates():
    r = result()
    x_sd = r.x_sd.copy()
    x_sd[2000:2030] *= 100.0
    usual, burst = (plots.biases(made).axes[0].get_ylim()[1] for made in (r, replace(r, x_sd=x_sd)))
    assert usual <= burst < 1.5 * usual


def test_runs_without_truth_fixes_or_velocities_can_be_drawn():
    r = gnssins.run(config(end_s=20.0).replace(gnss={"use": "position"}), simulated())
    assert len(plots.innovations(r).axes) == 3
    empty = gnssins.run(config(end_s=0.5), simulated())
    for draw in (plots.track, plots.innovations, plots.nis, plots.biases):
        assert isinstance(draw(empty), Figure)


def test_a_filter_without_blocks_has_no_biases_to_draw():
    r = replace(result(), states=result().states[:9])
    with pytest.raises(InputError, match="estimates no sensor errors"):
        plots.biases(r)


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_figures_are_saved_in_the_format_of_the_name(tmp_path, suffix):
    path = plots.save(plots.nis(result()), tmp_path / f"nis.{suffix}")
    head = path.read_bytes()[:200]
    assert {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}[suffix] in head
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_pyplot_is_never_imported():
    code = "import sys; from gnssins import plots; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@given(
    st.lists(st.floats(-1e3, 1e3) | st.just(float("nan")), min_size=1, max_size=300),
    st.integers(1, 20),
)
def test_an_envelope_keeps_extremes_ends_and_order(values, buckets):
    y = np.array(values)
    x = np.arange(y.size, dtype=np.float64)
    thin_x, thin_y = style.envelope(x, y, buckets)
    assert len(thin_x) <= max(2 * buckets + 2, 2)
    assert (np.diff(thin_x) > 0).all()
    assert thin_x[0] == 0
    assert thin_x[-1] == y.size - 1
    if np.isfinite(y).any():
        assert np.nanmax(thin_y) == np.nanmax(y)
        assert np.nanmin(thin_y) == np.nanmin(y)


def test_thin_keeps_the_last_row():
    x = np.arange(10_001, dtype=np.float64)
    thinned, same = style.thin(x, x, points=100)
    assert len(thinned) <= 102
    assert thinned[-1] == 10_000
    assert np.array_equal(thinned, same)


def test_lines_are_broken_where_time_jumps():
    x, y = style.broken(np.array([0.0, 1.0, 2.0, 50.0, 51.0]), np.arange(5.0))
    assert np.array_equal(x, [0.0, 1.0, 2.0, 50.0, 50.0, 51.0])
    assert np.array_equal(y, [0.0, 1.0, 2.0, np.nan, 3.0, 4.0], equal_nan=True)
