"""What integrators of Mitsuba would put on a film.

Mitsuba differentiates through its film. To find the gradient it makes an image first, that nobody looks at; and to find
how the image changes it traces all rays again for each pixel that a sample reaches, of 25 with a Gaussian filter.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mitsuba as mi

__all__ = ["samples_taken"]


@contextmanager
def samples_taken() -> Iterator[list[dict[str, Any]]]:
    """What Mitsuba would put on films meanwhile, which stay empty: arguments of `mi.ImageBlock.put`, by their names."""
    taken: list[dict[str, Any]] = []
    put = mi.ImageBlock.put

    def take(block: Any, pos: Any, values: Any = None, **named: Any) -> None:  # noqa: ARG001
        taken.append({"pos": pos, "values": values, **named})

    mi.ImageBlock.put = take
    try:
        yield taken
    finally:
        mi.ImageBlock.put = put
