"""The process that carries out runs, one after the other, for the process that has started it."""

from __future__ import annotations

import os
import pickle
import struct
import threading
import traceback
from queue import Empty, SimpleQueue
from typing import BinaryIO, Final

from loi_core.runs.reply import Reply
from loi_core.support.wording import described

__all__ = ["IDLE", "SIZE", "serve"]

IDLE: Final = 300.0  # seconds without a run, after which a process ends by itself
SIZE: Final = struct.Struct("<Q")  # of a payload, before it


def serve() -> None:
    """Take runs from standard input and answer each on standard output, until there is no more to come."""
    jobs, replies = _private(0, os.devnull, "rb"), _private(1, None, "wb")
    queue: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(jobs, queue), daemon=True).start()
    while True:
        try:
            payload = queue.get(timeout=IDLE)
        except Empty:
            return
        pickle.dump(_carried_out(payload), replies)
        replies.flush()


def _private(descriptor: int, instead: str | None, mode: str) -> BinaryIO:
    """A standard stream to ourselves: a run finds nothing to read, and what it prints goes to standard error."""
    ours = os.fdopen(os.dup(descriptor), mode)
    other = 2 if instead is None else os.open(instead, os.O_RDONLY)
    os.dup2(other, descriptor)
    return ours  # type: ignore[return-value]  # by its mode


def _listen(jobs: BinaryIO, queue: SimpleQueue[bytes]) -> None:
    """Pass on what is to be done; end the process, whatever it does, once the one that started it is gone."""
    while True:
        head = jobs.read(SIZE.size)
        payload = jobs.read(SIZE.unpack(head)[0]) if len(head) == SIZE.size else b""
        if not payload:
            os._exit(1)
        queue.put(payload)


def _carried_out(payload: bytes) -> Reply:
    try:
        function, run = pickle.loads(payload)  # noqa: S301 - from the process that has started this one
        return Reply(pickle.dumps(function(run)))
    except BaseException as error:  # noqa: BLE001 - whatever a run raises, SystemExit too, is its failure
        return Reply(cause=described(error), details=traceback.format_exc())
