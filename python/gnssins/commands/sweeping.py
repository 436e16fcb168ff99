"""``gnssins montecarlo``: many simulated runs of a scenario, and what they say together."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal, cast

from gnssins.config import Config
from gnssins.montecarlo import monte_carlo
from gnssins.outputs import refuse_inputs, refuse_no_file
from gnssins.sim import Simulator
from gnssins.storage import write_atomic
from gnssins.terminal import message, plain, progress, put, put_json

__all__ = ["montecarlo"]


def montecarlo(
    scenario: str,
    config: Path | None,
    variant: str | None,
    runs: int,
    seed: int,
    jobs: int | None,
    covariance: str,
    after_s: float,
    store: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """``gnssins montecarlo``."""
    files = [file for file in (out, store) if file is not None]
    refuse_inputs(files, [scenario, config])
    for file in files:
        refuse_no_file(file)
    simulator = Simulator(scenario, variant=variant)
    settings = Config.load(config) if config is not None else None
    with progress(f"{simulator.scenario.name}, {runs} runs") as bar:
        found = monte_carlo(
            simulator,
            settings,
            runs,
            seed=seed,
            jobs=jobs,
            covariance=cast("Literal['full', 'shared']", covariance),
            after_s=after_s,
            progress=bar,
            store=store,
        )
    figures = {
        "scenario": simulator.scenario.name,
        "variant": variant,
        **found.to_dict(),
        "wall_s": found.wall_s,
        "run_steps": found.run_steps,
    }
    if as_json:
        put_json(figures)
    else:
        put(found.table())
        if found.computed:
            speed = f"{found.steps_per_s / 1e6:.2f} million run-steps per second"
            put(f"\n{found.computed} runs of {found.imu_rows} IMU rows in {found.wall_s:.1f} s: {speed}")
    if out is not None:
        text = json.dumps(plain(figures), indent=2, ensure_ascii=False) + "\n"
        write_atomic(out, lambda path: path.write_text(text, encoding="utf-8"))
    if not found.complete:
        hint = f"; the same command goes on from {store}" if store is not None else ""
        message(f"interrupted: the first {found.runs} of {found.asked} runs are counted{hint}", "yellow")
        raise KeyboardInterrupt
