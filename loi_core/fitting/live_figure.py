"""A figure of a running fit in the notebook that it runs in."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final

from loi_core.fitting.history import FitStep
from loi_core.fitting.notebook import convergence_figure, image_pictures
from loi_core.fitting.views import Images
from loi_core.support.repr_html import row

__all__ = ["LiveFigure"]

PERIOD_S: Final = 1.0  # between two drawings


class LiveFigure:
    """The image of the latest step and the values so far; leaving its ``with`` block draws the last step.

    Parameters
    ----------
    is_shown : bool
        Whether there is a figure, in a notebook. Elsewhere there is none.
    """

    def __init__(self, *, is_shown: bool) -> None:
        self._display: Any = _notebook_display() if is_shown else None
        self._due_s = 0.0
        self._latest: tuple[Sequence[FitStep], Images] | None = None

    def show(self, history: Sequence[FitStep], images: Mapping[str, Images]) -> None:
        """Show the images of the last step of a history, at most once a second."""
        if self._display is None:
            return
        self._latest = history, images
        if time.monotonic() >= self._due_s:
            self._draw(history, images)
            self._due_s = time.monotonic() + PERIOD_S

    def __enter__(self) -> LiveFigure:
        return self

    def __exit__(self, *_: object) -> None:
        if self._latest is not None:
            self._draw(*self._latest)

    def _draw(self, history: Sequence[FitStep], images: Mapping[str, Images]) -> None:
        html = row([*image_pictures(images, f"step {history[-1].step}"), convergence_figure(history)])
        self._display.update({"text/html": html, "text/plain": ""}, raw=True)


def _notebook_display() -> Any:
    """Return a handle to an empty output of the current cell, or None outside of a notebook."""
    ipython: Any = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if not hasattr(shell, "kernel"):
        return None
    return ipython.display.display({"text/html": "", "text/plain": ""}, raw=True, display_id=True)
