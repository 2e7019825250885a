"""Progress bars on standard error; silent if it is not a terminal."""

from __future__ import annotations

from types import TracebackType
from typing import Any

from tqdm import tqdm

__all__ = ["ProgressBar"]


class ProgressBar:
    """A progress bar that appears at the first step; leaving its ``with`` block ends its line."""

    def __init__(self) -> None:
        self._bar: tqdm[Any] | None = None
        self._title = ""
        self._begun = 0

    def begin(self, total: int, task: str) -> None:
        """Show the next of `total` tasks as it begins."""
        self.show(min(self._begun, total), total, task)
        self._begun += 1

    def show(self, done: int, total: int, note: str = "", *, title: str = "") -> None:
        """Show that `done` of `total` steps are done; a new title begins a new bar, which starts there."""
        if self._bar is None or title != self._title:
            self.close()
            self._title = title
            self._bar = tqdm(
                total=total, initial=max(done - 1, 0), desc=f"{title:>17}" if title else None, disable=None
            )
        if note:
            self._bar.set_postfix_str(note, refresh=False)
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        """Keep the bar as it is and end its line."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        self.close()
