"""The steps of a fit, however many: rows of numbers, of which all but the first lie in a file."""

from __future__ import annotations

import math
import os
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO, Any, Final, overload

import numpy as np

from loi_core.support.arrays import Host

__all__ = ["FIRST_COLUMNS", "FitStep", "History", "StepLog"]

FIRST_COLUMNS: Final = 6  # step, value, gradient norm, rate, seconds, stage; then the free parameters if they are few
MOST_BYTES: Final = 2**19  # of rows in memory: thousands of steps; a million have 56 MB and more
TOGETHER: Final = 1024  # rows that are read at a time


@dataclass(frozen=True)
class FitStep:
    """What one step found, before the parameters moved.

    Attributes
    ----------
    step : int
        Counted from 0.
    value : float
        The objective.
    gradient_norm : float
        Euclidean norm of the gradient by the free parameters.
    rate : float
        Fraction of the learning rate that the step took.
    seconds : float
        Time the step took.
    stage : int
        Which objective that is, from far to near; 0 where there is one.
    params : dict of arrays
        The free parameters, as NumPy; empty if they are more than 64 numbers together.
    """

    step: int
    value: float
    gradient_norm: float
    rate: float
    seconds: float
    stage: int = 0
    params: Mapping[str, Host] = field(default_factory=dict)


class StepLog:
    """Steps by their numbers, written one after another. A step may be written again; those after it are then void.

    So that a long fit takes no more memory than a short one, rows beyond the first half megabyte go to a temporary file
    that has no name. Where none can be made, or the disk is full, they stay in memory.

    Parameters
    ----------
    shapes : dict of shape, optional
        Of the parameters that every step has; those of the first step by default.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]] | None = None) -> None:
        self._shapes = None if shapes is None else dict(shapes)
        self._near = np.empty((0, 0))
        self._file: IO[bytes] | None = None
        self._far: dict[int, bytes] = {}  # by place in the file, what could not be written there

    def put(self, index: int, entry: FitStep) -> None:
        """Write a step as number `index`, 0 or the one after another that is there."""
        if self._shapes is None:
            self._shapes = {name: value.shape for name, value in entry.params.items()}
        first = entry.step, entry.value, entry.gradient_norm, entry.rate, entry.seconds, entry.stage
        values = (np.ravel(entry.params[name]) for name in self._shapes)
        self.put_row(index, np.concat([np.asarray(first, np.float64), *values]))

    def put_row(self, index: int, row: Host) -> None:
        """The same, as a row of :meth:`rows`."""
        if index < self._room:
            if index >= len(self._near):
                grown = np.empty((min(max(64, 2 * index), self._room), self._columns))
                if index:
                    grown[:index] = self._near[:index]
                self._near = grown
            self._near[index] = row
        else:
            self._write((index - self._room) * self._bytes, np.asarray(row, np.float64).tobytes())

    def rows(self, first: int, last: int) -> Host:
        """The steps from one number to before another: float64, shape (steps, 6 + numbers of the parameters)."""
        room = self._room
        near = self._near[first : min(last, room)]
        if last <= room:
            return near.copy()
        begin = max(first, room)
        raw = self._read((begin - room) * self._bytes, (last - begin) * self._bytes)
        return np.concat([near[: max(room - first, 0)], np.frombuffer(raw).reshape(-1, self._columns)])

    def step(self, row: Host) -> FitStep:
        """The step that a row holds."""
        params: dict[str, Host] = {}
        at = FIRST_COLUMNS
        for name, shape in (self._shapes or {}).items():
            size = math.prod(shape)
            params[name] = np.array(row[at : at + size]).reshape(shape)
            at += size
        value, norm, rate, seconds = map(float, row[1:5])
        return FitStep(int(row[0]), value, norm, rate, seconds, int(row[5]), params)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Of the parameters that every step has."""
        return dict(self._shapes or {})

    @property
    def _columns(self) -> int:
        return FIRST_COLUMNS + sum(math.prod(shape) for shape in (self._shapes or {}).values())

    @property
    def _bytes(self) -> int:
        return 8 * self._columns

    @property
    def _room(self) -> int:
        """How many rows are kept in memory."""
        return MOST_BYTES // self._bytes

    def _write(self, at: int, row: bytes) -> None:
        self._far.pop(at, None)
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  # for as long as this lives
                weakref.finalize(self, self._file.close)
            self._file.seek(at)
            written = self._file.write(row)
        except OSError:
            written = 0
        if written != len(row):
            self._far[at] = row

    def _read(self, at: int, size: int) -> bytes:
        if self._file is None:
            raw = bytearray(size)
        elif hasattr(os, "pread"):  # a forked process shares the place where a file is read
            raw = bytearray(os.pread(self._file.fileno(), size, at))
        else:
            self._file.seek(at)
            raw = bytearray(self._file.read(size))
        raw += bytes(size - len(raw))
        for place, row in self._far.items():
            if at <= place < at + size:
                raw[place - at : place - at + len(row)] = row
        return bytes(raw)


class History(Sequence[FitStep]):
    """The steps of a fit, from the first: a sequence that reads them as they are asked for.

    Parameters
    ----------
    log : StepLog
    steps : int
        How many of its steps.
    """

    def __init__(self, log: StepLog, steps: int) -> None:
        self._log, self._steps = log, steps

    @classmethod
    def of(cls, rows: Host, shapes: Mapping[str, tuple[int, ...]]) -> History:
        """That of rows as :attr:`rows` gives them."""
        log = StepLog(shapes)
        for index, row in enumerate(rows):
            log.put_row(index, row)
        return cls(log, len(rows))

    @property
    def rows(self) -> Host:
        """All of them: float64, shape (steps, 6 + numbers of the parameters); see `FIRST_COLUMNS`."""
        return self._log.rows(0, self._steps) if self._steps else np.zeros((0, FIRST_COLUMNS))

    def __len__(self) -> int:
        return self._steps

    @overload
    def __getitem__(self, index: int) -> FitStep: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[FitStep, ...]: ...

    def __getitem__(self, index: int | slice) -> FitStep | tuple[FitStep, ...]:
        found = range(self._steps)[index]
        if isinstance(found, range):
            return tuple(self[one] for one in found)
        return self._log.step(self._log.rows(found, found + 1)[0])

    def __iter__(self) -> Iterator[FitStep]:
        for first in range(0, self._steps, TOGETHER):
            for row in self._log.rows(first, min(first + TOGETHER, self._steps)):
                yield self._log.step(row)

    def __reduce__(self) -> tuple[Any, ...]:
        return History.of, (self.rows, self._log.shapes)

    def __deepcopy__(self, _: object) -> History:
        return History.of(self.rows, self._log.shapes)

    def __repr__(self) -> str:
        return f"<{self._steps} steps>"
