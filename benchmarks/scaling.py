"""What many fits cost beside the fits, and how many workers that leaves busy: measured, modelled, and simulated.

Run from the root of the repository: ``python -m benchmarks.scaling``. Prints Markdown tables; ``--json PATH`` writes
all numbers. In three parts:

- ``real``: sweeps of small fits on one and two workers, by processes and by Dask; what a run leaves on disk.
- ``store``: what the process of the sweep does for each run before and after it is carried out.
- ``crowd``: sweeps on Dask's own scheduler with pretend workers (:mod:`benchmarks.crowd`), beside what the model says
  from what was measured on the smallest number of them.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import resource
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from benchmarks.costs import Measured, Real, costs_of, crowd_table, expectation_table, real_table
from benchmarks.sweeps import STEPS, measure_joining, measure_real, measure_store, simulate
from benchmarks.tables import print_table
from loi_core.io.files import write_text
from loi_core.support.processors import usable_processors

__all__ = ["main"]

CROWDS: Final = ("1:0:500", "10:0:1000", "100:4:500", "1000:20:3000", "10000:120:10000")
"""Pretend workers, seconds that they take for a fit, and runs; the first two, at their limit, say what a run costs."""
SPARE: Final = 200  # open files of a scheduler beside those for workers
STORED: Final = 10_000  # runs in one folder


def _joining_line(workers: int) -> dict[str, str]:
    one = measure_joining(workers)
    return {"workers": str(workers), "the last, ms": f"{1e3 * one:.2f}", "all of them, s": f"{one * workers / 2:.2f}"}


def _open_files() -> int:
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scaling", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=("real", "store", "crowd"), default=["store", "crowd", "real"])
    parser.add_argument("--runs", type=int, default=10, help="for each worker, of real fits")
    parser.add_argument("--steps", type=int, default=STEPS, help="of each of them")
    parser.add_argument("--stored", type=int, default=STORED, help="runs in one folder")
    parser.add_argument("--crowds", nargs="+", default=CROWDS, metavar="WORKERS:SECONDS:RUNS")
    parser.add_argument("--json", type=Path, help="write all numbers there")
    options = parser.parse_args(arguments)
    store: dict[str, float] = {}
    real: list[Real] = []
    crowds: list[Measured] = []
    if "store" in options.parts:
        store = measure_store(options.stored)
        print(f"The process of a sweep of {options.stored} runs, beside having them carried out\n")
        print_table(
            [
                {"what": f"{name}, ms a run" if "bytes" not in name else name, "": f"{value:.3g}"}
                for name, value in store.items()
            ]
        )
    if "real" in options.parts:
        for how in ("processes", "Dask"):
            for workers in (1, 2):
                one, left = measure_real(how, workers, options.runs * workers, options.steps)
                real.append(one)
                store |= left
        print("Real sweeps of small fits\n")
        print_table(real_table(real))
        print_table([{"what": name, "": f"{store[name]:.3g}"} for name in left])
    if "crowd" in options.parts:
        for each in options.crowds:
            workers, seconds, runs = each.split(":")
            if _open_files() < 2 * int(workers) + SPARE:
                # The scheduler has a connection to each worker for tasks, and one for results; without, it waits.
                print(f"{each} left out: `ulimit -n` is {_open_files()}, less than two a worker", file=sys.stderr)
                continue
            crowds.append(simulate(int(workers), float(seconds), int(runs)))
            print(f"{each} done", file=sys.stderr, flush=True)
        costs = costs_of(store, real, crowds)
        print(f"Pretend workers, with all on one machine of {usable_processors()} processors\n")
        print_table(crowd_table(crowds, costs))
        print("The scheduler compares the versions of each worker that joins with those of all others\n")
        print_table([_joining_line(number) for number in (100, 1000, 10000)])
        print(
            "What the model expects of a cluster for ten fits of each worker, and the share of time that workers fit\n"
        )
        print_table(expectation_table(costs))
    if options.json:
        numbers = {
            "store": store,
            "real": [dataclasses.asdict(one) for one in real],
            "crowd": [dataclasses.asdict(one) for one in crowds],
            "costs": dataclasses.asdict(costs_of(store, real, crowds)),
        }
        write_text(options.json, json.dumps(numbers, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
