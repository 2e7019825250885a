"""Timing rows that take turns, so that drift of the machine hits them alike."""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Final

from benchmarks.memory import measured_memory
from benchmarks.peers import Call, all_rows, images
from benchmarks.results import Result, Results, Size

__all__ = ["measure"]

FEWEST, MOST = 3, 11  # evaluations of a row
# Seconds in which idle threads of the library before stop spinning, for they take this one's cores; and in which those
# of this one, and the cores themselves, come up to speed.
SETTLE: Final = 0.2
KEPT: Final = 2**20  # pixels up to which all rows of a size stay in memory together


class Runner:
    """One row at one size, ready to be timed."""

    def __init__(self, result: Result) -> None:
        self.result = result
        self.call: Call | None = None
        self.seconds: list[float] = []
        self.wanted = 1
        self.estimate = 0.0

    def prepare(self) -> Call:
        """Prepare and warm up; rows of large images are prepared again each time, or they would fill the memory."""
        if self.call is not None:
            return self.call
        call = self.result.row.start(self.result.row, *images(*self.result.size))()
        call()
        if self.result.pixels <= KEPT:
            self.call = call
        return call

    def once(self) -> float:
        """Seconds of one evaluation, alone on the machine and, if it is short, with threads awake and caches warm."""
        call = self.prepare()
        time.sleep(SETTLE)
        awake = time.perf_counter() + SETTLE
        while self.estimate < SETTLE and time.perf_counter() < awake:
            call()
        started = time.perf_counter()
        call()
        return time.perf_counter() - started

    def rehearse(self, budget: float) -> None:
        """The first evaluation that is timed decides how many follow."""
        self.estimate = self.once()
        self.wanted = min(max(round(budget / self.estimate), FEWEST), MOST)

    def takes_turn(self, turn: int, turns: int) -> bool:
        """Whether this is one of the wanted evaluations, which are spread evenly over the turns."""
        return self.wanted * (turn + 1) // turns > self.wanted * turn // turns

    def finish(self) -> None:
        """Put the median into the result."""
        self.result.milliseconds = 1e3 * statistics.median(self.seconds)
        self.result.evaluations = len(self.seconds)


def measure(size: Size, options: argparse.Namespace, known: Results) -> Results:
    """All rows at one size."""
    rows = [row for row in all_rows() if any(word in row.key for word in options.rows)]
    results = Results(Result(size, row) for row in rows if row.size in (None, size))
    runners = []
    for result in results:
        result.note = _obstacle(result, known, options.limit)
        if result.note:
            continue
        if not options.quick:
            result.peak, result.note = measured_memory(result, options.limit)
            if result.note:
                continue
        runners.append(Runner(result))
        runners[-1].rehearse(options.seconds)
    turns = max((runner.wanted for runner in runners), default=0)
    for turn in range(turns):
        for runner in runners:
            if runner.takes_turn(turn, turns):
                runner.seconds.append(runner.once())
    for runner in runners:
        runner.finish()
    return results


def _obstacle(result: Result, known: Results, limit: float) -> str:
    """Why a row is not measured, or nothing."""
    row = result.row
    try:
        row.start(row, *images(row.smallest, row.smallest))  # what is missing is missing at every size
    except ImportError:
        return "not installed"
    if min(result.size) < row.smallest:
        return f"needs {row.smallest} pixels a side"
    smaller = [each for each in known if each.row.names == row.names and each.pixels < result.pixels]
    if any(each.note.startswith("failed") for each in smaller):
        return "left out: failed at a smaller size"
    timed = [each for each in smaller if each.milliseconds is not None]
    if timed:
        expected = 1e-3 * (timed[-1].milliseconds or 0.0) * result.pixels / timed[-1].pixels
        if expected > limit:
            return f"left out: {expected:.2g} s or more expected, limit {limit:g} s"
    return ""
