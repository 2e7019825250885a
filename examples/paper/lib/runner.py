"""Carry out many runs in parallel, each once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from examples.paper.lib.store import Run, is_done, keep
from loi_core.runs import Workers

__all__ = ["carry_out_all"]

RunType = TypeVar("RunType", bound=Run)


def _description(pending: int, total: int) -> str:
    return "runs" if pending == total else f"{pending} remaining of {total} runs"


def carry_out_all(runs: Sequence[RunType], carry_out: Callable[[RunType], Any], folder: Path, processes: int) -> None:
    """Carry out the runs without a record in the folder, and store each as it ends.

    Ctrl-C loses unfinished runs only.

    Raises
    ------
    RuntimeError
        For the first run that fails, because the cause usually affects all of them. Finished runs stay stored.
    """
    pending = [run for run in dict.fromkeys(runs) if not is_done(folder, run)]
    with tqdm(total=len(pending), desc=_description(len(pending), len(runs))) as bar:
        if not pending:
            return
        with Workers(processes=processes) as workers:
            for result in workers.map_unordered(carry_out, pending):
                if result.cause:
                    msg = f"{result.run!r}: {result.cause}\n{result.details}"
                    raise RuntimeError(msg)
                keep(folder, result.run, result.value)
                bar.update()
