"""Time and exactness of meshes beside DEODR: ``python -m benchmarks.meshes`` from the root.

Times are medians of an image with its gradients with respect to all vertices, the two renderers in turns. DEODR blends
outlines over one pixel outside of them; ours cover exact areas. *Wobble* is the relative change of the sum over an
image of one colour as the object moves between pixels. *Bias* is the relative error of the gradient of a random smooth
sum over the image, with respect to a translation, against differences of an image with 16 times as many samples along
each side.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Final, TypeAlias

import numpy as np
import torch

from examples.adapters.deodr_mesh import DeodrMesh
from loi_torch.mesh import Camera, Light, Mesh, draw, sphere

SIDE_PX: Final = 128
COARSE_SIDE_PX: Final = 32
FINE_FACTOR: Final = 16
DISTANCE: Final = 3.0
REPEATS: Final = 9
STEP: Final = 1e-3  # of differences, in world units
RenderTranslated: TypeAlias = Callable[[np.ndarray[Any, Any], int, np.ndarray[Any, Any] | None], tuple[Any, Any]]


def camera() -> Camera:
    """Return a camera as DEODR's in the example: at the origin, looking along z, with y downwards."""
    return Camera((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), up=(0.0, -1.0, 0.0), fov=45.0)


def our_renderer(mesh: Mesh) -> RenderTranslated:
    """Return a function from a translation, a side in pixels and weights to the image and the gradient."""

    def render(translation: Any, side_px: int, weights: Any) -> tuple[Any, Any]:
        leaf = torch.tensor(translation, dtype=torch.float64, requires_grad=weights is not None)
        image = draw([replace(mesh, vertices=mesh.vertices + leaf)], camera(), side_px, side_px)
        if weights is None:
            return image.detach().numpy(), None
        return image.detach().numpy(), torch.autograd.grad(image, leaf, torch.from_numpy(weights))[0].numpy()

    return render


def deodr_renderer(mesh: Mesh) -> RenderTranslated:
    """Return the same function for DEODR."""
    colours = mesh.colours.expand(len(mesh.vertices), 3).numpy()
    renderers: dict[int, DeodrMesh] = {}

    def render(translation: Any, side_px: int, weights: Any) -> tuple[Any, Any]:
        if side_px not in renderers:
            renderers[side_px] = DeodrMesh(side_px, side_px, mesh.vertices.numpy(), mesh.faces, colours)
        params = renderers[side_px].parameters() | {"translation": np.asarray(translation, dtype=np.float64)}
        image, pullback = renderers[side_px].render_vjp(params)
        return image, None if weights is None else pullback(weights)["translation"]

    return render


def smooth_weights(side_px: int) -> np.ndarray[Any, Any]:
    """Return random weights of an image that change over a sixth of its side."""
    coarse = torch.from_numpy(np.random.default_rng(0).normal(size=(1, 3, 6, 6)))
    weights = torch.nn.functional.interpolate(coarse, (side_px, side_px), mode="bicubic")[0]
    return weights.movedim(0, 2).contiguous().numpy()


def milliseconds(calls: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Return the median time of each call, taken in turns."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for repeat in range(REPEATS + 1):
        for name, call in calls.items():
            started = time.perf_counter()
            call()
            if repeat:  # the first call compiles
                times[name].append(1e3 * (time.perf_counter() - started))
    return {name: statistics.median(values) for name, values in times.items()}


def wobble(render: RenderTranslated) -> float:
    """Return the relative change of the sum over the image as the object moves by up to a pixel."""
    rng = np.random.default_rng(1)
    translations = [np.array([*rng.uniform(-0.01, 0.01, 2), DISTANCE]) for _ in range(20)]
    sums = [float(np.sum(render(translation, COARSE_SIDE_PX, None)[0])) for translation in translations]
    return (max(sums) - min(sums)) / float(np.mean(sums))


def bias(render: RenderTranslated) -> float:
    """Return the relative error of the gradient against differences of a fine image."""
    translation = np.array([0.11, -0.07, DISTANCE])
    weights = smooth_weights(COARSE_SIDE_PX)
    gradient = np.asarray(render(translation, COARSE_SIDE_PX, weights)[1])[:2]
    fine_weights = np.repeat(np.repeat(weights, FINE_FACTOR, axis=0), FINE_FACTOR, axis=1) / FINE_FACTOR**2
    fine_side = COARSE_SIDE_PX * FINE_FACTOR
    differences = []
    for axis in np.eye(3)[:2]:
        plus, minus = (render(translation + sign * STEP * axis, fine_side, None)[0] for sign in (1.0, -1.0))
        differences.append(float(np.sum((plus - minus) * fine_weights)) / (2.0 * STEP))
    return float(np.linalg.norm(gradient - differences) / np.linalg.norm(differences))


def lit_milliseconds(mesh: Mesh, side_px: int, views: int = 1) -> float:
    """Return the time of lit images of several views, with the gradient with respect to all vertices."""
    cameras = [Camera((4.0 * np.sin(k), 1.0, 4.0 * np.cos(k))) for k in range(views)]

    def call() -> None:
        leaf = mesh.vertices.clone().requires_grad_()
        moved = replace(mesh, vertices=leaf)
        total = sum(draw([moved], view, side_px, side_px, lights=[Light()]).sum() for view in cameras)
        torch.autograd.grad(total, leaf)  # type: ignore[arg-type]  # a tensor

    return milliseconds({"lit": call})["lit"]


def main() -> None:
    """Print the tables."""
    white = sphere(0.8, subdivisions=4, colours=(1.0, 1.0, 1.0))
    shaded = replace(white, colours=0.5 + 0.6 * white.vertices, per="vertex")
    print("| sphere, 5,120 triangles | ours | DEODR |\n| --- | --- | --- |")
    weights, translation = smooth_weights(SIDE_PX), np.array([0.1, -0.05, DISTANCE])
    renderers = {"ours": our_renderer(shaded), "DEODR": deodr_renderer(shaded)}
    times = milliseconds({name: partial(r, translation, SIDE_PX, weights) for name, r in renderers.items()})
    print(f"| image and gradient, {SIDE_PX}x{SIDE_PX} | {times['ours']:.1f} ms | {times['DEODR']:.1f} ms |")
    for label, mesh in (("one colour", white), ("colours of vertices", shaded)):
        pair = our_renderer(mesh), deodr_renderer(mesh)
        print(f"| wobble, {label} | {wobble(pair[0]):.1e} | {wobble(pair[1]):.1e} |")
        print(f"| bias, {label} | {bias(pair[0]):.1e} | {bias(pair[1]):.1e} |")
    print("\n| ours, lit, image and gradients of all vertices | |\n| --- | --- |")
    meshes = {k: sphere(subdivisions=k) for k in (2, 3, 4, 5, 6)}
    cases = ((4, 128, 1), (4, 128, 6), (2, 256, 1), (3, 256, 1), (4, 256, 1), (5, 256, 1), (6, 256, 1))
    for level, side_px, views in cases:
        duration = lit_milliseconds(meshes[level], side_px, views)
        print(
            f"| {20 * 4**level:,} triangles, {side_px}x{side_px}, {views} view{'s'[: views > 1]} | {duration:.0f} ms |"
        )
    for side_px in (64, 128, 256, 512):
        print(f"| 81,920 triangles, {side_px}x{side_px} | {lit_milliseconds(meshes[6], side_px):.0f} ms |", flush=True)


if __name__ == "__main__":
    main()
