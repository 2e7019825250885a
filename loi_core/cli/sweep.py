"""``loi sweep``."""

from __future__ import annotations

import contextlib
import json
import math
import sys
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Final

from tqdm import tqdm

from loi_core.cli.codes import DONE, FAILED
from loi_core.errors import OptionError
from loi_core.runs import DaskExecutor
from loi_core.support.wording import printable
from loi_core.sweeps import SweepResult, sweep

__all__ = ["carry_out_sweep"]

MOST_SHOWN: Final = 10  # settings


def carry_out_sweep(
    path: Path, output: Path | None, *, processes: int | None, dask: str | None, retry_failed: bool, as_json: bool
) -> int:
    """Carry out what is left of a sweep and print who did best.

    Returns
    -------
    int
        The exit status: 0 if every run is done, 1 if some have failed.
    """
    if dask is not None and processes is not None:
        msg = "`--dask` and `--processes` exclude each other; a cluster knows how many workers it has"
        raise OptionError(msg)
    bar = _Bar()
    try:
        with _executor(dask) as executor:
            found = sweep(
                path,
                output=output,
                executor=executor,
                processes=processes,
                retry_failed=retry_failed,
                progress=bar.step,
            )
    finally:
        bar.close()
    if as_json:
        rows = [{name: _plain(value) for name, value in row.items()} for row in found.rows]
        print(json.dumps({"rows": rows, "table": str(found.table), "leaderboard": str(found.page)}, indent=2))
    else:
        _print(found)
    return FAILED if found.count("failed") else DONE


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


def _print(found: SweepResult) -> None:
    for place, one in enumerate(found.standings[:MOST_SHOWN], 1):
        mean = "-" if math.isnan(one.mean) else f"{one.mean:.4g}"
        print(f"{place:>3}.  {mean:>8}  {one.converged} of {len(one.rows)} converged  {one.name}")
    if len(found.standings) > MOST_SHOWN:
        print(f"      and {len(found.standings) - MOST_SHOWN} more settings")
    failed = [row for row in found.rows if row["status"] == "failed"]
    for row in failed:
        print(f"loi: {printable(row['run'])} failed: {printable(str(row['cause']))}", file=sys.stderr)
    again = "; `--retry-failed` carries those out again" if failed else ""
    print(f"\n{found.count('done')} runs done, {len(failed)} failed{again}")
    print(f"leaderboard: {found.page}\ntable: {found.table}")


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


class _Bar:
    """A progress bar on standard error; silent where that is not a terminal."""

    def __init__(self) -> None:
        self._bar: tqdm[Any] | None = None
        self._failed = 0

    def step(self, ended: int, wanted: int, cause: str) -> None:
        """Say how many runs have ended."""
        if self._bar is None:
            self._bar = tqdm(total=wanted, disable=None)
        if cause:
            self._failed += 1
            self._bar.set_postfix_str(f"{self._failed} failed", refresh=False)
        self._bar.update(ended - self._bar.n)

    def close(self) -> None:
        """Leave the bar as it is and end its line."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None
