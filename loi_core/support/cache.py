"""A cache with a bound on memory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from typing import Final, Generic, TypeVar

from loi_core.support.forking import ForkSafeLock

__all__ = ["ARRAY_OVERHEAD", "Cache"]

ARRAY_OVERHEAD: Final = 1024
"""The memory of an array's key and of the objects around it, in elements of the array."""

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class Cache(Generic[Key, Value]):
    """Values by key, up to a total number of elements; the least recently used are dropped. Safe for threads.

    Parameters
    ----------
    max_elements : int
        The largest number of elements of all values together.
    """

    def __init__(self, max_elements: int) -> None:
        self._max_elements = max_elements
        self._elements = 0
        self._values: OrderedDict[Key, tuple[Value, int]] = OrderedDict()
        self._lock = ForkSafeLock()

    def get(self, key: Key) -> Value | None:
        """Return the value of `key`, or None."""
        with self._lock:
            if key not in self._values:
                return None
            self._values.move_to_end(key)
            return self._values[key][0]

    def put(self, key: Key, value: Value, elements: int) -> None:
        """Store a value with this number of elements, unless that number alone is too large."""
        with self._lock:
            if key in self._values or elements > self._max_elements:
                return
            self._values[key] = value, elements
            self._elements += elements
            while self._elements > self._max_elements:
                self._elements -= self._values.popitem(last=False)[1][1]

    @property
    def elements(self) -> int:
        """The number of elements of all stored values."""
        return self._elements
