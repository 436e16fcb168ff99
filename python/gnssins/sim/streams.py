"""Random numbers: one seed, one independent stream per source of error."""

from __future__ import annotations

import hashlib

import numpy as np

__all__ = ["Streams", "run_seed"]


class Streams:
    """Independent generators, told apart by name.

    The name is hashed into the spawn key of :class:`numpy.random.SeedSequence`. So a stream depends on the
    seed and on its own name only: another source of error, added or taken away, leaves the numbers of all
    others as they are.

    Parameters
    ----------
    seed : int
        Not negative.

    Examples
    --------
    >>> float(Streams(1)("imu.gyro").standard_normal()) == float(Streams(1)("imu.gyro").standard_normal())
    True
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def __call__(self, name: str) -> np.random.Generator:
        """Fresh generator of the stream ``name``, always from its beginning."""
        digest = hashlib.sha256(name.encode("utf-8")).digest()
        key = tuple(int.from_bytes(digest[i : i + 4], "little") for i in (0, 4, 8, 12))
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(self.seed, spawn_key=key)))


def run_seed(seed: int, index: int) -> int:
    """Seed of run ``index`` of a set: hashed, so that neighbouring sets and runs share nothing."""
    return int(np.random.SeedSequence(seed, spawn_key=(index,)).generate_state(1, np.uint64)[0] >> 1)
