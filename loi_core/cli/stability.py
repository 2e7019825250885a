"""``loi doctor --stability``: the catalogue of hard cases on every installed backend."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import asdict

from loi_core.cli.progress import ProgressBar
from loi_core.errors import BackendNotFoundError
from loi_core.plugins.backends import Backend
from loi_core.plugins.registry import BACKENDS
from loi_core.stability import StabilityRow, hard_cases, stability_rows
from loi_core.support.markdown import markdown

__all__ = ["examine_stability", "stability_lines"]

HEADS = ("case", "backend", "dtype", "loss: error", "bound", "gradient: error", "bound", "verdict")


def examine_stability(*, as_json: bool) -> bool:
    """Run all cases and print the table; return False if a rule was broken, or a backend could not be tried."""
    backends, missing, broken = _backends()
    rows: list[StabilityRow] = []
    interrupted = False
    with ProgressBar() as bar:
        try:
            for row in stability_rows(hard_cases(), backends, bar.begin):
                rows.append(row)  # noqa: PERF402 - rows are kept when Ctrl-C ends the loop
        except KeyboardInterrupt:
            interrupted = True
    if as_json:
        plain = [{name: _plain(value) for name, value in asdict(row).items()} for row in rows]
        print(json.dumps({"rows": plain, "missing": missing, "broken": broken}, indent=2, allow_nan=False))
    else:
        print("\n".join(stability_lines(rows)))
        for name, problem in {**missing, **broken}.items():
            print(f"not tried: {name}: {problem}")
    return not interrupted and not broken and not any(row.verdict == "FAILED" for row in rows)


def stability_lines(rows: list[StabilityRow]) -> list[str]:
    """Return the table as Markdown, the number of rows of each verdict, and the details of failed rows."""
    counts = Counter(row.verdict for row in rows)
    lines = [*markdown(HEADS, map(_cells, rows)), "", ", ".join(f"{n} {verdict}" for verdict, n in counts.items())]
    return lines + [f"{row.case}, {row.backend} {row.dtype}: {row.detail}" for row in rows if row.verdict == "FAILED"]


def _backends() -> tuple[dict[str, Backend], dict[str, str], dict[str, str]]:
    """Return the backends that work by name, and the problems of missing and of broken ones."""
    backends: dict[str, Backend] = {}
    missing: dict[str, str] = {}
    broken: dict[str, str] = {}
    for info in BACKENDS.available():
        try:
            backends[info.name] = BACKENDS.load(info.name)()
        except BackendNotFoundError:
            (missing if info.state == "missing" else broken)[info.name] = f"{info.problem}; {info.fix}"
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a plugin may raise anything; the others must still run
            broken[info.name] = " ".join(f"{type(error).__name__}: {error}".split())
    return backends, missing, broken


def _cells(row: StabilityRow) -> list[str]:
    numbers = (row.loss_error, row.loss_bound, row.gradient_error, row.gradient_bound)
    shown = ("" if math.isnan(number) else f"{number:.1e}" for number in numbers)
    return [row.case, row.backend, row.dtype, *shown, row.verdict]


def _plain(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value
