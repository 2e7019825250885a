"""The model of what a sweep costs beside its fits, from what was measured."""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Mapping, Sequence
from typing import Final

from benchmarks.crowd import SPREAD
from loi_core.support.processors import usable_processors

__all__ = ["Costs", "Measured", "Real", "costs_of", "crowd_table", "expectation_table", "real_table"]

KNOWN: Final = 2  # sweeps that say what a run costs: the first, at the limit of their workers
READINGS: Final = 2  # of each record, by a sweep that begins


@dataclasses.dataclass(frozen=True)
class Costs:
    """What a run costs beside its fit, in seconds.

    Attributes
    ----------
    before, after : float
        Of the process of the sweep: to read its files, name all runs and look for their records; to write the table and
        the page.
    client : float
        Of the process of the sweep while runs are carried out: to send a run, get what came of it, put it on record.
    scheduler : float
        Of Dask's scheduler.
    worker : float
        Of a worker, between two fits and to write what came of one.
    start : float
        Until a worker has begun its first fit; once, not for each run.
    """

    before: float
    after: float
    client: float
    scheduler: float
    worker: float = 0.0
    start: float = 0.0

    @property
    def each(self) -> float:
        """Seconds between the ends of two runs, at least, whatever the number of workers."""
        return max(self.client, self.scheduler)

    def carried_out(self, runs: int, workers: int, fit: float, *, shared: float = 0.0) -> float:
        """Seconds from the first run to the last: of those who are at work at the same time, what the slowest takes.

        Parameters
        ----------
        runs, workers : int
        fit : float
            Seconds of a fit, in the mean; they differ by half of that.
        shared : float
            Seconds for a run of a machine that all of them share; 0 if each has its own.
        """
        rounds = max(1.0, runs / workers)
        last = SPREAD * fit + self.client + self.scheduler  # the others have nothing left to do
        return self.start + max(rounds * (fit + self.worker), runs * max(self.each, shared)) + last

    def seconds(self, runs: int, workers: int, fit: float) -> float:
        """How long a sweep takes on a cluster."""
        return runs * (self.before + self.after) + self.carried_out(runs, workers, fit)

    def shortest(self, workers: int) -> float:
        """Seconds that a fit has to take to keep so many workers busy."""
        return max(0.0, workers * self.each - self.worker)


@dataclasses.dataclass(frozen=True)
class Measured:
    """A sweep on pretend workers.

    Attributes
    ----------
    workers, runs : int
    fit : float
        Seconds that a worker takes.
    join, join_scheduler : float
        Seconds until all workers had joined, and those of the scheduler's processor in it.
    seconds : float
        From the first run to the last.
    client, scheduler, crowd : float
        Seconds of the processor in that, for a run.
    memory : float
        MiB of the scheduler, at the end.
    leaving : float
        Seconds in which all workers are told that the sweep has ended.
    """

    workers: int
    runs: int
    fit: float
    join: float
    join_scheduler: float
    seconds: float
    client: float
    scheduler: float
    crowd: float
    memory: float
    leaving: float


@dataclasses.dataclass(frozen=True)
class Real:
    """Real sweeps of small fits, a short one and a long one.

    Attributes
    ----------
    how : str
        "processes" or "Dask".
    workers : int
    runs : int
        Of the long one.
    seconds : float
        From its first run to its last.
    fit : float
        The mean over its runs of what their own clocks say.
    worker : float
        Seconds of a worker for a further run, beside its fit.
    start : float
        Seconds until the workers had begun.
    """

    how: str
    workers: int
    runs: int
    seconds: float
    fit: float
    worker: float
    start: float


def costs_of(store: Mapping[str, float], real: Sequence[Real], crowds: Sequence[Measured]) -> Costs:
    """What the model goes by; 0 for what has not been measured."""
    few = crowds[:KNOWN]
    before = store.get("name the runs", 0.0) + READINGS * store.get("read a record", 0.0)
    after = sum(store.get(name, 0.0) for name in ("rows", "standings", "write the table", "write the page"))
    dask = [one for one in real if one.how == "Dask"]
    return Costs(
        before=1e-3 * before,
        after=1e-3 * after,
        client=statistics.mean(one.client for one in few) if few else 0.0,
        scheduler=statistics.mean(one.scheduler for one in few) if few else 0.0,
        worker=statistics.mean(one.worker for one in dask) if dask else 0.0,
        start=statistics.mean(one.start for one in dask) if dask else 0.0,
    )


def real_table(real: Sequence[Real]) -> list[dict[str, str]]:
    """Sweeps of small fits."""
    return [
        {
            "how": one.how,
            "workers": str(one.workers),
            "runs": str(one.runs),
            "seconds": f"{one.seconds:.1f}",
            "runs a second": f"{one.runs / one.seconds:.2f}",
            "s of a fit": f"{one.fit:.2f}",
            "beside it, s": f"{one.worker:.2f}",
            "to begin, s": f"{one.start:.1f}",
        }
        for one in real
    ]


def crowd_table(crowds: Sequence[Measured], costs: Costs) -> list[dict[str, str]]:
    """What the model says of pretend workers, and what was measured."""
    # They, the scheduler and the sweep share one machine; their fits leave nothing to write, and no process to start.
    here = dataclasses.replace(costs, worker=0.0, start=0.0)
    lines = []
    for one in crowds:
        shared = (here.client + here.scheduler + crowds[0].crowd) / usable_processors()
        predicted = here.carried_out(one.runs, one.workers, one.fit, shared=shared)
        lines.append(
            {
                "workers": str(one.workers),
                "s of a fit": f"{one.fit:g}",
                "runs": str(one.runs),
                "predicted s": f"{predicted:.1f}",
                "measured s": f"{one.seconds:.1f}",
                "ratio": f"{one.seconds / predicted:.2f}",
                "sweep, ms a run": f"{1e3 * one.client:.2f}",
                "scheduler, ms a run": f"{1e3 * one.scheduler:.2f}",
                "scheduler, MiB": f"{one.memory:.0f}",
                "to join, s": f"{one.join:.1f}",
                "scheduler in it, s": f"{one.join_scheduler:.1f}",
                "to part, s": f"{one.leaving:.1f}",
            }
        )
    return lines


def expectation_table(costs: Costs) -> list[dict[str, str]]:
    """What a cluster is expected to do with ten fits for each worker."""
    lines = []
    for workers in (1, 10, 100, 1000, 10000):
        line = {"workers": str(workers), "shortest fit that keeps them busy": f"{costs.shortest(workers):.2g} s"}
        for fit in (1.0, 10.0, 60.0, 600.0):
            seconds = costs.seconds(10 * workers, workers, fit)
            line[f"fits of {fit:g} s"] = f"{seconds:.0f} s ({10 * fit / seconds:.0%})"
        lines.append(line)
    return lines
