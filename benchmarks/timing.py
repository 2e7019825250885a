"""Timing of rows in turns, so that drift of the machine affects them equally."""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Final

from benchmarks.memory import measured_memory
from benchmarks.peers import Call, all_rows, images
from benchmarks.results import Result, Results, Size

__all__ = ["measure"]

MIN_EVALUATIONS, MAX_EVALUATIONS = 3, 11
# Idle threads of the previous library spin for a while and occupy cores; then threads and clocks have to ramp up.
SETTLE_SECONDS: Final = 0.2
MAX_SHARED_PIXELS: Final = 2**20  # all rows of smaller images stay in memory together


class Runner:
    """A row at one size, ready for timing."""

    def __init__(self, result: Result) -> None:
        self.result = result
        self.call: Call | None = None
        self.seconds: list[float] = []
        self.evaluations = 1
        self.estimate = 0.0

    def prepare(self) -> Call:
        """Prepare and warm up; rows of large images are prepared each time, because they would fill the memory."""
        if self.call is not None:
            return self.call
        call = self.result.row.start(self.result.row, *images(*self.result.size))()
        call()
        if self.result.pixels <= MAX_SHARED_PIXELS:
            self.call = call
        return call

    def once(self) -> float:
        """Return the seconds of one evaluation; short ones run with awake threads and warm caches."""
        call = self.prepare()
        time.sleep(SETTLE_SECONDS)
        awake = time.perf_counter() + SETTLE_SECONDS
        while self.estimate < SETTLE_SECONDS and time.perf_counter() < awake:
            call()
        started = time.perf_counter()
        call()
        return time.perf_counter() - started

    def rehearse(self, budget: float) -> None:
        """Choose the number of evaluations by the time of the first."""
        self.estimate = self.once()
        self.evaluations = min(max(round(budget / self.estimate), MIN_EVALUATIONS), MAX_EVALUATIONS)

    def takes_turn(self, index: int, turns: int) -> bool:
        """Return whether the row is evaluated in a turn; its evaluations are spread evenly over the turns."""
        return self.evaluations * (index + 1) // turns > self.evaluations * index // turns

    def finish(self) -> None:
        """Store the median in the result."""
        self.result.milliseconds = 1e3 * statistics.median(self.seconds)
        self.result.evaluations = len(self.seconds)


def measure(size: Size, options: argparse.Namespace, earlier: Results) -> Results:
    """Measure all rows at one size."""
    rows = [row for row in all_rows() if any(word in row.key for word in options.rows)]
    results = Results(Result(size, row) for row in rows if row.size in (None, size))
    runners = []
    for result in results:
        result.note = _obstacle(result, earlier, options.limit)
        if result.note:
            continue
        if not options.quick:
            result.peak, result.note = measured_memory(result, options.limit)
            if result.note:
                continue
        runners.append(Runner(result))
        runners[-1].rehearse(options.seconds)
    turns = max((runner.evaluations for runner in runners), default=0)
    for index in range(turns):
        for runner in runners:
            if runner.takes_turn(index, turns):
                runner.seconds.append(runner.once())
    for runner in runners:
        runner.finish()
    return results


def _obstacle(result: Result, earlier: Results, limit: float) -> str:
    """Return the reason for not measuring a row, or an empty text."""
    row = result.row
    try:
        row.start(row, *images(row.smallest, row.smallest))  # raises if a library is missing
    except ImportError:
        return "not installed"
    if min(result.size) < row.smallest:
        return f"needs {row.smallest} pixels a side"
    same_row = [previous for previous in earlier if previous.row.names == row.names]
    smaller = [previous for previous in same_row if previous.pixels < result.pixels]
    if any(previous.note.startswith("failed") for previous in smaller):
        return "left out: failed at a smaller size"
    timed = [previous for previous in smaller if previous.milliseconds is not None]
    if timed:
        expected = 1e-3 * (timed[-1].milliseconds or 0.0) * result.pixels / timed[-1].pixels
        if expected > limit:
            return f"left out: {expected:.2g} s or more expected, limit {limit:g} s"
    return ""
