"""The recorded drives and flights: every example runs, all rows are accounted for, and no figure is worse than that of
the plain 15-state filter which the data set states.

Few windows stand behind each figure (1 to 7): this guards against regressions, it ranks nothing.
"""

import tomllib

import numpy as np
import pytest

from gnssins import Config, read_dataset, run
from gnssins.analysis import compare, outage_table

SETS = [
    "car-comma-hwy",
    "car-rtkx-drive",
    "static-vn310",
    "static-vn310-rinex",
    "uav-px4-wing",
    "uav-qdr-h09",
    "uav-qdr-h11",
    "uav-umn-thor75",
    "walk-rtkx",
]
# attitude references that come from other sensors than the log's, with their own accuracy (deg)
INDEPENDENT_ATTITUDE = {"car-comma-hwy": 0.05, "uav-qdr-h09": 0.1, "uav-qdr-h11": 0.1}


@pytest.fixture(scope="module", params=SETS)
def recorded(request, shared_data, repository):
    """Baseline figures, configuration and rows of one set."""
    name = request.param
    baseline = tomllib.loads((shared_data / name / "meta.toml").read_text())["baseline"]
    tables = tomllib.loads((repository / "examples" / f"{name}.toml").read_text())
    for section in ("imu", "gnss", "truth"):
        if section in tables:
            tables[section]["file"] = str(shared_data / name / tables[section]["file"].rsplit("/", 1)[1])
    config = Config.from_dict(tables)
    return name, baseline, config, read_dataset(config)


def test_errors_without_gnss_are_no_larger_than_the_baseline(recorded):
    _, baseline, config, dataset = recorded
    windows = [[s, s + baseline["outage_len_s"]] for s in baseline["outage_starts_s"]]
    keys = {k: v for k, v in config.to_dict()["run"].items() if v is not None} | {"outages": windows}
    result = run(config.replace(run=keys), dataset)
    found = outage_table(result)
    assert len(found.outages) == len(windows)
    assert found.horizontal_m <= baseline["outage_pos_h_rmse"]
    for counts in result.counts.values():
        assert counts["in"] == sum(counts[k] for k in ("used", "rejected", "late", "bad"))
    assert np.isfinite(result.lla).all()
    assert np.isfinite(result.sd).all()


def test_attitude_is_no_worse_than_the_baseline_where_the_reference_is_independent(recorded):
    name, baseline, config, dataset = recorded
    if name not in INDEPENDENT_ATTITUDE:
        pytest.skip("no attitude reference from other sensors in this set")
    error = np.degrees(compare(run(config, dataset), dataset.truth).rmse().euler)
    limit = np.array([baseline[f"full_vs_ref_rmse_{a}"] for a in ("roll", "pitch", "head")])
    assert (error <= limit + INDEPENDENT_ATTITUDE[name]).all()
