"""Plots, as PNG bytes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any, Final, Literal

from loi_core.scenes.experiment import Trial
from loi_core.tradeoff import Tradeoff

__all__ = ["LABELS", "convergence_plot", "new_figure", "png_of", "tradeoff_plot"]

LABELS: Final = {
    "loi": "loi (ours)",
    "pixel_l2": "pixel L2",
    "gaussian_pyramid": "Gaussian pyramid",
    "ms_ssim": "MS-SSIM",
    "lpips": "LPIPS",
}
COLOURS: Final = {
    "loi": "#c2410c",
    "pixel_l2": "#1f2937",
    "gaussian_pyramid": "#0369a1",
    "ms_ssim": "#15803d",
    "lpips": "#7e22ce",
}
BACKEND_COLOURS: Final = ("#0369a1", "#15803d", "#7e22ce", "#64748b", "#a16207")
PARETO: Final = "#c2410c"
LEAST: Final = 1e-16  # where an error, or an objective, of 0 is drawn


def convergence_plot(trials: Sequence[Trial]) -> bytes:
    """Objective over its first value, and PSNR against the target, by step, as a PNG."""
    figure = new_figure(9.0, 3.2, layout=None)  # a layout that measures every label takes longer than a small fit
    figure.subplots_adjust(left=0.07, right=0.985, bottom=0.16, top=0.89, wspace=0.17)
    descent, quality = figure.subplots(1, 2)
    for trial in trials:
        if trial.result is None or not trial.result.history:
            continue
        style = {"label": LABELS.get(trial.objective, trial.objective), "color": COLOURS.get(trial.objective)}
        history = trial.result.history
        first = history[0].value or 1.0
        falls = [max(one.value / first, LEAST) for one in history]  # a logarithm of 0 has no place on the axis
        descent.plot([one.step for one in history], falls, **style)
        if trial.psnr:
            quality.plot(list(trial.psnr), list(trial.psnr.values()), **style)
    descent.set(title="objective, relative to its start", xlabel="step", yscale="log")
    quality.set(title="PSNR of the image against the target", xlabel="step", ylabel="dB")
    descent.minorticks_off()
    for axes in (descent, quality):
        axes.grid(visible=True, alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
        if axes.lines:
            axes.legend(frameon=False)
    return png_of(figure)


def tradeoff_plot(found: Tradeoff) -> bytes:
    """Error of the gradient by time, both logarithmic, with the Pareto set joined, numbered and named, as a PNG."""
    figure = new_figure(9.0, 5.0)
    axes = figure.subplots()
    shown = [(row, mark) for row, mark in zip(found.rows, found.pareto, strict=True) if not row.problem]
    for number, name in enumerate(dict.fromkeys(row.setting.backend for row, _ in shown)):
        for change, marker in ((False, "o"), (True, "x")):
            rows = [row for row, _ in shown if row.setting.backend == name and bool(row.setting.change) == change]
            axes.plot(
                [1e3 * row.seconds for row in rows],
                [max(row.judged, LEAST) for row in rows],
                marker,
                color=BACKEND_COLOURS[number % len(BACKEND_COLOURS)],
                label=f"{name}, other scales" if change else name,
            )
    front = sorted((1e3 * row.seconds, max(row.judged, LEAST), str(row.setting)) for row, mark in shown if mark)
    axes.step([one[0] for one in front], [one[1] for one in front], where="post", color=PARETO, label="Pareto set")
    for number, (milliseconds, error, _) in enumerate(front, 1):
        axes.annotate(str(number), (milliseconds, error), (4, 3), textcoords="offset points", fontsize=8, color=PARETO)
    names = [f"{number}  {name}" for number, (_, _, name) in enumerate(front, 1)]
    axes.text(1.02, 1.0, "\n".join(names), transform=axes.transAxes, fontsize=8, va="top", linespacing=1.6)
    if found.noise is not None and found.noise.least is not None:
        axes.axhline(found.noise.least, color="#64748b", linestyle=":", label="noise of the renderer's gradient")
    whose = "parameters'" if any(row.parameter_error is not None for row, _ in shown) else "image's"
    axes.set(
        xscale="log", yscale="log", xlabel="value and gradient, ms", ylabel=f"relative error of the {whose} gradient"
    )
    axes.set_title(f"{found.problem.name}; errors below {LEAST:g} are drawn there")
    axes.margins(x=0.1, y=0.15)
    axes.grid(visible=True, alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8, loc="lower left")
    return png_of(figure)


def new_figure(width: float, height: float, *, layout: Literal["constrained"] | None = "constrained") -> Any:
    """A Matplotlib figure of this size in inches, without a display; Matplotlib is slow to import, so only here."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def png_of(figure: Any) -> bytes:
    """A figure of :func:`new_figure` as a PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return stream.getvalue()
