"""What a run needs beside its input: the output asked for and 20 MB."""

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys
import numpy as np
import gnssins
from short_flight import config, simulated

def status(key):
    with open("/proc/self/status") as lines:
        return 1e3 * next(int(line.split()[1]) for line in lines if line.startswith(key))

ROWS, GYRO, ACCEL = 600_000, [0.0, 0.0, 1e-6], [0.0, 0.0, -0.0979]
t_ns = np.arange(1, ROWS + 1) * 10_000_000
imu = gnssins.ImuTable(t_ns, np.tile(GYRO, (ROWS, 1)), np.tile(ACCEL, (ROWS, 1)), "increments")
data = gnssins.Dataset(imu)
keys = {"output_rate_hz": float(sys.argv[1]), "covariance_interval_s": None}
gnssins.run(config(end_s=20.0), data, initial=simulated().initial)  # everything is loaded now
with open("/proc/self/clear_refs", "w") as reset:
    reset.write("5")
before = status("VmRSS")
result = gnssins.run(config(**keys), data, initial=simulated().initial)
peak = status("VmHWM") - before
output = sum(getattr(result, n).nbytes for n in ("t_ns", "lla", "v_n", "rpy", "q_nb", "sd", "x", "x_sd"))
print(len(result), peak, output)
"""


@pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists(), reason="needs the peak memory that Linux tells"
)
@pytest.mark.parametrize("rate", [1.0, 50.0])
def test_a_run_needs_its_output_and_20_mb_beside_the_input(rate):
    # GIVEN 34 MB of input  WHEN it is run  THEN no second copy of it is made
    arguments = [sys.executable, "-c", PROGRAM, str(rate)]
    done = subprocess.run(arguments, capture_output=True, text=True, cwd=Path(__file__).parent, check=True)
    epochs, peak, output = (float(word) for word in done.stdout.split())
    assert epochs == pytest.approx(6000 * rate, abs=2)
    assert output == pytest.approx(328 * epochs)
    assert peak < output + 20e6
