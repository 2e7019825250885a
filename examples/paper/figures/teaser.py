"""``python -m examples.paper teaser``: the paper's first figure, a lamp found from its highlight on a shiny ball.

Ball, camera and lamp are those of Table 2's *Envlight*, before a grey sky. Every method has its settings of Table 2.
Below the ends of all methods: how the image changes by the lamp's place, the loss of each method wherever the lamp may
be, and the way that its fit went over it. RGBXY, which the paper shows as well, follows what a camera ray meets first,
and not a highlight, which moves over a ball that stands still: it has no gradient here.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from examples.paper.lib.runner import carry_out_all
from examples.paper.lib.store import load
from examples.paper.lib.study import check_out
from examples.paper.table2.problem import Column, Problem, images_of, numbers
from examples.paper.table2.run import VARIANT, Run, carry_out, objective
from examples.paper.table2.scenes import FloatArray
from examples.paper.table2.settings import LABELS, PROTOCOLS, Method
from loi_core.io.files import write_bytes
from loi_core.report.plots import new_figure

# isort: split
import mitsuba as mi

__all__ = ["main"]

METHODS: Final[tuple[Method, ...]] = ("pixel_l2", "gaussian_pyramid", "prdpt", "loi")
COLUMN: Final = Column("Teaser")
SIDE: Final = 21  # places of the lamp along each axis of a map
NUDGE: Final = 0.05  # units, for the change of the image
MAP_SAMPLES: Final = 64
GAMMA: Final = 1.0 / 2.2


def main(words: Sequence[str] | None = None) -> None:
    """Fit by every method, print where it ends, and draw the figure."""
    parser = argparse.ArgumentParser(
        prog="python -m examples.paper teaser",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--quick", action="store_true", help="two methods, tiny, a few steps")
    parser.add_argument("--out", type=Path, default=Path("out/teaser"), help="folder; what is in it is not done again")
    parser.add_argument("--seed", type=int, default=0, help="of the start (0)")
    parser.add_argument("--docs", type=Path, help="folder whose images/teaser.png is drawn anew")
    options = parser.parse_args(words)
    check_out(parser, options.out)
    mi.set_variant(VARIANT)
    methods: tuple[Method, ...] = ("prdpt", "loi") if options.quick else METHODS
    column = replace(COLUMN, width=32, samples=4) if options.quick else COLUMN
    settings = {method: PROTOCOLS["ours"][method] for method in methods}
    if options.quick:
        settings = {method: replace(setting, steps=8) for method, setting in settings.items()}
    runs = {LABELS[method]: Run(setting, column, options.seed) for method, setting in settings.items()}
    carry_out_all(list(runs.values()), carry_out, options.out / "runs", 1)
    records = {name: load(options.out / "runs", run) for name, run in runs.items()}
    done = {name: record for name, record in records.items() if record is not None}
    print("| method | ends at | MAE | PSNR | verdict |\n| --- | --- | --- | --- | --- |")
    for name, one in done.items():
        x, y = (values[-1] for values in one["path"].values())
        print(f"| {name} | ({x:.2f}, {y:.2f}) | {one['mae']:.3f} | {one['psnr']:.1f} | {one['verdict']} |")
    picture = _figure(Problem.of(column, options.seed), runs, done, 5 if options.quick else SIDE)
    write_bytes(options.out / "teaser.png", picture)
    if options.docs:
        write_bytes(options.docs / "images" / "teaser.png", picture)


def _figure(problem: Problem, runs: Mapping[str, Run], done: Mapping[str, Mapping[str, Any]], side: int) -> bytes:
    """Start, change of the image and target; then each method's end, its loss over the lamp's place, and its way."""
    render = images_of(problem.built, MAP_SAMPLES).render
    names = list(problem.built.truth)

    def seen(place: Mapping[str, float]) -> FloatArray:
        return np.asarray(render(numbers(place), seed=1), dtype=np.float64)

    places = np.linspace(-problem.built.reach, problem.built.reach, side)
    images = [[seen(dict(zip(names, (x, y), strict=True))) for x in places] for y in places]
    figure = new_figure(2.6 * (len(done) + 1), 4.6)
    axes: Any = figure.subplots(2, len(done) + 1)
    _show(axes[0, 0], problem.target, "target")
    _show(axes[1, 0], _change(seen, problem.built.start), "change of the image\nby the lamp's place, at the start")
    for number, (name, one) in enumerate(done.items(), 1):
        end = {key: values[-1] for key, values in one["path"].items()}
        _show(axes[0, number], seen(end), f"{name}, {one['psnr']:.1f} dB")
        below, wanted = axes[1, number], objective(runs[name].setting, problem.target)
        loss = [[float(wanted.value(image.astype(np.float32))) for image in row] for row in images]
        below.pcolormesh(places, places, loss, shading="nearest", cmap="magma")
        below.plot(*one["path"].values(), color="white", linewidth=1.2)
        below.plot(*problem.built.start.values(), "o", color="white", markersize=5)
        below.plot(*problem.built.truth.values(), "*", color="#34d399", markersize=11)
        below.set_title("its loss, and its way", fontsize=9)
        below.set(aspect="equal", xlim=places[[0, -1]], ylim=places[[0, -1]])
        below.tick_params(labelsize=7)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=100, bbox_inches="tight")
    return stream.getvalue()


def _change(seen: Callable[[Mapping[str, float]], FloatArray], start: Mapping[str, float]) -> FloatArray:
    """How much each pixel changes as the lamp moves, with the same noise; the most is 1."""
    first = next(iter(start))
    ahead, back = (seen(dict(start) | {first: start[first] + step}) for step in (NUDGE, -NUDGE))
    change = np.abs(ahead - back).max(axis=-1, keepdims=True).repeat(3, axis=-1)
    scaled: FloatArray = change / max(float(change.max()), np.finfo(np.float64).tiny)
    return scaled


def _show(axes: Any, image: Any, title: str) -> None:
    axes.imshow(np.clip(image, 0.0, 1.0) ** GAMMA)
    axes.set_title(title, fontsize=9)
    axes.set_axis_off()


if __name__ == "__main__":
    main()
