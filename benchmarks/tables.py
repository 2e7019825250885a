"""The tables of ``benchmarks.speed``: rows, bars, growth with size, and what memory allows."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.peers import PRESETS, RENDERED
from benchmarks.results import Result, Results, Size
from loi_core.io.files import write_text

__all__ = ["bars", "fields", "growths", "print_table", "traffic", "write_csv"]

COMPARED: Final = ((192, 256), (512, 512), (1024, 1024))  # sizes of the bars
MIB: Final = 2.0**20


def fields(result: Result, results: Results) -> dict[str, str]:
    """Return one line of the table and the CSV."""

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
    """Return the project's bars and their measurements, by default for torch and paper("path")."""
    lines = []

    def line(name: str, size: Size | None, value: float | None, bound: float, *, at_least: bool = False) -> None:
        is_met = value is not None and (value >= bound if at_least else value <= bound)
        lines.append(
            {
                "bar": name,
                "size": _name(size) if size else "",
                "measured": "not measured" if value is None else f"{value:.3g}",
                "limit": f"{bound:g} or {'more' if at_least else 'less'}",
                "met": "" if value is None else "yes" if is_met else "no",
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
        result = results.find(size, "torch", "balanced", "path")
        peak = _over(result.peak, result.stack) if result else None
        line("balanced, peak memory / stack of levels", size, peak, 4.0)
    renders = [result.milliseconds for result in results if result.row.library == "mitsuba"]
    render = renders[0] if renders else None
    line("balanced / one render and backward of Mitsuba", RENDERED, _over(ours(RENDERED), render), 0.5)
    return lines


def growths(results: Results) -> list[dict[str, str]]:
    """Return the exponent of time in pixels for each row, by least squares of logarithms."""
    lines = []
    for row, timed in results.rows():
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
    """Compare balanced on torch with one pass over image, reference and gradient at memory bandwidth."""
    lines = []
    for preset in PRESETS:
        for size in dict.fromkeys(result.size for result in results):
            measured = results.milliseconds(size, "torch", "balanced", preset)
            if measured is None:
                continue
            moved = 3 * 3 * 4 * size[0] * size[1]
            bound_ms = 1e3 * moved / bandwidth
            lines.append(
                {
                    "preset": preset,
                    "size": _name(size),
                    "MiB": f"{moved / MIB:.1f}",
                    "bound ms": f"{bound_ms:.3f}",
                    "measured ms": f"{measured:.2f}",
                    "ratio": f"{measured / bound_ms:.0f}",
                }
            )
    return lines


def _over(value: float | None, divisor: float | None) -> float | None:
    return None if value is None or not divisor else value / divisor


def _name(size: Size) -> str:
    return f"{size[1]}x{size[0]}"


def print_table(lines: Sequence[dict[str, str]]) -> None:
    """Print lines with equal keys as a Markdown table."""
    for index, line in enumerate(lines):
        if index == 0:
            print("| " + " | ".join(line) + " |\n" + "| --- " * len(line) + "|")
        print("| " + " | ".join(line.values()) + " |")
    print(flush=True)


def write_csv(path: Path, results: Results) -> None:
    """Write a line for each result, all or nothing."""
    text = io.StringIO()
    lines = [fields(result, results) for result in results]
    writer = csv.DictWriter(text, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    write_text(path, text.getvalue())
