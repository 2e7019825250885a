"""Compare the loss with other image losses: time of value and gradient, memory, growth with size.

Run from the root of the repository: ``python -m benchmarks.speed``. Prints Markdown tables; ``--csv`` writes the rows.

- Every row is prepared and warmed up. Then all rows of a size take turns, so that drift affects them equally; slow rows
  skip some turns. A row is left out, with a note, if its time at the previous size predicts more than ``--limit``
  seconds.
- Peak memory is measured in a fresh process. It loads the library by evaluating a tiny image, creates the inputs, and
  reports the growth of the resident memory over preparation and two evaluations: the reference's histograms and
  compilation count, the inputs do not. On a GPU it is the memory that the framework has allocated there.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import torch

from benchmarks.convolutions import ConvLOI
from benchmarks.memory import memory_of
from benchmarks.peers import PRESETS, all_rows, images
from benchmarks.results import Results, Size
from benchmarks.tables import bars, fields, growths, print_table, traffic, write_csv
from benchmarks.timing import measure
from loi_core import LOIObjective

SIZES: Final = ("128", "256x192", "256", "512", "1024", "2048")
QUICK_SIZES: Final = ("128", "256x192")
MAX_RELATIVE_DIFFERENCE: Final = 1e-3  # plain convolutions truncate their kernels


def check_plain_convolutions() -> None:
    """Exit unless the plain convolutions compute the same loss."""
    image, reference = images(40, 48)
    for name, scales in PRESETS.items():
        exact, _ = LOIObjective(reference, scales).value_and_grad(image)
        plain = float(ConvLOI(torch.tensor(reference), scales)(torch.tensor(image)))
        difference = abs(plain / float(exact) - 1.0)
        print(f"- plain conv2d and the exact loss, {name}, 48x40: relative difference {difference:.1e}")
        if not difference <= MAX_RELATIVE_DIFFERENCE:
            msg = f"the plain convolutions are another loss: {plain} for {float(exact)}"
            raise SystemExit(msg)


def copy_bandwidth() -> float:
    """Return the bytes per second that a copy of 128 MiB reads and writes, a median."""
    source = torch.ones(2**25)  # zeros might share one page of memory
    target = torch.empty_like(source)
    seconds = []
    for _ in range(12):
        started = time.perf_counter()
        target.copy_(source)
        seconds.append(time.perf_counter() - started)
    return 2.0 * 4.0 * source.numel() / statistics.median(seconds[2:])


def _size(text: str) -> Size:
    """Height and width of "512" or "256x192", which is width by height."""
    width, _, height = text.partition("x")
    return int(height or width), int(width)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--sizes", nargs="+", type=_size, help=f"side, or width x height; {' '.join(SIZES)} by default")
    parser.add_argument("--quick", action="store_true", help=f"{' '.join(QUICK_SIZES)}, little time, no memory")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="also write the rows to this file, after every size")
    parser.add_argument("--seconds", type=float, help="of measuring for each row; 2 by default, 0.2 with --quick")
    parser.add_argument("--limit", type=float, default=5.0, help="seconds that one evaluation may take; 5 by default")
    parser.add_argument("--rows", nargs="+", default=[""], metavar="WORD", help="only rows whose names contain a WORD")
    parser.add_argument("--memory-of", metavar="ROW", help=argparse.SUPPRESS)  # how this script calls itself
    options = parser.parse_args(arguments)
    if options.sizes is None:
        options.sizes = [_size(text) for text in (QUICK_SIZES if options.quick else SIZES)]
    if options.seconds is None:
        options.seconds = 0.2 if options.quick else 2.0
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables."""
    options = _options(arguments)
    if options.memory_of:
        (row,) = (row for row in all_rows() if row.key == options.memory_of)
        print(memory_of(row, options.sizes[0]))
        return 0
    print("float32, RGB, loss and gradient; medians\n")
    check_plain_convolutions()
    bandwidth = copy_bandwidth()
    print(f"- a copy moves {bandwidth / 1e9:.1f} GB a second, read and written")
    print(f"- {torch.get_num_threads()} threads\n")
    results = Results()
    for size in sorted(set(options.sizes), key=math.prod):
        results += measure(size, options, results)
        print_table([fields(result, results) for result in results if result.size == size])
        if options.csv:
            write_csv(options.csv, results)
    for title, lines in {
        'Bars (torch, paper("path"))': bars(results),
        "Time grows as this power of the pixels": growths(results),
        "Balanced on torch beside the traffic of memory": traffic(results, bandwidth),
    }.items():
        print(f"{title}\n")
        print_table(lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
