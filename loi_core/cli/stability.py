"""``loi doctor --stability``: the catalogue of hard cases on every backend that is installed."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Any

from tqdm import tqdm

from loi_core.errors import BackendNotFoundError
from loi_core.plugins.backends import Backend
from loi_core.plugins.registry import BACKENDS
from loi_core.stability import StabilityRow, hard_cases, stability_rows

__all__ = ["examine_stability", "stability_lines"]

TITLES = ("case", "backend", "dtype", "loss: error", "bound", "gradient: error", "bound", "verdict")


def examine_stability(*, as_json: bool) -> bool:
    """Run all cases and print the table; False if a rule was broken, or a backend could not be tried."""
    backends, missing, broken = _backends()
    cases = hard_cases()
    rows: list[StabilityRow] = []
    bar: tqdm[Any] | None = None

    def progress(total: int, what: str) -> None:
        nonlocal bar
        bar = bar or tqdm(total=total, disable=None)
        bar.set_postfix_str(what)
        bar.update()

    interrupted = False
    try:
        for row in stability_rows(cases, backends, progress):
            rows.append(row)  # noqa: PERF402 - what is done is kept when Ctrl-C ends it
    except KeyboardInterrupt:
        interrupted = True
    finally:
        if bar is not None:
            bar.close()
    if as_json:
        found = [{name: _finite(value) for name, value in asdict(row).items()} for row in rows]
        print(json.dumps({"rows": found, "missing": missing, "broken": broken}, indent=2, allow_nan=False))
    else:
        print("\n".join(stability_lines(rows)))
        for name, problem in {**missing, **broken}.items():
            print(f"not tried: {name}: {problem}")
    return not interrupted and not broken and not any(row.verdict == "FAILED" for row in rows)


def stability_lines(rows: list[StabilityRow]) -> list[str]:
    """The table as Markdown, then how many rows there are of each verdict, and what is behind those that failed."""
    cells = [TITLES, *(_cells(row) for row in rows)]
    widths = [max(len(line[column]) for line in cells) for column in range(len(TITLES))]
    lines = [
        "| " + " | ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)) + " |" for line in cells
    ]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    counts = {
        verdict: sum(row.verdict == verdict for row in rows) for verdict in dict.fromkeys(row.verdict for row in rows)
    }
    lines += ["", ", ".join(f"{count} {verdict}" for verdict, count in counts.items())]
    lines += [f"{row.case}, {row.backend} {row.dtype}: {row.detail}" for row in rows if row.verdict == "FAILED"]
    return lines


def _backends() -> tuple[dict[str, Backend], dict[str, str], dict[str, str]]:
    """Those that can be tried by name; for the others, what is missing, or broken."""
    backends: dict[str, Backend] = {}
    missing: dict[str, str] = {}
    broken: dict[str, str] = {}
    for info in BACKENDS.available():
        try:
            backends[info.name] = BACKENDS.load(info.name)()
        except BackendNotFoundError:
            (missing if info.state == "missing" else broken)[info.name] = f"{info.problem}; {info.fix}"
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a plugin may raise anything; the others must go on
            broken[info.name] = " ".join(f"{type(error).__name__}: {error}".split())
    return backends, missing, broken


def _cells(row: StabilityRow) -> tuple[str, ...]:
    numbers = (row.loss_error, row.loss_bound, row.gradient_error, row.gradient_bound)
    return (
        row.case,
        row.backend,
        row.dtype,
        *("" if math.isnan(one) else f"{one:.1e}" for one in numbers),
        row.verdict,
    )


def _finite(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value
