"""The result of a fit as a notebook shows it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np

from loi_core.fitting.history import FitStep
from loi_core.fitting.verdict import Diagnosis
from loi_core.fitting.views import Images, by_view
from loi_core.pixels.thumbnail import pictured
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Host, to_numpy
from loi_core.support.html import card, paragraph, side_by_side, sparkline, table

__all__ = ["curves", "in_notebook", "numbers"]

MOST_PICTURES: Final = 4
MOST_PARAMETERS: Final = 12
MOST_NUMBERS: Final = 6  # of one parameter
MOST_POINTS: Final = 120  # of a curve
LEAST: Final = 1e-16  # of the first value: where 0 is drawn


def in_notebook(
    name: str,
    facts: Mapping[str, str],
    diagnosis: Diagnosis | None,
    found: Parameters,
    moved: Collection[str],
    history: Sequence[FitStep],
    image: Images,
) -> str:
    """A result as HTML: what came of it, numbers, parameters, the picture and how the value fell."""
    verdict = "" if diagnosis is None else f"{'✓' if diagnosis.ok else '✗'} {diagnosis}"
    pictures = [
        pictured(one, f"found: {view}" if view else "found")
        for view, one in list(by_view(image).items())[:MOST_PICTURES]
    ]
    curve = sparkline(curves(history), "value by step, logarithmic; each stage by its own first")
    return card(
        name,
        paragraph(verdict),
        side_by_side([*pictures, curve]),
        table(list(facts.items())),
        table(_parameters(found, moved, history), ("parameter", "start", "found")),
    )


def curves(history: Sequence[FitStep]) -> list[list[tuple[float, float]]]:
    """Points (step, log10 of the value over the first of its stage), of each stage; of long fits only some steps."""
    steps = len(history)
    some = sorted({round(place) for place in np.linspace(0, steps - 1, min(steps, MOST_POINTS))}) if steps else []
    stages: dict[int, list[FitStep]] = {}
    for entry in (history[index] for index in some):
        stages.setdefault(entry.stage, []).append(entry)
    return [
        [(one.step, math.log10(max(one.value / stage[0].value, LEAST))) for one in stage]
        for stage in stages.values()
        if stage[0].value > 0.0
    ]


def numbers(value: Host) -> str:
    """A parameter in few words: its numbers, or of many the shape and the range."""
    if value.size > MOST_NUMBERS:
        return f"{'x'.join(map(str, value.shape))} from {np.min(value):.4g} to {np.max(value):.4g}"
    return " ".join(f"{one:.5g}" for one in value.ravel())


def _parameters(found: Parameters, moved: Collection[str], history: Sequence[FitStep]) -> list[list[str]]:
    """Those that could move, with where they started if the history has it."""
    start = history[0].params if len(history) else {}
    names = [name for name in found if name in moved]
    rows = [
        [name, numbers(start[name]) if name in start else "", numbers(np.asarray(to_numpy(found[name])))]
        for name in names[:MOST_PARAMETERS]
    ]
    return rows + ([[f"and {len(names) - MOST_PARAMETERS} more", "", ""]] if len(names) > MOST_PARAMETERS else [])
