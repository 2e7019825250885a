"""``loi sweep``."""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import Final

from loi_core.cli.codes import DONE, FAILED
from loi_core.cli.progress import ProgressBar
from loi_core.support.values import finite_or_none
from loi_core.support.wording import printable
from loi_core.sweeps import SweepResult, sweep

__all__ = ["run"]

MAX_SETTINGS: Final = 10  # that are printed


def run(options: argparse.Namespace) -> int:
    """Carry out the remaining runs of a sweep and print the best settings; FAILED if a run has failed."""
    failed = 0

    def progress(ended: int, total: int, cause: str) -> None:
        nonlocal failed
        failed += bool(cause)
        bar.show(ended, total, f"{failed} failed" if failed else "")

    with ProgressBar() as bar:
        result = sweep(
            options.sweep,
            output=options.output,
            processes=options.processes,
            dask=options.dask,
            retry_failed=options.retry_failed,
            progress=progress,
        )
    if options.json:
        rows = [
            {name: finite_or_none(value) if isinstance(value, float) else value for name, value in row.items()}
            for row in result.rows
        ]
        print(json.dumps({"rows": rows, "table": str(result.table), "leaderboard": str(result.page)}, indent=2))
    else:
        _print(result)
    return FAILED if result.count("failed") else DONE


def _print(result: SweepResult) -> None:
    for rank, standing in enumerate(result.standings[:MAX_SETTINGS], 1):
        mean = "-" if math.isnan(standing.mean) else f"{standing.mean:.4g}"
        print(f"{rank:>3}.  {mean:>8}  {standing.converged} of {len(standing.rows)} converged  {standing.name}")
    if len(result.standings) > MAX_SETTINGS:
        print(f"      and {len(result.standings) - MAX_SETTINGS} more settings")
    failed = [row for row in result.rows if row["status"] == "failed"]
    for row in failed:
        print(f"loi: {printable(row['run'])} failed: {printable(str(row['cause']))}", file=sys.stderr)
    hint = "; `--retry-failed` runs those again" if failed else ""
    print(f"\n{result.count('done')} runs done, {len(failed)} failed{hint}")
    print(f"leaderboard: {result.page}\ntable: {result.table}")
