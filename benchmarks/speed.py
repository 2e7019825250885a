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
import contextlib
import csv
import gc
import io
import math
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import jax
import numpy as np
import torch

from benchmarks.peers import PRESETS, RENDERED, Call, ConvLOI, Row, all_rows, images
from loi_core import LOIObjective
from loi_core.files import write_text

ROOT: Final = Path(__file__).parents[1]
SIZES: Final = ("128", "256x192", "256", "512", "1024", "2048")
QUICK_SIZES: Final = ("128", "256x192")
COMPARED: Final = ((192, 256), (512, 512), (1024, 1024))  # where the project has set itself bars
FEWEST, MOST = 3, 11  # evaluations of a row
SETTLE: Final = 0.2  # seconds in which idle threads of the library before stop spinning; they take this one's cores
KEPT: Final = 2**20  # pixels up to which all rows of a size stay in memory together
AGREEMENT: Final = 1e-3  # of the plain convolutions, whose kernels end early, with the exact loss
MIB: Final = 2.0**20

Size = tuple[int, int]


@dataclass
class Result:
    """What was found out about a row at one size."""

    size: Size
    row: Row
    milliseconds: float | None = None
    evaluations: int = 0
    peak: float | None = None  # bytes
    note: str = ""

    @property
    def stack(self) -> float | None:
        """Bytes of one inner scale's stack of levels, float32; None for what has no levels."""
        if not self.row.preset:
            return None
        scales = PRESETS[self.row.preset]
        return 4.0 * 3.0 * self.pixels * sum(map(scales.level_count, scales.beta))

    @property
    def pixels(self) -> int:
        """Pixels of the image."""
        return self.size[0] * self.size[1]


class Results(list[Result]):
    """All results of a run."""

    def milliseconds(self, size: Size, library: str, what: str, preset: str = "", device: str = "cpu") -> float | None:
        """The time of one row, if it is there."""
        found = self.find(size, library, what, preset, device)
        return found.milliseconds if found else None

    def find(self, size: Size, library: str, what: str, preset: str = "", device: str = "cpu") -> Result | None:
        """One row, if it is there."""
        names = (library, what, preset, device)
        return next((result for result in self if result.size == size and result.row.names == names), None)

    def peer(self, size: Size, device: str) -> float | None:
        """The time of pytorch-msssim."""
        return self.milliseconds(size, "pytorch-msssim", "MS-SSIM", "", device)

    def kinds(self) -> Iterator[tuple[Row, list[Result]]]:
        """Every kind of row with its results that have a time, smallest image first."""
        for row in {result.row.names: result.row for result in self}.values():
            timed = [result for result in self if result.row.names == row.names and result.milliseconds is not None]
            yield row, sorted(timed, key=lambda result: result.pixels)


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
        if self.estimate < SETTLE:
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
            result.peak, result.note = _measured_memory(result, options.limit)
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


def _measured_memory(result: Result, limit: float) -> tuple[float | None, str]:
    """Peak memory in bytes from a process of its own, or why there is none."""
    height, width = result.size
    command = [sys.executable, "-m", "benchmarks.speed", "--sizes", f"{width}x{height}", "--memory-of", result.row.key]
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120.0 + 10.0 * limit)
    except subprocess.TimeoutExpired:
        return None, f"failed: two evaluations take more than {120.0 + 10.0 * limit:g} s"
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        return None, f"failed with {done.returncode}: {said[-1] if said else 'killed, for memory most likely'}"
    return float(done.stdout.split()[-1]), ""


def memory_of(row: Row, size: Size) -> float:
    """By how many bytes the peak grows over the inputs; for a process that does nothing else."""
    tiny = row.start(row, *images(row.smallest, row.smallest))()
    tiny()
    del tiny
    prepare = row.start(row, *images(*size))
    gc.collect()
    before = _peak(row, start=True)
    call = prepare()
    for _ in range(2):
        call()
    return max(_peak(row, start=False) - before, 0.0)


def _peak(row: Row, *, start: bool) -> float:
    """Largest memory so far, in bytes; from here on, if `start` and if the system can forget the past."""
    if row.device == "cuda" and row.library == "jax":
        return float(jax.devices("gpu")[0].memory_stats()["peak_bytes_in_use"])
    if row.device == "cuda":
        if start:
            torch.cuda.reset_peak_memory_stats()
        return float(torch.cuda.max_memory_allocated())
    status, forget = Path("/proc/self/status"), Path("/proc/self/clear_refs")
    if not status.exists():
        largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return float(largest) if sys.platform == "darwin" else 1024.0 * largest
    # Linux: ru_maxrss would begin at the size of the process that started this one, and cannot be set back.
    if start:
        with contextlib.suppress(OSError):  # some containers do not let a process do this
            forget.write_text("5")
    (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return 1024.0 * float(line.split()[1])


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


def fields(result: Result, results: Results) -> dict[str, str]:
    """One line of the table and the CSV."""

    def number(value: float | None, form: str) -> str:
        return "" if value is None else format(value, form)

    row, peak, stack = result.row, result.peak, result.stack
    return {
        "size": _name(result.size),
        "device": row.device,
        "preset": row.preset,
        "library": row.library,
        "what": row.what,
        "ms": number(result.milliseconds, ".2f"),
        "to pytorch-msssim": number(_over(result.milliseconds, results.peer(result.size, row.device)), ".3g"),
        "peak MiB": number(_over(peak, MIB), ".1f"),
        "stack MiB": number(_over(stack, MIB), ".1f"),
        "peak / stack": number(_over(peak, stack), ".2f"),
        "evaluations": str(result.evaluations),
        "note": result.note,
    }


def bars(results: Results) -> list[dict[str, str]]:
    """The project's bars and what was measured for them, on torch and paper("path") unless they say otherwise."""
    lines = []

    def line(name: str, size: Size | None, value: float | None, bound: float, *, at_least: bool = False) -> None:
        kept = value is not None and (value >= bound if at_least else value <= bound)
        lines.append(
            {
                "bar": name,
                "size": _name(size) if size else "",
                "measured": "not measured" if value is None else f"{value:.3g}",
                "asked for": f"{bound:g} or {'more' if at_least else 'less'}",
                "kept": "" if value is None else "yes" if kept else "no",
            }
        )

    def ours(size: Size, what: str = "balanced", library: str = "torch") -> float | None:
        return results.milliseconds(size, library, what, "path")

    for size in COMPARED:
        line("balanced / pytorch-msssim", size, _over(ours(size), results.peer(size, "cpu")), 1.0)
    for size in COMPARED:
        line("exact / pytorch-msssim", size, _over(ours(size, "exact"), results.peer(size, "cpu")), 4.0)
    line("plain conv2d / balanced", RENDERED, _over(ours(RENDERED, "plain conv2d"), ours(RENDERED)), 150, at_least=True)
    growth = _over(ours((1024, 1024)), ours((256, 256)))
    line("balanced, time(1024x1024) / time(256x256)", None, growth, 18.0)
    for size in COMPARED:
        line("balanced, NumPy / torch", size, _over(ours(size, library="numpy"), ours(size)), 3.0)
    for size in COMPARED:
        line("balanced, JAX under jit / torch", size, _over(ours(size, library="jax"), ours(size)), 2.0)
    for size in COMPARED:
        found = results.find(size, "torch", "balanced", "path")
        peak = _over(found.peak, found.stack) if found else None
        line("balanced, peak memory / stack of levels", size, peak, 4.0)
    renders = [each.milliseconds for each in results if each.row.library == "mitsuba"]
    render = renders[0] if renders else None
    line("balanced / one render and backward of Mitsuba", RENDERED, _over(ours(RENDERED), render), 0.5)
    return lines


def growths(results: Results) -> list[dict[str, str]]:
    """How time grows with pixels: the exponent of each kind of row, by least squares of logarithms."""
    lines = []
    for row, timed in results.kinds():
        pixels = [math.log(result.pixels) for result in timed]
        if len(set(pixels)) < 2:
            continue
        exponent = np.polyfit(pixels, [math.log(result.milliseconds or math.nan) for result in timed], 1)[0]
        lines.append(
            {
                "device": row.device,
                "preset": row.preset,
                "library": row.library,
                "what": row.what,
                "sizes": ", ".join(_name(result.size) for result in timed),
                "exponent": f"{exponent:.2f}",
            }
        )
    return lines


def traffic(results: Results, bandwidth: float) -> list[dict[str, str]]:
    """The least time that memory allows, one pass over image, reference and gradient, beside balanced on torch."""
    lines = []
    for preset in PRESETS:
        for size in dict.fromkeys(result.size for result in results):
            measured = results.milliseconds(size, "torch", "balanced", preset)
            if measured is None:
                continue
            moved = 3 * 3 * 4 * size[0] * size[1]
            least = 1e3 * moved / bandwidth
            lines.append(
                {
                    "preset": preset,
                    "size": _name(size),
                    "MiB": f"{moved / MIB:.1f}",
                    "least ms": f"{least:.3f}",
                    "measured ms": f"{measured:.2f}",
                    "ratio": f"{measured / least:.0f}",
                }
            )
    return lines


def _over(value: float | None, other: float | None) -> float | None:
    return None if value is None or not other else value / other


def _name(size: Size) -> str:
    return f"{size[1]}x{size[0]}"


def _print_table(lines: Sequence[dict[str, str]]) -> None:
    for index, line in enumerate(lines):
        if index == 0:
            print("| " + " | ".join(line) + " |\n" + "| --- " * len(line) + "|")
        print("| " + " | ".join(line.values()) + " |")
    print(flush=True)


def _write_csv(path: Path, results: Results) -> None:
    text = io.StringIO()
    lines = [fields(result, results) for result in results]
    writer = csv.DictWriter(text, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    write_text(path, text.getvalue())


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
    parser.add_argument("--limit", type=float, default=20.0, help="seconds that one evaluation may take; 20 by default")
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
        _print_table([fields(result, results) for result in results if result.size == size])
        if options.csv:
            _write_csv(options.csv, results)
    for title, lines in {
        'Bars (torch, paper("path"))': bars(results),
        "Time grows as this power of the pixels": growths(results),
        "Balanced on torch beside the traffic of memory": traffic(results, bandwidth),
    }.items():
        print(f"{title}\n")
        _print_table(lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
