"""The result of a fit as HTML for notebooks."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from html import escape
from typing import Final

import numpy as np

from loi_core.fitting.history import FitStep
from loi_core.fitting.verdict import Diagnosis
from loi_core.fitting.views import Images, by_view
from loi_core.pixels.thumbnail import thumbnail
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Host, to_numpy
from loi_core.support.charts import sparkline
from loi_core.support.repr_html import card, figure, row, table

__all__ = ["convergence_figure", "convergence_points", "image_pictures", "result_html"]

MAX_PICTURES: Final = 4
MAX_PARAMETERS: Final = 12
MAX_NUMBERS: Final = 6  # of one parameter
MAX_POINTS: Final = 120  # of all curves together
MIN_RELATIVE_VALUE: Final = 1e-16  # the value 0 is drawn here
CURVE_CAPTION: Final = "value by step, logarithmic, each stage relative to its first"


def result_html(
    name: str,
    facts: Mapping[str, str],
    diagnosis: Diagnosis | None,
    params: Parameters,
    free: Collection[str],
    history: Sequence[FitStep],
    image: Images,
) -> str:
    """Return a result as HTML: the diagnosis, numbers, free parameters, the image and the value by step."""
    verdict = "" if diagnosis is None else f"{'✓' if diagnosis.ok else '✗'} {diagnosis}"
    return card(
        name,
        escape(verdict).replace("\n", "<br>"),
        row([*image_pictures(by_view(image), "result"), convergence_figure(history)]),
        table(facts.items()),
        table(_parameter_rows(params, free, history), ("parameter", "start", "result")),
    )


def image_pictures(images: Mapping[str, Images], caption: str) -> list[str]:
    """Return small pictures of the images by view, each with a caption; of the first views if there are many."""
    return [
        thumbnail(image, f"{caption}: {view}" if view else caption)
        for view, image in list(images.items())[:MAX_PICTURES]
    ]


def convergence_figure(history: Sequence[FitStep]) -> str:
    """Return a curve of the values by step, with a caption; empty if there is nothing to draw."""
    return figure(sparkline(convergence_points(history), CURVE_CAPTION), CURVE_CAPTION)


def convergence_points(history: Sequence[FitStep]) -> list[list[tuple[float, float]]]:
    """Return points (step, log10 of the value over the first value of its stage) of each stage; few of a long fit."""
    steps = len(history)
    indices = sorted({round(index) for index in np.linspace(0, steps - 1, min(steps, MAX_POINTS))}) if steps else []
    stages: dict[int, list[FitStep]] = {}
    for entry in (history[index] for index in indices):
        stages.setdefault(entry.stage, []).append(entry)
    return [
        [(entry.step, math.log10(max(entry.value / stage[0].value, MIN_RELATIVE_VALUE))) for entry in stage]
        for stage in stages.values()
        if stage[0].value > 0.0
    ]


def _numbers(value: Host) -> str:
    """Return the numbers of a parameter as text, or the shape and range of a large one."""
    if value.size > MAX_NUMBERS:
        return f"{'x'.join(map(str, value.shape))} from {np.min(value):.4g} to {np.max(value):.4g}"
    return " ".join(f"{number:.5g}" for number in value.ravel())


def _parameter_rows(params: Parameters, free: Collection[str], history: Sequence[FitStep]) -> list[list[str]]:
    """Return name, start and result of the free parameters; the start is empty if the history lacks it."""
    start = history[0].params if len(history) else {}
    names = [name for name in params if name in free]
    rows = [
        [name, _numbers(start[name]) if name in start else "", _numbers(np.asarray(to_numpy(params[name])))]
        for name in names[:MAX_PARAMETERS]
    ]
    omitted = len(names) - MAX_PARAMETERS
    return [*rows, [f"and {omitted} more", "", ""]] if omitted > 0 else rows
