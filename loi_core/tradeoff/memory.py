"""Peak memory of a process as the operating system counts it, for all libraries together."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

__all__ = ["peak_memory", "reset_peak"]

STATUS = Path("/proc/self/status")
CLEAR = Path("/proc/self/clear_refs")


def peak_memory() -> int | None:
    """Return the peak resident memory of this process in bytes; None if the system does not report it."""
    # On Linux getrusage would include the peak of the parent process.
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


def reset_peak() -> int | None:
    """Reset the peak to the current resident memory if the system allows it; return the peak."""
    with contextlib.suppress(OSError):
        CLEAR.write_text("5", encoding="ascii")
    return peak_memory()
