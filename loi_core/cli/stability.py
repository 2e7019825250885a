"""``loi doctor --stability``: the catalogue of hard cases on every installed backend, in a short summary."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Final

from loi_core.cli.progress import ProgressBar
from loi_core.errors import BackendNotFoundError
from loi_core.plugins.measurement_backends import MeasurementBackend
from loi_core.plugins.registry import BACKENDS
from loi_core.stability import StabilityRow, hard_cases, stability_rows
from loi_core.support.markdown import columns
from loi_core.support.values import finite_or_none

__all__ = ["examine_stability", "summary_lines"]

VERDICTS: Final = ("ok", "loose", "refused", "unsupported", "FAILED")
HEADS: Final = ("backend and dtype", *VERDICTS, "loss error / bound", "gradient error / bound")


def examine_stability(*, as_json: bool) -> bool:
    """Run all cases and print the results; return False if a rule was broken, or a backend could not be tried."""
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
        plain = [
            {name: finite_or_none(value) if isinstance(value, float) else value for name, value in asdict(row).items()}
            for row in rows
        ]
        print(json.dumps({"rows": plain, "missing": missing, "broken": broken}, indent=2, allow_nan=False))
    else:
        print("\n".join(summary_lines(rows)))
        for name, problem in {**missing, **broken}.items():
            print(f"not tried: {name}: {problem}")
    return not interrupted and not broken and not any(row.verdict == "FAILED" for row in rows)


def summary_lines(rows: Sequence[StabilityRow]) -> list[str]:
    """Return a table with one line for each backend and dtype, and the details of failed rows.

    Integer, complex and other arrays that must be refused are counted in one line for each backend.
    """
    groups: dict[str, list[StabilityRow]] = {}
    for row in rows:
        dtype = row.dtype if "float" in row.dtype else "other arrays"
        groups.setdefault(f"{row.backend} {dtype}", []).append(row)
    table = columns([HEADS, *([name, *_cells(group)] for name, group in groups.items())])
    failures = [f"{row.case}, {row.backend} {row.dtype}: {row.detail}" for row in rows if row.verdict == "FAILED"]
    return [*table, *failures, "", f"{len(rows)} rows; `--json` prints all of them"]


def _cells(rows: Sequence[StabilityRow]) -> list[str]:
    """Return the number of rows of each verdict, and the largest errors in units of their bounds."""
    counts = Counter(row.verdict for row in rows)
    losses = [row.loss_error / row.loss_bound for row in rows if row.loss_bound > 0.0]
    gradients = [row.gradient_error / row.gradient_bound for row in rows if row.gradient_bound > 0.0]
    ratios = (f"{max(errors):.2g}" if errors else "-" for errors in (losses, gradients))
    return [*(str(counts[verdict]) for verdict in VERDICTS), *ratios]


def _backends() -> tuple[dict[str, MeasurementBackend], dict[str, str], dict[str, str]]:
    """Return the backends that work by name, and the problems of missing and of broken ones."""
    backends: dict[str, MeasurementBackend] = {}
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
