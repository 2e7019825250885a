"""``python -m examples.paper mug``: a handle that is turned away, which no loss of images sees by itself.

The paper shows a mug as a limit of its method: with the handle behind it, turning it changes no pixel, so that the
gradient is 0. It proposes to join its loss with blurring over the parameters, which looks at other angles. Each method
is tried from the same starts, all with the handle out of sight, on torch meshes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from PIL import Image

from examples.paper.lib.pictures import row_of, shown_as
from examples.paper.lib.study import check_out
from loi_core import Free, LOIObjective, PixelL2, fit
from loi_core.io.files import write_bytes
from loi_core.objectives import Objective
from loi_core.renderers import BlurredRenderer
from loi_core.renderers.contract import Renderer
from loi_torch.mesh import Camera, Light, Mesh, MeshRenderer, Rotate

__all__ = ["main", "renderer"]

TRUTH: Final = -25.0  # degrees about the mug's axis; at 90 the handle is right behind the mug
HIDDEN: Final = (75.0, 105.0)  # between these it cannot be seen
SIGMA: Final = 60.0  # degrees
RATE: Final = 6.0  # degrees a step
FOUND: Final = 2.0  # degrees
SIDES: Final = 48
GAMMA: Final = 1.0 / 2.2
FloatArray = np.ndarray[Any, np.dtype[np.float64]]


def tube(path: FloatArray, normal: FloatArray, radius: float, *, closed: bool = False) -> tuple[FloatArray, list[Any]]:
    """A tube along points of a plane with this normal, a few sides round: its vertices and triangles."""
    ahead = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0) if closed else np.gradient(path, axis=0)
    aside = np.cross(ahead / np.linalg.norm(ahead, axis=1, keepdims=True), normal)
    turns = 2.0 * np.pi * np.arange(8) / 8
    rings = path[:, None] + radius * (np.cos(turns)[:, None] * aside[:, None] + np.sin(turns)[:, None] * normal)
    return rings.reshape(-1, 3), _grid(len(path), 8, closed=closed)


def _grid(rows: int, columns: int, *, closed: bool) -> list[Any]:
    faces = []
    for row in range(rows if closed else rows - 1):
        for column in range(columns):
            a, b = row * columns + column, row * columns + (column + 1) % columns
            c, d = ((row + 1) % rows) * columns + column, ((row + 1) % rows) * columns + (column + 1) % columns
            faces += [[a, b, d], [a, d, c]]
    return faces


def renderer(side: int) -> MeshRenderer:
    """A mug as seen from a little above, whose handle turns about its axis."""
    turns = 2.0 * np.pi * np.arange(SIDES) / SIDES
    wall = np.stack(
        [np.stack([np.cos(turns), np.full(SIDES, y), np.sin(turns)], axis=1) for y in np.linspace(-1.1, 1.1, 6)]
    ).reshape(-1, 3)
    bend = np.pi * (np.linspace(0.0, 1.0, 17) - 0.5)
    arc = np.stack([0.95 + 0.65 * np.cos(bend), 0.75 * np.sin(bend), 0.0 * bend], axis=1)
    grip, around = tube(arc, np.array([0.0, 0.0, 1.0]), 0.13)
    clay = (0.25, 0.45, 0.75)
    meshes = {
        "wall": Mesh(wall, _grid(6, SIDES, closed=False), colours=clay),
        "handle": Mesh(grip, around, colours=clay),
    }
    turn = {"turn": Rotate("handle", (0, 1, 0), (0, 0, 0))}
    light = Light(position=(3.0, 4.0, 5.0))
    return MeshRenderer(side, side, meshes, Camera((0.0, 1.2, 6.0)), turn, lights={"lamp": light})


def main(words: Sequence[str] | None = None) -> None:
    """Fit from every start by every method, and draw the first."""
    parser = argparse.ArgumentParser(
        prog="python -m examples.paper mug", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one start, small, fewer steps")
    parser.add_argument("--starts", type=int, default=5, help="default: 5")
    parser.add_argument("--out", type=Path, default=Path("out/mug"), help="folder for the picture")
    parser.add_argument("--json", action="store_true", help="one line of JSON for each fit")
    options = parser.parse_args(words)
    if options.starts < 1:
        parser.error("--starts must be 1 or more")
    check_out(parser, options.out)
    side, steps, count = (32, 80, 1) if options.quick else (64, 120, options.starts)
    plain = renderer(side)
    photograph = plain.render({"turn": torch.tensor(TRUTH, dtype=torch.float64)})
    looks = BlurredRenderer(plain, SIGMA, final_sigma=2.0, pairs=2)
    methods: dict[str, tuple[Renderer, Objective]] = {
        "loi": (plain, LOIObjective(photograph)),
        "PRDPT (pixels)": (looks, PixelL2(photograph)),
        "loi + PRDPT": (looks, LOIObjective(photograph)),
    }
    if not options.json:
        print("| method | start | end | found | verdict |\n| --- | --- | --- | --- | --- |")
    pictures: dict[str, Any] = {}
    for number, start in enumerate(np.linspace(*HIDDEN, count + 2)[1:-1]):
        pictures.setdefault("start", plain.render({"turn": torch.tensor(start)}))
        for name, (images, objective) in methods.items():
            found = fit(
                images, objective, steps=steps, learning_rate=RATE, seed=number, optimise={"turn": Free(float(start))}
            )
            end = (float(found.params["turn"]) + 180.0) % 360.0 - 180.0
            there = abs(end - TRUTH) < FOUND
            verdict = found.diagnosis.verdict if found.diagnosis else ""
            pictures.setdefault(name, plain.render(found.params))
            if options.json:
                fields = {"method": name, "start": float(start), "end": end, "found": there, "verdict": verdict}
                print(json.dumps(fields), flush=True)
            else:
                print(f"| {name} | {start:.0f}° | {end:.1f}° | {there} | {verdict} |", flush=True)
    pictures["target"] = photograph
    write_bytes(options.out / "mug.png", row_of({name: _seen(one) for name, one in pictures.items()}))


def _seen(image: torch.Tensor) -> Image.Image:
    return shown_as(np.clip(image.detach().numpy(), 0.0, 1.0) ** GAMMA)


if __name__ == "__main__":
    main()
