"""What a reproduction is asked for, and how a publication's module offers itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from gnssins.parallel import ordered

if TYPE_CHECKING:
    from gnssins.reproduce.report import Reproduction

__all__ = ["Job", "Publication"]

T = TypeVar("T")


class Job:
    """What a reproduction is asked for, and the threads to do it with.

    Parameters
    ----------
    runs : int
        Monte Carlo runs.
    seed : int
        Of the set; run k takes ``run_seed(seed, k)`` (:func:`gnssins.analysis.run_seed`).
    jobs : int
        Threads. The engine releases the GIL.
    progress : callable, optional
        Called with the share of the whole that is done.
    """

    def __init__(
        self, runs: int, seed: int, jobs: int = 1, progress: Callable[[float], None] | None = None
    ) -> None:
        self.runs = runs
        self.seed = seed
        self.jobs = jobs
        self.progress = progress
        self.label = ""
        self._total = 0
        self._done = 0.0

    def expect(self, units: int) -> None:
        """Announce the number of work units of all calls of :meth:`map` and :meth:`part` together."""
        self._total = units
        self._done = 0.0

    def part(self, units: int, label: str = "") -> Callable[[float], None]:
        """Make the progress callback of a stage that is worth so many work units."""
        self.label = label
        begun = self._done

        def told(share: float) -> None:
            self._done = begun + share * units
            if self.progress is not None:
                self.progress(min(self._done / max(self._total, units), 1.0))

        return told

    def map(
        self, function: Callable[[int], T], count: int, label: str = "", *, units: int | None = None
    ) -> list[T]:
        """Call ``function(0)`` .. ``function(count - 1)`` on the threads.

        Parameters
        ----------
        function : callable
            Of the index; may be called from several threads at once.
        count : int
            Number of calls.
        label : str
            Name of the stage.
        units : int, optional
            Work units of all calls together; left out: one per call.

        Returns
        -------
        list
            Results in the order of the index, the same for any number of threads.
        """
        if not self._total:
            self._done = 0.0
        return list(ordered(function, count, self.jobs, self.part(count if units is None else units, label)))


@dataclass(frozen=True)
class Publication:
    """A published experiment that can be repeated.

    Parameters
    ----------
    name : str
        As on the command line.
    title : str
        Authors, year and subject.
    summary : str
        One line for the list.
    runs, seed : int
        Used when nothing else is asked for.
    run : callable
        Does it: takes the :class:`Job`, gives the :class:`Reproduction`.
    """

    name: str
    title: str
    summary: str
    runs: int
    seed: int
    run: Callable[[Job], Reproduction]
