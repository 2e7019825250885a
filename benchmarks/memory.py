"""Peak memory of a row, in a fresh process."""

from __future__ import annotations

import contextlib
import gc
import resource
import subprocess
import sys
from pathlib import Path
from typing import Final

import jax
import torch

from benchmarks.peers import Row, images
from benchmarks.results import Result, Size

__all__ = ["measured_memory", "memory_of"]

ROOT: Final = Path(__file__).parents[1]


def measured_memory(result: Result, limit: float) -> tuple[float | None, str]:
    """Return the peak memory in bytes, measured in a fresh process, or the reason for its absence."""
    height, width = result.size
    command = [sys.executable, "-m", "benchmarks.speed", "--sizes", f"{width}x{height}", "--memory-of", result.row.key]
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120.0 + 10.0 * limit)
    except subprocess.TimeoutExpired:
        return None, f"failed: two evaluations take more than {120.0 + 10.0 * limit:g} s"
    if done.returncode != 0:
        messages = done.stderr.strip().splitlines()
        return None, f"failed with {done.returncode}: {messages[-1] if messages else 'killed, for memory most likely'}"
    return float(done.stdout.split()[-1]), ""


def memory_of(row: Row, size: Size) -> float:
    """Return the growth of the peak beyond the inputs, in bytes; for a process that does nothing else."""
    tiny = row.start(row, *images(row.smallest, row.smallest))()
    tiny()
    del tiny
    prepare = row.start(row, *images(*size))
    gc.collect()
    baseline = _peak(row, start=True)
    call = prepare()
    for _ in range(2):
        call()
    return max(_peak(row, start=False) - baseline, 0.0)


def _peak(row: Row, *, start: bool) -> float:
    """Return the peak memory so far, in bytes; `start` resets the peak if the system allows."""
    if row.device == "cuda" and row.library == "jax":
        return float(jax.devices("gpu")[0].memory_stats()["peak_bytes_in_use"])
    if row.device == "cuda":
        if start:
            torch.cuda.reset_peak_memory_stats()
        return float(torch.cuda.max_memory_allocated())
    status, forget = Path("/proc/self/status"), Path("/proc/self/clear_refs")
    if not status.exists():
        largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return float(largest) if sys.platform == "darwin" else 1024.0 * largest
    # Linux: ru_maxrss would begin at the size of the process that started this one, and cannot be set back.
    if start:
        with contextlib.suppress(OSError):  # some containers forbid this
            forget.write_text("5")
    (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return 1024.0 * float(line.split()[1])
