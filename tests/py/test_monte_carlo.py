"""Monte Carlo in the core: its sensors against those in Python, sums against runs, order, stores, executors."""

import json
import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import gnssins
from gnssins import Config, Simulator, _core, monte_carlo, run, simulated_run
from gnssins.analysis import Parameters, chi_square_bounds, compare, nees, nis, outage_table
from gnssins.errors import ConfigError, GapError, InputError
from gnssins.sim import load_scenario, scenario_from_dict, scenario_names
from gnssins.simfiles import scenario_config
from short_flight import GAP_S, config, simulator

SEED, RUN = 11, 5


def quick(**run_keys) -> Config:
    return config(output_rate_hz=1.0, **run_keys)


def equal(one, other) -> bool:
    """Whether two sets are the same bit by bit."""
    return one.to_dict() == other.to_dict() and np.array_equal(one.run_rms, other.run_rms)


# ---- the simulated sensors


class Fed:
    """A stream of the simulation in Python that gives the deviates of the core."""

    def __init__(self, name: str) -> None:
        self.name = name

    def series(self, part: int, count: int):
        return _core.monte_carlo_deviates(SEED, RUN, self.name, part, count)

    def start(self, count: int):
        return np.array([self.series(64 + c, 1)[0] for c in range(count)])

    def standard_normal(self, size=None):
        if isinstance(size, int):
            return self.series(0, size) if self.name in ("baro", "heading") else self.start(size)
        if self.name in ("imu.gyro", "imu.accel") and size[0] == 1:
            return self.start(3)[None]
        if len(size) == 3:
            rows = [self.series(part, size[1]) for part in range(6)]
            return np.stack([np.column_stack(rows[:3]), np.column_stack(rows[3:])])
        process = self.name.startswith("imu.error.") or self.name.endswith(("_error", ".bias"))
        if process:  # components by epochs, the first one drawn at the start
            drives = [self.series(part, size[1] - 1) for part in range(size[0])]
            return np.column_stack([self.start(size[0]), np.array(drives)])
        return np.column_stack([self.series(part, size[0]) for part in range(3)])


EVERYTHING = {
    "imu": {
        "gyro": {"arw_deg_sqrt_h": 0.3, "bandwidth_hz": 12.0, "range_deg_s": 3.0},
        "accel": {"vrw_m_s_sqrt_h": 0.1, "increment_lsb_mm_s": 0.02, "range_g": 1.01},
        "error": [
            {"kind": "gyro_bias", "name": "fixed", "unit": "deg/h", "value": [10.0, -5.0, 3.0]},
            {"kind": "gyro_scale", "process": "random_walk", "unit": "ppm", "initial_sd": 50.0, "walk": 9.0},
            {"kind": "gyro_misalignment", "unit": "mrad", "initial_sd": 1.0},
            {
                "kind": "accel_misalignment",
                "process": "gauss_markov",
                "unit": "mrad",
                "sd": 2.0,
                "tau_s": 9.0,
            },
        ],
    },
    "gnss": {
        "rate_hz": 3.0,
        "first_s": 0.123,
        "latency_ms": 70.0,
        "position_sd_m": 2.0,
        "velocity_sd_m_s": 0.1,
        "lever_ba_b_m": [1.0, 0.5, -0.7],
        "lever_error_sd_m": [0.1, 0.2, 0.3],
        "constellation_changes": [20.0, 20.1, 40.0],
        "position_jump_sd_m": 3.0,
        "position_error": {"sd_m": 4.0, "tau_s": 30.0, "distance_m": 500.0, "jump_sd_m": 2.0},
        "velocity_error": {"sd_m_s": 0.2, "tau_s": 10.0},
        "outages": [[30.0, 33.3]],
    },
    "baro": {"rate_hz": 7.0, "height_sd_m": 0.5, "bias_initial_sd_m": 3.0, "bias_walk_m_sqrt_s": 0.2},
    "heading": {"rate_hz": 2.0, "heading_sd_deg": 0.5, "latency_ms": 15.0},
}


def with_everything() -> Simulator:
    tables = load_scenario("car-loop").model_dump(mode="json", exclude_none=True) | EVERYTHING
    tables["scenario"] |= {"duration_s": 60.0, "rate_hz": 50.0}
    return Simulator(scenario_from_dict(tables | {"variant": {}}))


@pytest.mark.parametrize("name", [*scenario_names(), "everything"])
def test_with_equal_deviates_the_core_simulates_what_python_simulates(name, monkeypatch):
    sim = with_everything() if name == "everything" else Simulator(name)
    made = simulated_run(sim, SEED, RUN)
    monkeypatch.setattr("gnssins.sim.Streams", lambda seed: Fed)
    wanted = sim.run(SEED)
    a, b = made.dataset, wanted.dataset
    imu, gnss = sim.scenario.imu, sim.scenario.gnss
    # of a hundred thousand roundings one may fall the other way: an increment then differs by one count
    for values, other, lsb in (
        (a.imu.gyro, b.imu.gyro, imu.gyro.increment_lsb_arcsec),
        (a.imu.accel, b.imu.accel, imu.accel.increment_lsb_mm_s),
    ):
        close = np.isclose(values, other, rtol=1e-11, atol=1e-15)
        assert close.mean() > (1.0 - 1e-4 if lsb else 1.0 - 1e-12)
    assert np.array_equal(a.gnss.t_ns, b.gnss.t_ns)
    metres = (a.gnss.lla - b.gnss.lla) * [6.4e6, 6.4e6, 1.0]
    assert np.allclose(metres[np.isfinite(b.gnss.lla)], 0.0, atol=2e-8)
    assert np.allclose(a.gnss.v_n, b.gnss.v_n, rtol=1e-12, atol=1e-8, equal_nan=True)
    assert np.array_equal(a.gnss.var, b.gnss.var, equal_nan=True)
    if gnss.constellation_changes:
        assert np.array_equal(a.gnss.new_constellation, b.gnss.new_constellation)
    assert np.allclose(a.baro.height_m, b.baro.height_m, rtol=0.0, atol=1e-9)
    assert np.array_equal(a.baro.t_ns, b.baro.t_ns)
    assert np.allclose(a.heading.heading_rad, b.heading.heading_rad, rtol=0.0, atol=1e-12)
    assert np.array_equal(a.heading.t_ns, b.heading.t_ns)
    assert list(made.truth_blocks) == list(wanted.truth_blocks)
    for block, values in wanted.truth_blocks.items():
        # 300 000 steps of a process carry the last digit of its factor along
        assert np.allclose(made.truth_blocks[block], values, rtol=0.0, atol=1e-9 * np.abs(values).max()), (
            block
        )
    assert np.allclose(made.initial_error, wanted.initial_error, rtol=1e-14)
    assert np.allclose(made.initial.lla, wanted.initial.lla, rtol=0.0, atol=2e-15 * 1e6)
    assert np.allclose(made.initial.q_nb, wanted.initial.q_nb, rtol=0.0, atol=1e-15)
    assert np.array_equal(made.initial.v_n, wanted.initial.v_n)


def test_deviates_of_streams_runs_and_seeds_are_normal_and_apart():
    n = 40_000
    base = _core.monte_carlo_deviates(1, 2, "imu.gyro", 0, n)
    others = [
        _core.monte_carlo_deviates(*key, n)
        for key in (
            (2, 2, "imu.gyro", 0),
            (1, 3, "imu.gyro", 0),
            (1, 2, "imu.accel", 0),
            (1, 2, "imu.gyro", 1),
        )
    ]
    assert abs(base.mean()) < 5.0 / np.sqrt(n)
    assert abs(base.var() - 1.0) < 5.0 * np.sqrt(2.0 / n)
    for other in others:
        assert abs(np.corrcoef(base, other)[0, 1]) < 5.0 / np.sqrt(n)
    for lag in (1, 16, 64):
        assert abs(np.mean(base[lag:] * base[:-lag])) < 5.0 / np.sqrt(n - lag)
    assert np.array_equal(base[:100], _core.monte_carlo_deviates(1, 2, "imu.gyro", 0, 100))


# ---- sums against runs


@pytest.mark.parametrize("name", ["car-loop", "novik-2011", "vasilyuk-2019", "everything", "short"])
def test_a_run_by_itself_has_the_errors_that_the_set_counts(name):
    sims = {"everything": with_everything, "short": simulator}
    sim = sims[name]() if name in sims else Simulator(name)
    settings = Config.from_dict(scenario_config(simulated_run(sim)))
    settings = settings.replace(run={"output_rate_hz": 2.0, "covariance_interval_s": 5.0})
    after_s = 10.0
    two = [monte_carlo(sim, settings, n, seed=SEED, after_s=after_s) for n in (1, 2)]
    simulated = simulated_run(sim, SEED, 1)
    result = run(settings, simulated)
    found = compare(result, simulated.truth, ellipsoid=str(result.metadata["ellipsoid"])).between(after_s)
    rms = np.concatenate(
        [np.sqrt(np.mean(e**2, axis=0)) for e in (found.position, found.velocity, found.phi)]
    )
    # the compared longitudes are wrapped here, which costs them a digit
    assert np.allclose(two[1].run_rms[1], rms, rtol=1e-12, atol=[0, 2e-9, 0, *[1e-15] * 6])
    one = nees(result, simulated.truth, Parameters.of(simulated))
    assert list(one.groups) == list(two[1].nees.groups)
    for group, values in one.groups.items():
        of_second = 2.0 * two[1].nees[group].value - two[0].nees[group].value
        assert np.allclose(of_second, values.value, rtol=1e-5), group
        assert np.array_equal(values.t_ns, two[1].nees[group].t_ns)
    joint = nis(result, after_s=after_s)
    for group, values in two[1].nis_by_source.groups.items():
        first = two[0].nis_by_source[group]
        assert values.count - first.count == joint[group].count
        assert values.mean * values.count - first.mean * first.count == pytest.approx(
            joint[group].mean * joint[group].count, rel=1e-9
        )
    for key in ("in", "used", "rejected", "late", "bad"):
        assert two[1].counts[key] - two[0].counts[key] == result.counts["gnss"][key]
        for aid, counts in two[1].aid_counts.items():
            assert counts[key] - two[0].aid_counts[aid][key] == result.counts[aid][key]


def test_ends_of_gaps_are_those_of_the_outage_table():
    settings = quick(outages=[GAP_S, (270.2, 280.9)])
    found = monte_carlo(simulator(), settings, 1, seed=4)
    simulated = simulated_run(simulator(), 4)
    table = outage_table(run(settings, simulated), simulated.truth)
    assert found.gap_ratio.shape == (2, 9)
    for k, gap in enumerate(table.outages):
        ends = np.concatenate([gap.end_position, gap.end_velocity, gap.end_euler])
        assert np.allclose(found.gap_rms[k], np.abs(ends), rtol=1e-9, atol=3e-9)
        assert np.allclose(found.gap_sigma[k], gap.end_sd, rtol=1e-12)
        assert np.allclose(found.gap_ratio[k], np.abs(gap.end_sigmas), rtol=1e-8)


def test_the_set_adds_up():
    shares: list[float] = []
    found = monte_carlo(simulator(), quick(outages=[GAP_S]), 10, seed=5, after_s=50.0, progress=shares.append)
    assert shares == [0.4, 0.8, 1.0]
    assert found.complete
    assert found.rms.shape == (3, 3)
    assert found.position == pytest.approx(np.sqrt(np.mean(found.run_position**2, axis=0)))
    assert found.nees["all"].runs == 10
    assert found.nees["all"].bounds == chi_square_bounds(18, 10)
    assert found.error_rms.shape == found.sigma_rms.shape == (found.time_s.size, 9)
    assert found.counts["in"] == sum(found.counts[k] for k in ("used", "rejected", "late", "bad"))
    assert found.nis.count == 10 * 200
    assert found.run_steps == 10 * 15_000
    assert found.steps_per_s > 0.0
    assert "over sigma" in found.table()
    json.dumps(found.to_dict(), allow_nan=False)
    low, high = chi_square_bounds(18, 10, 0.9999)
    assert low < found.nees.after(50.0)["all"].mean < high


# ---- order


def test_the_figures_are_the_same_bits_for_any_jobs_and_executors():
    settings = quick(outages=[GAP_S])

    def figures(**how):
        return monte_carlo(simulator(), settings, 9, seed=5, after_s=50.0, **how)

    one = figures(jobs=1)
    assert equal(one, figures(jobs=3))
    with ThreadPoolExecutor(2) as pool:
        assert equal(one, figures(executor=pool))
    with ProcessPoolExecutor(2) as pool:
        assert equal(one, figures(executor=pool))
    assert not equal(one, monte_carlo(simulator(), settings, 9, seed=6, after_s=50.0))


def test_the_executor_of_a_dask_client_gives_the_same_bits():
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        found = monte_carlo("static", runs=9, seed=2, executor=client.get_executor())
    assert equal(found, monte_carlo("static", runs=9, seed=2))


def test_many_runs_need_no_more_memory_than_a_few():
    # GIVEN a process each, THEN the peak of 400 runs lies within 4 MB of that of 8
    code = (
        "import gnssins, resource, sys; gnssins.monte_carlo('static', runs=int(sys.argv[1]), jobs=2); "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    peaks_kb = [
        int(subprocess.run([sys.executable, "-c", code, runs], check=True, capture_output=True).stdout)
        for runs in ("8", "400")
    ]
    assert peaks_kb[1] - peaks_kb[0] < 4096, peaks_kb


# ---- breaks


def test_an_interrupt_keeps_the_finished_runs_and_the_store_goes_on(tmp_path):
    store, settings = tmp_path / "sweep.npz", quick()
    whole = monte_carlo(simulator(), settings, 30, seed=3, after_s=50.0)

    def interrupt(share: float) -> None:
        if share > 0.4:
            raise KeyboardInterrupt

    part = monte_carlo(simulator(), settings, 30, seed=3, after_s=50.0, progress=interrupt, store=store)
    assert (part.runs, part.asked, part.complete) == (16, 30, False)
    assert "16 runs of 30, interrupted" in part.table()
    assert np.array_equal(part.run_rms, whole.run_rms[:16])
    # the rest, then nothing more, then a longer sweep, which knows that the last chunk was not whole
    rest = monte_carlo(simulator(), settings, 30, seed=3, after_s=50.0, store=store)
    assert rest.computed == 14
    assert equal(rest, whole)
    again = monte_carlo(simulator(), settings, 30, seed=3, after_s=50.0, store=store)
    assert (again.runs, again.computed) == (30, 2)
    longer = monte_carlo(simulator(), settings, 34, seed=3, after_s=50.0, store=store)
    assert equal(longer, monte_carlo(simulator(), settings, 34, seed=3, after_s=50.0))
    assert [file.name for file in tmp_path.iterdir()] == ["sweep.npz"]


def test_ctrl_c_ends_a_set_early():
    # GIVEN a signal shortly after the first chunk, while the core is at work without the GIL
    timer = threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT))
    began: list[float] = []

    def begin(share: float) -> None:
        if not began:
            timer.start()
        began.append(share)

    found = monte_carlo(simulator(), quick(), 5000, seed=3, progress=begin)
    timer.join()
    assert not found.complete
    assert found.runs % _core.MonteCarlo.CHUNK == 0


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 4}, "seed"),
        ({"after_s": 1.0}, "after_s"),
        ({"covariance": "shared"}, "covariance"),
        ({"config": True}, "configuration"),
        ({"scenario": "car-loop"}, "scenario"),
    ],
)
def test_a_store_of_another_sweep_is_refused(tmp_path, change, named):
    store = tmp_path / "sweep.npz"
    settings = Config.from_dict(scenario_config(simulated_run("static")))
    how = {"scenario": "static", "config": settings, "runs": 4, "seed": 3, "store": store}
    monte_carlo(**how)
    if "config" in change:
        change = {"config": settings.replace(run={"output_rate_hz": 2.0})}
    with pytest.raises(ConfigError, match=f"another .*{named}") as raised:
        monte_carlo(**(how | change))
    assert raised.value.code == "config.store"


def test_a_store_that_is_none_or_too_long_is_refused(tmp_path):
    store = tmp_path / "sweep.npz"
    store.write_text("nothing of the kind")
    with pytest.raises(InputError, match="is not the store of a Monte Carlo"):
        monte_carlo("static", runs=2, store=store)
    store.unlink()
    monte_carlo("static", runs=8, store=store)
    with pytest.raises(ConfigError, match="holds 8 runs, more than the 4"):
        monte_carlo("static", runs=4, store=store)


# ---- errors


def test_a_failing_run_ends_the_set_with_its_error_and_number():
    sim = simulator()
    settings = quick().replace(imu={"max_gap_s": 0.01})
    with pytest.raises(GapError) as raised:
        monte_carlo(sim, settings, 3, jobs=2)
    assert raised.value.context["run"] == 0


@pytest.mark.parametrize("option", ["--out", "--store"])
def test_files_that_cannot_be_written_are_refused_before_the_first_run(tmp_path, capsys, option):
    from gnssins import cli

    for file, what in ((tmp_path, "is a folder"), (tmp_path / "none" / "x.json", "does not exist")):
        sys.argv = ["gnssins", "montecarlo", "static", "--runs", "100000000", option, str(file)]
        with pytest.raises(SystemExit) as left:
            cli.main()
        assert left.value.code == 1
        assert what in capsys.readouterr().err


def test_figures_out_of_range_are_refused():
    with pytest.raises(ConfigError, match="run = -1: must lie between 0"):
        simulated_run("static", seed=1, run=-1)
    with pytest.raises(ConfigError, match=r"runs = 2\.5"):
        monte_carlo("static", runs=2.5)
    for how in ({"runs": 0}, {"seed": -1}, {"jobs": 0}):
        with pytest.raises(ConfigError, match="must lie between"):
            monte_carlo("static", **how)
    with pytest.raises(ConfigError, match='"diagonal" is unknown'):
        monte_carlo("static", covariance="diagonal")
    with pytest.raises(ConfigError, match="starts with the simulation"):
        monte_carlo(simulator(), quick(start_s=100.0), 2)
    with pytest.raises(InputError, match="no epoch of comparison after after_s = 1000 s"):
        monte_carlo("static", runs=2, after_s=1000.0)
    slow = quick().to_dict()
    slow["filter"]["feedback_interval_s"] = 5.0
    with pytest.raises(ConfigError, match="feedback_interval"):
        monte_carlo(simulator(), slow, 2, covariance="shared")


# ---- one covariance for all


def test_shared_covariance_agrees_with_the_full_mode_where_errors_are_small():
    # GIVEN the flight with a gap, THEN the root mean squares agree within 2 %, NEES within 3 %, sigmas within 1 %
    settings = config(output_rate_hz=1.0, outages=[GAP_S]).replace(gnss={"gate_probability": "off"})
    full, shared = (
        monte_carlo(simulator(), settings, 60, seed=8, after_s=50.0, covariance=mode)
        for mode in ("full", "shared")
    )
    assert np.allclose(shared.rms, full.rms, rtol=0.02)
    assert np.allclose(shared.gap_rms, full.gap_rms, rtol=0.02)
    assert np.allclose(shared.sigma_rms, full.sigma_rms, rtol=0.01)
    for name, group in full.nees.after(50.0).groups.items():
        assert shared.nees.after(50.0)[name].mean == pytest.approx(group.mean, rel=0.03), name
    assert shared.nis.mean == pytest.approx(full.nis.mean, rel=0.01)
    assert shared.counts == full.counts


def test_shared_covariance_flies_without_the_errors_that_the_filter_knows_beforehand():
    # GIVEN a bias of 360 deg/h known within 5 deg/h, THEN the nominal run, which has none, takes none off
    tables = load_scenario("static").model_dump(mode="json", exclude_none=True)
    bias = {"kind": "gyro_bias", "unit": "deg/h", "process": "constant", "value": [360.0] * 3}
    tables["imu"]["error"] = [bias]
    sim = Simulator(scenario_from_dict(tables))
    filtering = scenario_config(simulated_run(sim))
    filtering["filter"]["block"][0] |= {"initial": [360.0] * 3, "initial_sd": [5.0] * 3}
    settings = Config.from_dict(filtering).replace(gnss={"gate_probability": "off", "max_accel_m_s2": 1e-9})
    full = monte_carlo(sim, settings.replace(gnss={"max_accel_m_s2": 1e6}), 24, seed=4)
    shared = monte_carlo(sim, settings, 24, seed=4, covariance="shared")
    assert np.allclose(shared.position, full.position, rtol=0.03)
    assert np.allclose(shared.sigma_rms, full.sigma_rms, rtol=0.02)


def test_shared_covariance_does_not_hold_for_a_large_heading_error():
    # GIVEN a heading known to 40 deg only, THEN the gains of the errorless run are the wrong ones
    tables = load_scenario("car-loop").model_dump(mode="json", exclude_none=True)
    tables["scenario"]["duration_s"], tables["gnss"]["outages"], tables["variant"] = 240.0, [], {}

    def excess(heading_sd_deg: float):
        tables["initial_error"]["attitude_sd_deg"] = [1.0, 1.0, heading_sd_deg]
        sim = Simulator(scenario_from_dict(tables))
        settings = Config.from_dict(scenario_config(simulated_run(sim))).replace(
            gnss={"gate_probability": "off"}
        )
        full, shared = (
            monte_carlo(sim, settings, 24, seed=1, covariance=mode).velocity for mode in ("full", "shared")
        )
        return shared / full - 1.0

    assert np.abs(excess(1.0)).max() < 0.01
    assert excess(40.0)[0] > 0.3


# ---- command


def test_the_command_writes_what_the_function_gives(tmp_path, capsys, monkeypatch):
    from gnssins.cli import main

    out = tmp_path / "figures.json"
    words = ["gnssins", "montecarlo", "static", "--runs", "6", "--seed", "9", "--out", str(out), "--json"]
    monkeypatch.setattr("sys.argv", words)
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(out.read_text())
    found = monte_carlo("static", runs=6, seed=9)
    assert printed["position_m"] == found.position.tolist()
    assert printed["run_steps"] == 6 * 12_000
    monkeypatch.setattr("sys.argv", [*words[:3], "--runs", "2", "--covariance", "none"])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 1


def test_names_are_at_the_top():
    assert {"MonteCarlo", "monte_carlo", "simulated_run"} <= set(gnssins.__all__)
    assert isinstance(monte_carlo("static", runs=1), gnssins.MonteCarlo)
    assert replace(monte_carlo("static", runs=1), asked=3).complete is False
