"""How much memory a process has had at most, as the system counts it: every library's, not only NumPy's."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

__all__ = ["peak_memory", "restart_peak"]

STATUS = Path("/proc/self/status")
CLEAR = Path("/proc/self/clear_refs")


def peak_memory() -> int | None:
    """High-water mark of this process's resident memory, in bytes; None where the system does not tell."""
    # On Linux not getrusage, whose mark a process inherits from the one that started it.
    if sys.platform == "linux":
        try:
            lines = STATUS.read_text(encoding="ascii").splitlines()
        except OSError:
            return None
        return next((1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:")), None)
    if sys.platform == "darwin":
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return None


def restart_peak() -> int | None:
    """Set the high-water mark back to what is resident now where the system allows it; returns the mark."""
    with contextlib.suppress(OSError):  # then the mark stays, and what remains below it is not seen
        CLEAR.write_text("5", encoding="ascii")
    return peak_memory()
