"""Measuring one setting in a process of its own, so that its memory is its own and a crash ends nothing else."""

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
from loi_core.tradeoff.memory import peak_memory, restart_peak
from loi_core.tradeoff.settings import Setting

__all__ = ["Row", "Sample", "measure_setting"]

MOST_RUNS: Final = 100
SMALL: Final = 16  # pixels of a side of the problem that a backend is started with


@dataclass(frozen=True)
class Sample:
    """What one process has measured.

    Attributes
    ----------
    device : str
        Where the backend computed.
    seconds : float
        Median time of value and gradient.
    runs : int
        How many times that is the median of.
    memory : int or None
        Growth of the process's peak resident memory, in bytes; None where it cannot be told.
    gradient : array, shape (H, W, C)
    """

    device: str
    seconds: float
    runs: int
    memory: int | None
    gradient: Host


@dataclass(frozen=True)
class Row:
    """One setting, measured.

    Attributes
    ----------
    setting : Setting
    device : str
    seconds : float
        Median time of value and gradient; NaN if there is a problem, as everything else that was not measured.
    runs : int
        How many times that is the median of.
    memory : int or None
        Growth of the process's peak resident memory, in bytes; None where it cannot be told.
    error : float
        Relative error of the image's gradient, 2-norm, against "exact" in float64 on NumPy with all scales.
    parameter_error : float or None
        The same of the gradient of the scene's parameters, the largest of them; None without a scene.
    problem : str
        One line on why nothing was measured; empty if it was.
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
    def judged(self) -> float:
        """The error to choose by: of what a fit moves, if that is known; it may be larger than the image's or less."""
        return self.error if self.parameter_error is None else self.parameter_error


def measure_setting(target: str, setting: Setting, image: Host, reference: Host, seconds: float) -> Sample | str:
    """Measure one setting.

    Parameters
    ----------
    target : str
        The backend's factory, ``module:object``.
    setting : Setting
        What to measure; its backend's name is not used.
    image, reference : array, shape (H, W, C)
        What to compare.
    seconds : float
        How long to repeat the evaluation; once is the least.

    Returns
    -------
    Sample or str
        A text of one line says why it could not be measured.
    """
    context = multiprocessing.get_context("spawn")  # a fork would take over this process's memory and threads
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(sender, target, setting, image, reference, seconds), daemon=True)
    try:
        with _ignored_interrupts():
            process.start()
        sender.close()
        sample: Sample | str = receiver.recv()
    except EOFError:
        process.join()
        return f"its process ended with exit code {process.exitcode}"
    finally:
        receiver.close()
        if process.pid is not None:
            process.kill()
            process.join()
    return sample


@contextlib.contextmanager
def _ignored_interrupts() -> Iterator[None]:
    """A process that is started in here does not see Ctrl-C, from its very start."""
    if threading.current_thread() is not threading.main_thread():  # only that one may change it
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _work(sender: Connection, target: str, setting: Setting, image: Host, reference: Host, seconds: float) -> None:
    try:
        backend: MeasurementBackend = EntryPoint(setting.backend, target, "").load()()
        sample: Sample | str = _measure(backend, setting, image, reference, seconds)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a backend may raise anything; the others must go on
        sample = " ".join(f"{type(error).__name__}: {error}".split())
    sender.send(sample)


def _measure(backend: MeasurementBackend, setting: Setting, image: Host, reference: Host, seconds: float) -> Sample:
    accuracy, dtype = setting.accuracy, setting.dtype
    small = Request(image[:SMALL, :SMALL], reference[:SMALL, :SMALL], ScaleSpace(1.0, 2.0, 0.5), accuracy, dtype)
    backend.prepare(small)()  # loads what a library loads on first use
    before = restart_peak()
    evaluate = backend.prepare(Request(image, reference, setting.scales, accuracy, dtype))
    _, gradient = evaluate()  # compiles, and fills caches
    times: list[float] = []
    start = time.perf_counter()
    while not times or (len(times) < MOST_RUNS and time.perf_counter() - start < seconds):
        begin = time.perf_counter()
        evaluate()
        times.append(time.perf_counter() - begin)
    after = peak_memory()
    device = backend.device()
    # What a GPU holds is not in a process's resident memory.
    memory = after - before if device == "cpu" and after is not None and before is not None else None
    return Sample(device, statistics.median(times), len(times), memory, np.array(gradient, dtype=np.float64))
