"""``loi sweep``."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import sys
from collections.abc import Iterator
from concurrent.futures import Executor
from typing import Final

from loi_core.cli.codes import DONE, FAILED
from loi_core.cli.progress import ProgressBar
from loi_core.errors import OptionError
from loi_core.runs import DaskExecutor
from loi_core.support.values import finite_or_none
from loi_core.support.wording import printable
from loi_core.sweeps import SweepResult, sweep

__all__ = ["run"]

MAX_SETTINGS: Final = 10  # that are printed


def run(options: argparse.Namespace) -> int:
    """Carry out the remaining runs of a sweep and print the best settings; FAILED if a run has failed."""
    if options.dask is not None and options.processes is not None:
        msg = "`--dask` and `--processes` exclude each other; a cluster knows how many workers it has"
        raise OptionError(msg)
    failed = 0

    def progress(ended: int, total: int, cause: str) -> None:
        nonlocal failed
        failed += bool(cause)
        bar.show(ended, total, f"{failed} failed" if failed else "")

    with ProgressBar() as bar, _executor(options.dask) as executor:
        result = sweep(
            options.sweep,
            output=options.output,
            executor=executor,
            processes=options.processes,
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


@contextlib.contextmanager
def _executor(dask: str | None) -> Iterator[Executor | None]:
    if dask is None:
        yield None
        return
    executor = DaskExecutor(dask)
    try:
        yield executor
    finally:
        executor.shutdown(cancel_futures=True)


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
