"""The convergence plot, as PNG bytes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Final

from loi_core.experiment import Trial

__all__ = ["LABELS", "convergence_plot"]

LABELS: Final = {"loi": "loi (ours)", "pixel_l2": "pixel L2", "gaussian_pyramid": "Gaussian pyramid"}
COLOURS: Final = {"loi": "#c2410c", "pixel_l2": "#64748b", "gaussian_pyramid": "#0369a1"}


def convergence_plot(trials: Sequence[Trial]) -> bytes:
    """Objective over its first value, and PSNR against the target, by step, as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    descent, quality = figure.subplots(1, 2)
    for trial in trials:
        if trial.result is None or not trial.result.history:
            continue
        style = {"label": LABELS.get(trial.objective, trial.objective), "color": COLOURS.get(trial.objective)}
        history = trial.result.history
        first = history[0].value or 1.0
        descent.plot([one.step for one in history], [one.value / first for one in history], **style)
        if trial.psnr:
            quality.plot(list(trial.psnr), list(trial.psnr.values()), **style)
    descent.set(title="objective, relative to its start", xlabel="step", yscale="log")
    quality.set(title="PSNR of the image against the target", xlabel="step", ylabel="dB")
    for axes in (descent, quality):
        axes.grid(visible=True, alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
        if axes.lines:
            axes.legend(frameon=False)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return stream.getvalue()
