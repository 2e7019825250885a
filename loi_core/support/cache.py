"""What is costly to make and often wanted again, kept within a bound on memory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from typing import Final, Generic, TypeVar

from loi_core.support.forking import ForkSafeLock

__all__ = ["BESIDE", "Cache"]

BESIDE: Final = 1024
"""Numbers that a kept array takes the memory of, beside its own: of the objects that hold it, and of its key."""

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class Cache(Generic[Key, Value]):
    """Values by key, up to a number of elements; those longest unused go first. Any thread may use it.

    Parameters
    ----------
    most : int
        How many elements all values together may have.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._held = 0
        self._values: OrderedDict[Key, tuple[Value, int]] = OrderedDict()
        self._lock = ForkSafeLock()

    def get(self, key: Key) -> Value | None:
        """What is kept for `key`, if anything."""
        with self._lock:
            if key not in self._values:
                return None
            self._values.move_to_end(key)
            return self._values[key][0]

    def put(self, key: Key, value: Value, elements: int) -> None:
        """Keep a value of so many elements, unless that alone is too many."""
        with self._lock:
            if key in self._values or elements > self._most:
                return
            self._values[key] = value, elements
            self._held += elements
            while self._held > self._most:
                self._held -= self._values.popitem(last=False)[1][1]

    @property
    def held(self) -> int:
        """Elements of all that is kept."""
        return self._held
