"""Our own warnings on the command line."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from loi_core.support.wording import printable

__all__ = ["warning_aloud"]


@contextmanager
def warning_aloud() -> Iterator[None]:
    """Warnings of loi are lines like all that a command says, each once; those of others stay as they are."""
    with warnings.catch_warnings():
        kept, told = warnings.showwarning, set[str]()

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            said = printable(str(message))
            if not category.__module__.startswith("loi_"):
                kept(message, category, filename, lineno, file, line)
            elif said not in told:
                told.add(said)
                print(f"loi: {said}", file=sys.stderr)

        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield
