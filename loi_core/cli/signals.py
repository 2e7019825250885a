"""Ending a command on SIGTERM as on Ctrl-C."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn

__all__ = ["sigterm_as_ctrl_c"]


@contextlib.contextmanager
def sigterm_as_ctrl_c() -> Iterator[None]:
    """End the block on SIGTERM as on Ctrl-C, so that partial results are kept; a second SIGTERM is ignored.

    Nothing changes where SIGTERM is ignored already, or in threads other than the main thread, which get no signals.
    """
    original = signal.getsignal(signal.SIGTERM)
    if threading.current_thread() is not threading.main_thread() or original is signal.SIG_IGN:
        yield
        return

    def stop(_: int, __: FrameType | None) -> NoReturn:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # partial results are being written
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL if original is None else original)
