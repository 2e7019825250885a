"""What drawing meshes costs, and how true it is, beside DEODR: ``python -m benchmarks.meshes`` from the root.

Image and gradients by all vertices, medians of several, the two in turns. DEODR blends outlines over a pixel outside of
them; ours cover exact areas. *Wobble* is by how much the sum over an image of one colour changes as the object moves
between pixels, of the sum; *bias* is how far the gradient by a translation, of a random smooth sum over the image, is
from the slope of the same sum over an image of 16 times as many samples along each side, of that slope.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
import torch

from examples.adapters.deodr_mesh import DeodrMesh
from loi_torch.mesh import Camera, Light, Mesh, draw, sphere

SIDE: Final = 128
FINE: Final = 16
DISTANCE: Final = 3.0
TURNS: Final = 9
Draw = Callable[[np.ndarray[Any, Any], int, np.ndarray[Any, Any] | None], tuple[Any, Any]]


def camera() -> Camera:
    """Like DEODR's in the example: at the origin, looking along z, with y downwards."""
    return Camera((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), up=(0.0, -1.0, 0.0), fov=45.0)


def ours(mesh: Mesh) -> Draw:
    """The image of a mesh moved to a place, and the gradient by that place, or by vertices that DEODR has none for."""

    def drawn(place: Any, side: int, weights: Any) -> tuple[Any, Any]:
        leaf = torch.tensor(place, dtype=torch.float64, requires_grad=weights is not None)
        image = draw([replace(mesh, vertices=mesh.vertices + leaf)], camera(), side, side)
        if weights is None:
            return image.detach().numpy(), None
        return image.detach().numpy(), torch.autograd.grad(image, leaf, torch.from_numpy(weights))[0].numpy()

    return drawn


def deodr(mesh: Mesh) -> Draw:
    """The same by DEODR."""
    colours = mesh.colours.expand(len(mesh.vertices), 3).numpy()
    made: dict[int, DeodrMesh] = {}

    def drawn(place: Any, side: int, weights: Any) -> tuple[Any, Any]:
        if side not in made:
            made[side] = DeodrMesh(side, side, mesh.vertices.numpy(), mesh.faces, colours)
        params = made[side].parameters() | {"translation": np.asarray(place, dtype=np.float64)}
        image, pullback = made[side].render_vjp(params)
        return image, None if weights is None else pullback(weights)["translation"]

    return drawn


def smooth_weights(side: int) -> np.ndarray[Any, Any]:
    """A random sum over the image whose weights change over a sixth of it."""
    coarse = torch.from_numpy(np.random.default_rng(0).normal(size=(1, 3, 6, 6)))
    return torch.nn.functional.interpolate(coarse, (side, side), mode="bicubic")[0].movedim(0, 2).contiguous().numpy()


def milliseconds(calls: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Median times, the calls in turns."""
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(TURNS + 1):
        for name, call in calls.items():
            started = time.perf_counter()
            call()
            if turn:
                taken[name].append(1e3 * (time.perf_counter() - started))
    return {name: statistics.median(one) for name, one in taken.items()}


def wobble(drawn: Draw) -> float:
    """Of the sum over the image, as the object moves by up to a pixel."""
    rng = np.random.default_rng(1)
    places = [np.array([*rng.uniform(-0.01, 0.01, 2), DISTANCE]) for _ in range(20)]
    sums = [float(np.sum(drawn(place, 32, None)[0])) for place in places]
    return (max(sums) - min(sums)) / float(np.mean(sums))


def bias(drawn: Draw) -> float:
    """Of the gradient at 32 pixels a side, against slopes of a fine image."""
    side, place, step = 32, np.array([0.11, -0.07, DISTANCE]), 1e-3
    weights = smooth_weights(side)
    gradient = np.asarray(drawn(place, side, weights)[1])[:2]
    fine = np.repeat(np.repeat(weights, FINE, axis=0), FINE, axis=1) / FINE**2
    slopes = []
    for axis in np.eye(3)[:2]:
        ahead, behind = (drawn(place + sign * step * axis, side * FINE, None)[0] for sign in (1.0, -1.0))
        slopes.append(float(np.sum((ahead - behind) * fine)) / (2.0 * step))
    return float(np.linalg.norm(gradient - slopes) / np.linalg.norm(slopes))


def main() -> None:
    """Print the tables."""
    white = sphere(0.8, subdivisions=4, colours=(1.0, 1.0, 1.0))
    shaded = replace(white, colours=0.5 + 0.6 * white.vertices, per="vertex")
    print("| sphere, 5,120 triangles | ours | DEODR |\n| --- | --- | --- |")
    weights = smooth_weights(SIDE)
    place = (0.1, -0.05, DISTANCE)
    both = {"ours": ours(shaded), "DEODR": deodr(shaded)}
    times = milliseconds({name: partial(drawn, np.array(place), SIDE, weights) for name, drawn in both.items()})
    print(f"| image and gradient, {SIDE}x{SIDE} | {times['ours']:.1f} ms | {times['DEODR']:.1f} ms |")
    for label, mesh in (("one colour", white), ("colours of vertices", shaded)):
        pair = ours(mesh), deodr(mesh)
        print(f"| wobble, {label} | {wobble(pair[0]):.1e} | {wobble(pair[1]):.1e} |")
        print(f"| bias, {label} | {bias(pair[0]):.1e} | {bias(pair[1]):.1e} |")
    print("\n| ours, lit, image and gradients by all vertices | |\n| --- | --- |")
    lights = [Light()]

    def lit(mesh: Mesh, side: int, views: int = 1) -> float:
        around = [Camera((4.0 * np.sin(k), 1.0, 4.0 * np.cos(k))) for k in range(views)]

        def call() -> None:
            leaf = mesh.vertices.clone().requires_grad_()
            moved = replace(mesh, vertices=leaf)
            total = sum(draw([moved], one, side, side, lights=lights).sum() for one in around)
            torch.autograd.grad(total, leaf)  # type: ignore[arg-type]  # a tensor

        return milliseconds({"one": call})["one"]

    meshes = {k: sphere(subdivisions=k) for k in (2, 3, 4, 5, 6)}
    for k, side, views in ((4, 128, 1), (4, 128, 6), (2, 256, 1), (3, 256, 1), (4, 256, 1), (5, 256, 1), (6, 256, 1)):
        taken = lit(meshes[k], side, views)
        print(f"| {20 * 4**k:,} triangles, {side}x{side}, {views} view{'s'[: views > 1]} | {taken:.0f} ms |")
    for side in (64, 128, 256, 512):
        print(f"| 81,920 triangles, {side}x{side} | {lit(meshes[6], side):.0f} ms |", flush=True)


if __name__ == "__main__":
    main()
