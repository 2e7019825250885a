"""Tiles side by side on several threads, and what comes of them in the order of the tiles."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Generic, TypeVar

from loi_core.method.compiled.threads import run_all, thread_count

__all__ = ["in_order"]

Result = TypeVar("Result")


def in_order(tasks: Iterable[Callable[[], Result]]) -> Iterator[Result]:
    """What tasks give, in their order; as many run at a time as there are threads, so that few results are in memory.

    Sums over results that are made in this order do not depend on the number of threads.
    """
    waiting = map(_Turn, tasks)
    while batch := list(islice(waiting, thread_count())):
        run_all([turn.run for turn in batch], object)
        for turn in batch:
            yield turn.results.pop()


@dataclass(frozen=True)
class _Turn(Generic[Result]):
    """A task, and what it has given."""

    task: Callable[[], Result]
    results: list[Result] = field(default_factory=list)

    def run(self, _: object) -> None:
        self.results.append(self.task())
