"""Arrays whose length is not known before."""

from __future__ import annotations

from typing import Any

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written

__all__ = ["grown"]


@compiled_as_written
def grown(array: Any, size: int) -> Any:
    """The array if it has `size` entries, or else its entries in one at least twice as long."""
    if size <= len(array):
        return array
    longer = np.empty((max(size, 2 * len(array)), *array.shape[1:]), array.dtype)
    # Entry by entry: where Numba assigns arrays, it compiles for seconds what it would say of other shapes.
    new, old = longer.reshape(-1), array.reshape(-1)
    for index in range(len(old)):
        new[index] = old[index]
    return longer
