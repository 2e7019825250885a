"""``python -m examples.paper mug``: a handle that faces away, which no loss of images detects by itself.

The paper shows a mug as a limit of its method: behind the mug, the handle changes no pixel as it turns, and the
gradient is 0. It proposes to combine its loss with a blur over the parameters, which renders other angles too. Each
method starts from the same hidden angles of the handle, on torch meshes.
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

TRUE_ANGLE: Final = -25.0  # degrees about the mug's axis; at 90 the handle is exactly behind the mug
HIDDEN_ANGLES: Final = (75.0, 105.0)  # degrees, between which the handle is hidden
SIGMA: Final = 60.0  # degrees
RATE: Final = 6.0  # degrees per step
TOLERANCE: Final = 2.0  # degrees
WALL_SEGMENTS: Final = 48
TUBE_SEGMENTS: Final = 8
GAMMA: Final = 1.0 / 2.2
FloatArray = np.ndarray[Any, np.dtype[np.float64]]


def tube(path: FloatArray, normal: FloatArray, radius: float, *, closed: bool = False) -> tuple[FloatArray, list[Any]]:
    """Return vertices and triangles of a tube along a path in the plane with this normal."""
    tangents = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0) if closed else np.gradient(path, axis=0)
    binormals = np.cross(tangents / np.linalg.norm(tangents, axis=1, keepdims=True), normal)
    angles = 2.0 * np.pi * np.arange(TUBE_SEGMENTS) / TUBE_SEGMENTS
    rings = path[:, None] + radius * (np.cos(angles)[:, None] * binormals[:, None] + np.sin(angles)[:, None] * normal)
    return rings.reshape(-1, 3), _grid(len(path), TUBE_SEGMENTS, closed=closed)


def _grid(rows: int, columns: int, *, closed: bool) -> list[Any]:
    faces = []
    for row in range(rows if closed else rows - 1):
        for column in range(columns):
            a, b = row * columns + column, row * columns + (column + 1) % columns
            c, d = ((row + 1) % rows) * columns + column, ((row + 1) % rows) * columns + (column + 1) % columns
            faces += [[a, b, d], [a, d, c]]
    return faces


def renderer(side_px: int) -> MeshRenderer:
    """Return the renderer of a mug, viewed from slightly above, whose handle turns about its axis."""
    angles = 2.0 * np.pi * np.arange(WALL_SEGMENTS) / WALL_SEGMENTS
    rings = [
        np.stack([np.cos(angles), np.full(WALL_SEGMENTS, y), np.sin(angles)], axis=1) for y in np.linspace(-1.1, 1.1, 6)
    ]
    wall = np.stack(rings).reshape(-1, 3)
    bend = np.pi * (np.linspace(0.0, 1.0, 17) - 0.5)
    arc = np.stack([0.95 + 0.65 * np.cos(bend), 0.75 * np.sin(bend), 0.0 * bend], axis=1)
    handle, handle_faces = tube(arc, np.array([0.0, 0.0, 1.0]), 0.13)
    clay = (0.25, 0.45, 0.75)
    meshes = {
        "wall": Mesh(wall, _grid(6, WALL_SEGMENTS, closed=False), colours=clay),
        "handle": Mesh(handle, handle_faces, colours=clay),
    }
    rotation = {"turn": Rotate("handle", (0, 1, 0), (0, 0, 0))}
    light = Light(position=(3.0, 4.0, 5.0))
    return MeshRenderer(side_px, side_px, meshes, Camera((0.0, 1.2, 6.0)), rotation, lights={"lamp": light})


def main(words: Sequence[str] | None = None) -> None:
    """Fit from every start by every method, print the results, and draw the first."""
    parser = argparse.ArgumentParser(
        prog="python -m examples.paper mug", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one start, small, fewer steps")
    parser.add_argument("--starts", type=int, default=5, help="number of starts (default: 5)")
    parser.add_argument("--out", type=Path, default=Path("out/mug"), help="folder for the picture")
    parser.add_argument("--json", action="store_true", help="print one line of JSON for each fit")
    options = parser.parse_args(words)
    if options.starts < 1:
        parser.error("--starts must be 1 or more")
    check_out(parser, options.out)
    side_px, steps, count = (32, 80, 1) if options.quick else (64, 120, options.starts)
    plain = renderer(side_px)
    target = plain.render({"turn": torch.tensor(TRUE_ANGLE, dtype=torch.float64)})
    blurred = BlurredRenderer(plain, SIGMA, final_sigma=2.0, pairs=2)
    methods: dict[str, tuple[Renderer, Objective]] = {
        "loi": (plain, LOIObjective(target)),
        "PRDPT (pixels)": (blurred, PixelL2(target)),
        "loi + PRDPT": (blurred, LOIObjective(target)),
    }
    if not options.json:
        print("| method | start | end | found | verdict |\n| --- | --- | --- | --- | --- |")
    pictures: dict[str, Any] = {}
    for number, start in enumerate(np.linspace(*HIDDEN_ANGLES, count + 2)[1:-1]):
        pictures.setdefault("start", plain.render({"turn": torch.tensor(start)}))
        for name, (images, objective) in methods.items():
            result = fit(
                images, objective, steps=steps, learning_rate=RATE, seed=number, optimise={"turn": Free(float(start))}
            )
            angle = (float(result.params["turn"]) + 180.0) % 360.0 - 180.0
            succeeds = abs(angle - TRUE_ANGLE) < TOLERANCE
            verdict = result.diagnosis.verdict if result.diagnosis else ""
            pictures.setdefault(name, plain.render(result.params))
            if options.json:
                fields = {"method": name, "start": float(start), "end": angle, "found": succeeds, "verdict": verdict}
                print(json.dumps(fields), flush=True)
            else:
                print(f"| {name} | {start:.0f}° | {angle:.1f}° | {succeeds} | {verdict} |", flush=True)
    pictures["target"] = target
    write_bytes(options.out / "mug.png", row_of({name: _displayed(image) for name, image in pictures.items()}))


def _displayed(image: torch.Tensor) -> Image.Image:
    return shown_as(np.clip(image.detach().numpy(), 0.0, 1.0) ** GAMMA)


if __name__ == "__main__":
    main()
