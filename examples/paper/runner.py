"""Carrying out many runs, side by side, each once."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Final, TypeVar

from tqdm import tqdm

from examples.paper.store import Run, is_done, keep

__all__ = ["carry_out_all"]

Made = TypeVar("Made", bound=Run)

# Each process computes on one thread: runs side by side use the cores better than threads within a run.
ONE_THREAD: Final = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)


def _wanted(number: int, total: int) -> str:
    return "runs" if number == total else f"{total - number} of {total} runs were done before; others"


def carry_out_all(runs: Sequence[Made], carry_out: Callable[[Made], Any], folder: Path, processes: int) -> None:
    """Carry out those runs that are not in the folder yet; each is kept as it ends, so that Ctrl-C loses little."""
    wanted = [run for run in dict.fromkeys(runs) if not is_done(folder, run)]
    with tqdm(total=len(wanted), desc=_wanted(len(wanted), len(runs))) as bar:
        if not wanted:
            return
        os.environ.update(ONE_THREAD)  # for the processes that are started, which inherit it
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(processes, mp_context=context) as pool:
            try:
                for future in as_completed([pool.submit(_one, run, carry_out, folder) for run in wanted]):
                    future.result()
                    bar.update()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise


def _one(run: Made, carry_out: Callable[[Made], Any], folder: Path) -> None:
    keep(folder, run, carry_out(run))
