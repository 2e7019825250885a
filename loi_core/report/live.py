"""The page that follows a fit while it runs, and what it asks its server for."""

from __future__ import annotations

import base64
import math
import threading
import time
from collections.abc import Callable
from html import escape
from typing import Any, Final

from loi_core.fitting.history import FitStep
from loi_core.io.images import png_bytes
from loi_core.pixels.display import Display
from loi_core.report.document import document
from loi_core.report.plots import LABELS
from loi_core.report.theme import asset
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Host

__all__ = ["Live", "live_page"]

EVERY: Final = 0.4  # seconds: a picture is kept for the page at most so often
MOST_POINTS: Final = 4096  # of an answer


class Live:
    """How far a fit has come, told to whoever follows it; safe to be asked from other threads.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene) -> None:
        self._display = Display.of(
            scene.strip({name: view.target.image for name, view in scene.views.items()}), scene.first.target.encoding
        )
        self._names = list(scene.objectives)
        self._lock = threading.Lock()
        self._points: list[tuple[int, int, float, float]] = []
        self._frame: tuple[int, Host] | None = None
        self._shown = -math.inf
        self._finished = ""
        self._asked = -math.inf

    def __call__(self, objective: str, step: FitStep, psnr: float, picture: Callable[[], Host]) -> None:
        """Take note of a step; see :data:`loi_core.scenes.experiment.Watch`."""
        now = time.monotonic()
        fresh = picture() if now - self._shown > EVERY else None
        with self._lock:
            self._points.append((self._names.index(objective), step.step, step.value, psnr))
            if fresh is not None:
                self._shown = now
                self._frame = len(self._points), fresh

    def finish(self, page: str) -> None:
        """The fit is over, and this is its report."""
        with self._lock:
            self._finished = page

    @property
    def page(self) -> str:
        """The finished report; empty before."""
        with self._lock:
            return self._finished

    def followed(self, seconds: float) -> bool:
        """Whether somebody has asked within so many seconds."""
        with self._lock:
            return time.monotonic() - self._asked < seconds

    def state(self, known: int) -> dict[str, Any]:
        """What has happened since somebody knew of so many steps, as plain values for JSON."""
        with self._lock:
            self._asked = time.monotonic()
            known = known if 0 <= known <= len(self._points) else 0
            points, frame = self._points[known : known + MOST_POINTS], self._frame
            answer: dict[str, Any] = {"total": len(self._points), "from": known, "done": bool(self._finished)}
        answer["points"] = [[index, step, _finite(value), _finite(psnr)] for index, step, value, psnr in points]
        answer["frame"] = 0 if frame is None else frame[0]
        return answer

    def picture(self) -> bytes:
        """The newest image as a PNG; empty before the first."""
        with self._lock:
            frame = self._frame
        return b"" if frame is None else self.encoded(frame[1])

    def encoded(self, image: Host) -> bytes:
        """An image as it is shown, as a PNG."""
        return png_bytes(self._display.show(image))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def live_page(scene: Scene, live: Live) -> str:
    """The page of a fit that runs: its target, its newest image, and its curves so far."""
    target = scene.strip({name: view.target.image for name, view in scene.views.items()})
    height, width = target.shape[:2]
    size = f'class="{"pixels" if width < 512 else "smooth"}" width="{width}" height="{height}"'
    data = base64.b64encode(live.encoded(target)).decode("ascii")
    names = [LABELS.get(name, name) for name in scene.objectives]
    keys = "".join(f'<li><span class="key c{index % 8}"></span>{escape(name)}</li>' for index, name in enumerate(names))
    named = escape("|".join(names))
    body = f"""<main class="live" data-steps="{scene.fit.steps}" data-names="{named}">
<h1>{escape(scene.title)}</h1>
<p class="lead">{escape(scene.path.name)}: the fit runs. This page follows it, and becomes its report at the end.</p>
<p class="verdict open"><b class="name">{escape(names[0])}</b> <span class="now">waits for its first step</span></p>
<progress max="1" value="0" aria-label="steps done"></progress>
<p class="lost soft" role="status"></p>
<div class="tools">
<figure class="panel"><h2>Now</h2><div class="over">
<img id="newest" {size} alt="the newest image of the fit" hidden></div></figure>
<figure class="panel"><h2>Target</h2><div class="over">
<img {size} alt="target" src="data:image/png;base64,{data}"></div></figure>
</div>
<ul class="legend">{keys}</ul>
<div class="charts">
<figure class="chart panel"><h2>Objective, relative to its start</h2>
<svg viewBox="0 0 420 200" role="img" aria-label="objective by step" data-of="value"></svg></figure>
<figure class="chart panel"><h2>PSNR against the target, dB</h2>
<svg viewBox="0 0 420 200" role="img" aria-label="PSNR by step" data-of="psnr"></svg></figure>
</div>
<noscript><p>Without scripts this page stands still: load it again for the report, once the fit is over.</p></noscript>
</main>"""
    return document(scene.title, body, style=asset("report.css"), script=asset("live.js"), served=True)
