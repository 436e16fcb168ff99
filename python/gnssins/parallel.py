"""Many like calls on a pool of threads, their results in order; the engine releases the GIL."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

__all__ = ["ordered", "submitted"]

T = TypeVar("T")


def ordered(
    work: Callable[[int], T], count: int, jobs: int, progress: Callable[[float], None] | None = None
) -> Iterator[T]:
    """Call ``work(0)`` .. ``work(count - 1)`` on ``jobs`` threads of its own.

    Parameters
    ----------
    work : callable
        Of the index; several threads call it at once.
    count, jobs : int
        Number of calls and of threads.
    progress : callable, optional
        Called in the calling thread with the share that is done.

    Yields
    ------
    object
        Results in the order of the index, the same for any number of threads. The first error is raised as it is;
        what waits is then cancelled, also on an interrupt.
    """
    with ThreadPoolExecutor(max(1, jobs)) as pool:
        yield from submitted(pool, work, count, 2 * max(1, jobs), progress)


def submitted(
    pool: Executor,
    work: Callable[[int], T],
    count: int,
    ahead: int,
    progress: Callable[[float], None] | None = None,
) -> Iterator[T]:
    """Results of an executor in the order of the index, at most ``ahead`` of them started and not yet taken."""
    indices = iter(range(count))
    waiting = [pool.submit(work, k) for k in islice(indices, ahead)]
    try:
        for done in range(1, count + 1):
            result = waiting.pop(0).result()
            waiting += [pool.submit(work, k) for k in islice(indices, 1)]
            if progress is not None:
                progress(done / count)
            yield result
    finally:
        for future in waiting:
            future.cancel()
