"""Error-state blocks of a configuration: what each state adds to F, Q and H."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIZES = {"gyro_misalignment": 6, "accel_misalignment": 6, "baro_bias": 1}
CROSS = [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)]


@dataclass
class Block:
    """Slice of the state and the process of one block (per-state arrays of its size)."""

    kind: str
    process: str
    at: slice
    initial: Array
    initial_sd: Array
    psd: Array
    sd: Array
    tau: Array
    distance: float
    jump_sd: Array
    floor_sd: Array

    def decay(self, dt: float, speed: float) -> Array:
        """Transition of the block's states over dt (s) at a ground speed (m/s)."""
        return np.exp(-dt * (1.0 / self.tau + speed / self.distance))

    def variance_step(self, dt: float, speed: float) -> Array:
        """Process noise variance over dt (s), for the trapezoid form of the prediction.

        Gauss-Markov: 2 sd^2 (1 - d^2) / (1 + d^2) makes sd^2 a fixed point of P = d^2 (P + Q/2) + Q/2.
        """
        if self.process == "gauss_markov":
            d2 = self.decay(dt, speed) ** 2
            return 2.0 * self.sd**2 * (1.0 - d2) / (1.0 + d2)
        return self.psd * dt


def blocks_of(config: dict[str, Any]) -> list[Block]:
    """Ordered blocks of an engine configuration, after the nine navigation errors."""
    out, start = [], 9
    for item in config["blocks"]:
        k = SIZES.get(item["kind"], 3)

        def per_state(key: str, default: float, item: dict[str, Any] = item, k: int = k) -> Array:
            return np.array(item.get(key) or [default] * k, dtype=float)

        out.append(
            Block(
                item["kind"],
                item["process"],
                slice(start, start + k),
                per_state("initial", 0.0),
                per_state("initial_sd", 0.0),
                per_state("psd", 0.0),
                per_state("sd", 0.0),
                per_state("tau_s", np.inf),
                item.get("distance_m", np.inf),
                per_state("jump_sd", 0.0),
                per_state("floor_sd", 0.0),
            )
        )
        start += k
    return out


def sensor_jacobian(kind: str, true_value: Array) -> Array:
    """d(sensor error) / d(block states), (3, k), at the true rate or specific force (3,)."""
    if kind.endswith("_bias"):
        return np.eye(3)
    if kind.endswith("_scale"):
        return np.diag(true_value)
    out = np.zeros((3, 6))
    for column, (i, j) in enumerate(CROSS):
        out[i, column] = true_value[j]
    return out


def sensor_model(blocks: list[Block], x: Array, sensor: str) -> tuple[Array, Array]:
    """Bias (3,) and M (3, 3) of ``measured = (I + M) true + bias`` from the estimates x (9 + m,)."""
    bias, matrix = np.zeros(3), np.zeros((3, 3))
    for b in blocks:
        if b.kind == f"{sensor}_bias":
            bias += x[b.at]
        elif b.kind == f"{sensor}_scale":
            matrix += np.diag(x[b.at])
        elif b.kind == f"{sensor}_misalignment":
            for value, (i, j) in zip(x[b.at], CROSS, strict=True):
                matrix[i, j] += value
    return bias, matrix


def total(blocks: list[Block], x: Array, kind: str) -> Array:
    """Sum (3,) of the estimates of all blocks of a kind."""
    return sum((x[b.at] for b in blocks if b.kind == kind), np.zeros(3))
