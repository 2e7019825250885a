"""What the loss costs beside other image losses: time of loss and gradient, memory, growth with size.

Run from the root of the repository: ``python -m benchmarks.speed``. Prints Markdown tables; ``--csv`` writes the rows.

- Every row is prepared and warmed up. Then all rows of a size take turns, so that drift hits them alike; slow rows sit
  out some of the turns. A row that, from its time at the size before, would take more than ``--limit`` seconds is left
  out, and says so.
- Peak memory is that of a process of its own. It loads the library by evaluating a tiny image, makes the inputs, and
  reports by how much the largest resident memory then grows over two evaluations and what comes before them: the
  reference's histograms count, and so does compiling; the inputs do not. On a GPU it is what the framework has
  allocated there.
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
AGREEMENT: Final = 1e-3  # of the plain convolutions, whose kernels end early, with the exact loss


def check_plain_convolutions() -> None:
    """Stop unless the plain convolutions are the same loss."""
    image, reference = images(40, 48)
    for name, scales in PRESETS.items():
        ours, _ = LOIObjective(reference, scales).value_and_grad(image)
        theirs = float(ConvLOI(torch.tensor(reference), scales)(torch.tensor(image)))
        apart = abs(theirs / float(ours) - 1.0)
        print(f"- plain conv2d and the exact loss, {name}, 48x40: {apart:.1e} apart")
        if not apart <= AGREEMENT:
            msg = f"the plain convolutions are another loss: {theirs} for {float(ours)}"
            raise SystemExit(msg)


def copy_bandwidth() -> float:
    """Bytes that a copy reads and writes in a second: the median of several of 128 MiB."""
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
