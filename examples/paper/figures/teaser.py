"""``python -m examples.paper teaser``: the paper's first figure, a light located by its highlight on a glossy ball.

Ball, camera and light come from *Envlight* in Table 2, before a grey sky, and every method has its settings of Table 2.
The upper row shows the results of all methods. The lower row shows the change of the image with the position of the
light, and the loss of each method over that position with the path of its fit. The paper also shows RGBXY, which
differentiates the first hit of a camera ray: a highlight that moves over a fixed ball has no such gradient.
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
from examples.plots import new_figure
from loi_core.io.files import write_bytes

# isort: split
import mitsuba as mi

__all__ = ["main"]

METHODS: Final[tuple[Method, ...]] = ("pixel_l2", "gaussian_pyramid", "prdpt", "loi")
COLUMN: Final = Column("Teaser")
MAP_SIDE: Final = 21  # positions of the light along each axis of a map
STEP: Final = 0.05  # world units, for the change of the image
MAP_SAMPLES: Final = 64
GAMMA: Final = 1.0 / 2.2


def main(words: Sequence[str] | None = None) -> None:
    """Fit by every method, print the results, and draw the figure."""
    parser = argparse.ArgumentParser(
        prog="python -m examples.paper teaser",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--quick", action="store_true", help="two methods, tiny, a few steps")
    parser.add_argument(
        "--out", type=Path, default=Path("out/teaser"), help="output folder; its finished runs are kept"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the start (0)")
    parser.add_argument("--docs", type=Path, help="folder whose images/teaser.png is updated")
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
    finished = {name: record for name, record in records.items() if record is not None}
    print("| method | ends at | MAE | PSNR | verdict |\n| --- | --- | --- | --- | --- |")
    for name, record in finished.items():
        x, y = (values[-1] for values in record["path"].values())
        print(f"| {name} | ({x:.2f}, {y:.2f}) | {record['mae']:.3f} | {record['psnr']:.1f} | {record['verdict']} |")
    picture = _figure(Problem.of(column, options.seed), runs, finished, 5 if options.quick else MAP_SIDE)
    write_bytes(options.out / "teaser.png", picture)
    if options.docs:
        write_bytes(options.docs / "images" / "teaser.png", picture)


def _figure(
    problem: Problem, runs: Mapping[str, Run], finished: Mapping[str, Mapping[str, Any]], map_side: int
) -> bytes:
    """Return a PNG of the target and the image's change, then each method's result, loss map and path."""
    render = images_of(problem.built, MAP_SAMPLES).render
    names = list(problem.built.truth)

    def image_at(params: Mapping[str, float]) -> FloatArray:
        return np.asarray(render(numbers(params), seed=1), dtype=np.float64)

    positions = np.linspace(-problem.built.reach, problem.built.reach, map_side)
    images = [[image_at(dict(zip(names, (x, y), strict=True))) for x in positions] for y in positions]
    figure = new_figure(2.6 * (len(finished) + 1), 4.6)
    axes: Any = figure.subplots(2, len(finished) + 1)
    _show(axes[0, 0], problem.target, "target")
    _show(axes[1, 0], _change(image_at, problem.built.start), "change of the image with the\nlight, at the start")
    for column, (name, record) in enumerate(finished.items(), 1):
        result = {key: values[-1] for key, values in record["path"].items()}
        _show(axes[0, column], image_at(result), f"{name}, {record['psnr']:.1f} dB")
        loss_axes, method_objective = axes[1, column], objective(runs[name].setting, problem.target)
        loss = [[float(method_objective.value(image.astype(np.float32))) for image in row] for row in images]
        loss_axes.pcolormesh(positions, positions, loss, shading="nearest", cmap="magma")
        loss_axes.plot(*record["path"].values(), color="white", linewidth=1.2)
        loss_axes.plot(*problem.built.start.values(), "o", color="white", markersize=5)
        loss_axes.plot(*problem.built.truth.values(), "*", color="#34d399", markersize=11)
        loss_axes.set_title("loss and path of the fit", fontsize=9)
        loss_axes.set(aspect="equal", xlim=positions[[0, -1]], ylim=positions[[0, -1]])
        loss_axes.tick_params(labelsize=7)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=100, bbox_inches="tight")
    return stream.getvalue()


def _change(image_at: Callable[[Mapping[str, float]], FloatArray], start: Mapping[str, float]) -> FloatArray:
    """Return the change of each pixel as the light moves, at equal noise, scaled to a maximum of 1."""
    name = next(iter(start))
    forward, backward = (image_at(dict(start) | {name: start[name] + step}) for step in (STEP, -STEP))
    change = np.abs(forward - backward).max(axis=-1, keepdims=True).repeat(3, axis=-1)
    scaled: FloatArray = change / max(float(change.max()), np.finfo(np.float64).tiny)
    return scaled


def _show(axes: Any, image: Any, title: str) -> None:
    axes.imshow(np.clip(image, 0.0, 1.0) ** GAMMA)
    axes.set_title(title, fontsize=9)
    axes.set_axis_off()


if __name__ == "__main__":
    main()
