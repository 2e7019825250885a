"""Measurement of one setting in a separate process, which isolates its memory and its crashes."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import statistics
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from multiprocessing.connection import Connection
from typing import Final

import numpy as np

from loi_core.method.scales import ScaleSpace
from loi_core.plugins.measurement_backends import MeasurementBackend, Request
from loi_core.support.arrays import Host
from loi_core.tradeoff.memory import peak_memory, reset_peak
from loi_core.tradeoff.settings import Setting

__all__ = ["Row", "measure_setting"]

MAX_RUNS: Final = 100
WARM_UP_SIDE_PX: Final = 16


@dataclass(frozen=True)
class Row:
    """The measurement of one setting.

    Attributes
    ----------
    setting : Setting
    device : str
        Device of the backend.
    seconds : float
        Median duration of value and gradient; NaN if there is a problem, as all values that were not measured.
    runs : int
        Number of timed runs.
    memory : int or None
        Growth of the process's peak resident memory in bytes; None if it is unknown.
    error : float
        Relative error of the image gradient, 2-norm, against "exact" in float64 on NumPy with all scales.
    parameter_error : float or None
        Largest relative error among the gradients of the scene's parameters; None without a scene.
    problem : str
        Reason on one line if nothing was measured; otherwise empty.
    """

    setting: Setting
    device: str = ""
    seconds: float = float("nan")
    runs: int = 0
    memory: int | None = None
    error: float = float("nan")
    parameter_error: float | None = None
    problem: str = ""

    @property
    def relevant_error(self) -> float:
        """The error of the parameters if it is known, otherwise the error of the image gradient."""
        return self.error if self.parameter_error is None else self.parameter_error


def measure_setting(
    factory: str, setting: Setting, image: Host, reference: Host, seconds: float
) -> tuple[Row, Host | None]:
    """Measure one setting and return its row, without errors, and its gradient.

    Parameters
    ----------
    factory : str
        Factory of the backend, ``module:object``.
    setting : Setting
        The setting; the name of its backend is not used.
    image, reference : array, shape (H, W, C)
        The images to compare.
    seconds : float
        Time for repeated evaluations, at least one.

    Returns
    -------
    row : Row
    gradient : array, shape (H, W, C), or None
        None if the row has a problem.
    """
    context = multiprocessing.get_context("spawn")  # a fork would inherit this process's memory and threads
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(sender, factory, setting, image, reference, seconds), daemon=True)
    try:
        with _ignored_interrupts():
            process.start()
        sender.close()
        result: tuple[Row, Host | None] = receiver.recv()
    except EOFError:
        process.join()
        return Row(setting, problem=f"its process ended with exit code {process.exitcode}"), None
    finally:
        receiver.close()
        if process.pid is not None:
            process.kill()
            process.join()
    return result


@contextlib.contextmanager
def _ignored_interrupts() -> Iterator[None]:
    """Make processes that are started inside ignore Ctrl-C from the beginning."""
    if threading.current_thread() is not threading.main_thread():  # only the main thread may set handlers
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def _work(sender: Connection, factory: str, setting: Setting, image: Host, reference: Host, seconds: float) -> None:
    result: tuple[Row, Host | None]
    try:
        backend: MeasurementBackend = EntryPoint(setting.backend, factory, "").load()()
        result = _measure(backend, setting, image, reference, seconds)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a backend may raise anything
        result = Row(setting, problem=" ".join(f"{type(error).__name__}: {error}".split())), None
    sender.send(result)


def _measure(
    backend: MeasurementBackend, setting: Setting, image: Host, reference: Host, seconds: float
) -> tuple[Row, Host]:
    accuracy, dtype = setting.accuracy, setting.dtype
    window = slice(WARM_UP_SIDE_PX), slice(WARM_UP_SIDE_PX)
    warm_up = Request(image[window], reference[window], ScaleSpace(1.0, 2.0, 0.5), accuracy, dtype)
    backend.prepare(warm_up)()  # imports of the library
    initial_peak = reset_peak()
    evaluate = backend.prepare(Request(image, reference, setting.scales, accuracy, dtype))
    _, gradient = evaluate()  # compilation and caches
    times: list[float] = []
    start = time.perf_counter()
    while not times or (len(times) < MAX_RUNS and time.perf_counter() - start < seconds):
        begin = time.perf_counter()
        evaluate()
        times.append(time.perf_counter() - begin)
    peak = peak_memory()
    device = backend.device()
    # The resident memory of a process does not include GPU memory.
    memory = peak - initial_peak if device == "cpu" and peak is not None and initial_peak is not None else None
    row = Row(setting, device, statistics.median(times), len(times), memory)
    return row, np.array(gradient, dtype=np.float64)
