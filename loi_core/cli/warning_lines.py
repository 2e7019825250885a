"""The project's warnings as lines of a command's output."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from loi_core.support.wording import printable

__all__ = ["one_line_warnings"]


@contextmanager
def one_line_warnings() -> Iterator[None]:
    """Print each warning of loi once, as one line on standard error; warnings of other packages are unchanged."""
    with warnings.catch_warnings():
        original, printed = warnings.showwarning, set[str]()

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            text = printable(str(message))
            if not category.__module__.startswith("loi_"):
                original(message, category, filename, lineno, file, line)
            elif text not in printed:
                printed.add(text)
                print(f"loi: {text}", file=sys.stderr)

        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield
