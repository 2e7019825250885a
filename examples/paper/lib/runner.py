"""Carrying out many runs, side by side, each once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from examples.paper.lib.store import Run, is_done, keep
from loi_core.runs import Workers

__all__ = ["carry_out_all"]

Made = TypeVar("Made", bound=Run)


def _wanted(number: int, total: int) -> str:
    return "runs" if number == total else f"{total - number} of {total} runs were done before; others"


def carry_out_all(runs: Sequence[Made], carry_out: Callable[[Made], Any], folder: Path, processes: int) -> None:
    """Carry out those runs that are not in the folder yet; each is kept as it ends, so that Ctrl-C loses little.

    Raises
    ------
    RuntimeError
        For the first that fails: the others would, as a rule, fail as well. What had ended is kept.
    """
    wanted = [run for run in dict.fromkeys(runs) if not is_done(folder, run)]
    with tqdm(total=len(wanted), desc=_wanted(len(wanted), len(runs))) as bar:
        if not wanted:
            return
        with Workers(processes=processes) as workers:
            for result in workers.map_unordered(carry_out, wanted):
                if result.cause:
                    msg = f"{result.run!r}: {result.cause}\n{result.details}"
                    raise RuntimeError(msg)
                keep(folder, result.run, result.value)
                bar.update()
