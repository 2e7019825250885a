"""Gradients by outlines and by curves along which shapes go through each other, as a Markdown table.

All shapes shine, so that differences of images are free of noise and nothing else has a gradient. The numbers are
slopes of a sum of pixels with a weight on one side, by where the block is, with their standard errors.

    python -m benchmarks.crossings    # minutes
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import trimesh

from loi_mitsuba import MitsubaRenderer, Translate  # before mitsuba

# isort: split
import drjit as dr
import mitsuba as mi

from benchmarks.edges import mean_and_error, own_slopes
from examples.effects.parts import camera
from loi_core.support.markdown import markdown

__all__ = ["main"]

WIDTH, HEIGHT = 96, 72
AXES: Final = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
STEP: Final = 0.03


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=64, help="per pixel of each part of a gradient (default: 64)")
    parser.add_argument("--draws", type=int, default=6, help="gradients for a mean, at least 2 (default: 6)")
    options = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    with tempfile.TemporaryDirectory() as folder:
        rows = list(_rows(options.samples, options.draws, Path(folder)))
    print("\n".join(markdown(["", "central differences", "ours", "Mitsuba"], rows)))


def _rows(samples: int, draws: int, folder: Path) -> Iterator[list[str]]:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    bump = np.exp(-((columns - 40.0) ** 2 + (rows - 32.0) ** 2) / 300.0)
    weight = np.asarray(bump[..., None] * np.array([1.0, 0.5, -0.5]), dtype=np.float32)
    moves: dict[str, Any] = {name: Translate("block", axis) for name, axis in AXES.items()}
    at = dict.fromkeys(moves, np.float32(0.0))
    for kind, scene in _scenes(folder).items():
        images = MitsubaRenderer(scene, moves, integrator="scene", spp=512, without_gradient=moves)
        renderer = MitsubaRenderer(scene, moves, spp=samples)
        ours = [renderer.vjp(at, weight, seed=seed) for seed in range(draws)]
        theirs = [_own(scene, weight, samples, seed) for seed in range(draws)]
        for name in moves:
            ahead, behind = (images.render(at | {name: np.float32(by)}).astype(np.float64) for by in (STEP, -STEP))
            wanted = float(np.sum((ahead - behind) * weight)) / (2.0 * STEP)
            found = (mean_and_error([float(one[name]) for one in drawn], 1) for drawn in (ours, theirs))
            yield [f"{kind}, {name}", f"{wanted:.1f}", *found]


def _scenes(folder: Path) -> dict[str, dict[str, Any]]:
    place = mi.ScalarTransform4f
    red, blue, grey = (_glow(*colour) for colour in ((0.9, 0.2, 0.1), (0.1, 0.3, 0.9), (0.3, 0.3, 0.3)))
    box, leaning = place().rotate([0, 1, 0], 20).scale(0.7), place().translate([0, 1.2, 0]).rotate([1, 0.3, 0], -40)
    ball: dict[str, Any] = {"type": "sphere", "center": [0, 0.2, 0], "radius": 1.0}
    fine = _sphere(folder / "fine.ply")
    blocks: dict[str, dict[str, Any]] = {
        "ball in the floor": {"block": ball},
        "box in the floor": {"block": {"type": "cube", "to_world": place().translate([0, 0.2, 0]) @ box}},
        "ball in a ball": {
            "block": ball | {"center": [0, 1.5, 0]},
            "other": ball | {"center": [0.9, 1.7, 0.3], "radius": 0.8, **blue},
        },
        "box in a box": {
            "block": {"type": "cube", "to_world": place().translate([0, 1.5, 0]) @ box},
            "other": {
                "type": "cube",
                "to_world": place().translate([0.5, 1.8, 0.4]).rotate([0.3, 1, 0], 50).scale(0.7),
                **blue,
            },
        },
        "card that leans": {"block": {"type": "rectangle", "to_world": leaning}},
        "long card": {"block": {"type": "rectangle", "to_world": leaning.scale([1, 0.5, 1])}},
        "fine mesh, flat": {"block": {"type": "ply", "filename": fine, "face_normals": True, "to_world": leaning}},
    }
    floor = {"type": "rectangle", "to_world": place().rotate([1, 0, 0], -90).scale(50), **grey}
    common: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": camera(WIDTH, HEIGHT, [0, 4, 6], [0, 0.2, 0], 42.0),
        "floor": floor,
    }
    return {kind: common | shapes | {"block": shapes["block"] | red} for kind, shapes in blocks.items()}


def _glow(*colour: float) -> dict[str, Any]:
    return {"emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(colour)}}}


def _sphere(path: Path) -> str:
    """A ball of 1,280 triangles."""
    trimesh.creation.icosphere(3).export(path)
    return str(path)


def _own(scene: dict[str, Any], weight: Any, samples: int, seed: int) -> dict[str, float]:
    """What Mitsuba itself says, by its own `mi.render`."""
    loaded = mi.load_dict(scene)
    entries = mi.traverse(loaded)
    leaves = {name: mi.Float(0.0) for name in AXES}
    dr.enable_grad(list(leaves.values()))
    way = mi.Vector3f(leaves["x"], leaves["y"], leaves["z"])
    if "block.to_world" in entries:
        entries["block.to_world"] = mi.Transform4f().translate(way) @ entries["block.to_world"]
    else:
        start = dr.unravel(mi.Point3f, entries["block.vertex_positions"])
        entries["block.vertex_positions"] = dr.ravel(start + way)
    return own_slopes(loaded, entries, leaves, weight, samples, seed)


if __name__ == "__main__":
    main()
