"""The page of a fit that runs: rewritten as the fit advances, until the report replaces it."""

from __future__ import annotations

import time
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Final

from loi_core.fitting.history import FitStep
from loi_core.io.files import write_text
from loi_core.io.images import png_bytes
from loi_core.io.result_folder import PAGE_FILE, ResultFolder
from loi_core.report.curves import chart_figure, convergence_charts
from loi_core.report.document import asset, document
from loi_core.report.names import objective_label
from loi_core.report.pictures import picture_figure
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Host

__all__ = ["RunningPage"]

MIN_INTERVAL_S: Final = 1.0  # between two versions of the page
MAX_TIME_FRACTION: Final = 0.05  # of the fit, for writing the page


class RunningPage:
    """A page that follows a fit; call it after every step, as :data:`loi_core.scenes.experiment.Watch`.

    The page lies where the report will be, and reloads itself.

    Parameters
    ----------
    scene : Scene
    folder : ResultFolder
        The folder of the scene's results.
    announce : callable
        Called with the path of the page once it exists.
    """

    def __init__(self, scene: Scene, folder: ResultFolder, announce: Callable[[Path], None]) -> None:
        self._announce = announce
        self._scene = scene
        self._folder = folder
        self._display = scene.display
        self._target = self._figure(scene.target_montage, "target")
        self._histories: dict[str, dict[str, list[float]]] = {}
        self._due_s = 0.0

    def __call__(self, objective: str, step: FitStep, psnr: float, picture: Callable[[], Host]) -> None:
        """Record a step, and rewrite the page if the last version is old enough."""
        history = self._histories.setdefault(objective, {"step": [], "value": [], "psnr": [], "stage": []})
        for name, value in {"step": step.step, "value": step.value, "psnr": psnr, "stage": step.stage}.items():
            history[name].append(value)
        began = time.monotonic()
        if began < self._due_s:
            return
        path = self._folder.file(PAGE_FILE)
        write_text(path, self._html(objective, self._figure(picture(), f"step {step.step}")))
        if not self._due_s:
            self._announce(path)
        ended = time.monotonic()
        self._due_s = ended + max(MIN_INTERVAL_S, (ended - began) / MAX_TIME_FRACTION)

    def _html(self, objective: str, newest: str) -> str:
        scene, history = self._scene, self._histories[objective]
        done, total = int(history["step"][-1]) + 1, scene.fit.steps
        charts = "".join(map(chart_figure, convergence_charts(self._histories)))
        progress = (list(scene.objectives).index(objective) + done / total) / len(scene.objectives)
        lead = f"{scene.path.name}: the fit runs. This page reloads itself, and becomes the report at the end."
        body = f"""<main data-running>
<h1>{escape(scene.title)}</h1>
<p class="lead">{escape(lead)}</p>
<p class="verdict open"><b>{escape(objective_label(objective))}</b> step {done} of {total}, \
PSNR {history["psnr"][-1]:.4g} dB, objective {history["value"][-1]:.4g}, at {time.strftime("%H:%M:%S")}</p>
<progress value="{min(progress, 1.0):.3f}" aria-label="steps done"></progress>
<div class="row gallery">{newest}{self._target}</div>
<h2>Convergence</h2><div class="charts">{charts}</div>
<noscript><p>Without scripts this page does not reload itself.</p></noscript>
</main>"""
        return document(scene.title, body, style=asset("report.css"), script=asset("report.js"))

    def _figure(self, image: Host, caption: str) -> str:
        return picture_figure(png_bytes(self._display.show(image)), caption)
