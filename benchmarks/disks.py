"""Time the disk renderers and their pullbacks: ``python -m benchmarks.disks``, from the root of the repository.

Image and pullback of all parameters, float32 outside and float64 inside, medians of several. Time should grow with the
pixels that disks cover, not with disks times pixels.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

import loi_jax.renderers
import loi_torch.renderers
from loi_core import renderers

MAKERS: Final[dict[str, Callable[..., Any]]] = {
    "NumPy": renderers.Disks,
    "torch": loi_torch.renderers.Disks,
    "JAX, whole canvas": loi_jax.renderers.Disks,
}
SCENES: Final = ((16, 10.0, 128), (64, 5.0, 128), (256, 2.5, 128), (256, 5.0, 128), (1024, 2.5, 256), (1024, 5.0, 256))
REPETITIONS: Final = 7
MAX_WHOLE_CANVAS_DISKS: Final = 64  # largest number of disks for renderers that paint each disk on the whole canvas


def milliseconds(make: Callable[..., Any], count: int, radius: float, size_px: int) -> float:
    """Median time of image and pullback."""
    rng = np.random.default_rng(0)
    disks = make(
        size_px,
        size_px,
        rng.uniform(0, size_px, (count, 2)).tolist(),
        radius,
        rng.uniform(size=(count, 3)).tolist(),
        dtype="float32",
    )
    params = disks.parameters()
    seconds = []
    for _ in range(REPETITIONS + 1):
        started = time.perf_counter()
        image, pullback = disks.render_vjp(params)
        {name: np.asarray(value) for name, value in pullback(image).items()}  # waits for JAX
        seconds.append(time.perf_counter() - started)
    return 1e3 * statistics.median(seconds[1:])


def main() -> None:
    """Print the table."""
    print(f"| disks | radius | size_px | covered, pixels | {' | '.join(MAKERS)} |\n|{' --- |' * (4 + len(MAKERS))}")
    for count, radius, size_px in SCENES:
        cells = [
            ""
            if name.startswith("JAX") and count > MAX_WHOLE_CANVAS_DISKS
            else f"{milliseconds(make, count, radius, size_px):.1f} ms"
            for name, make in MAKERS.items()
        ]
        covered = round(count * np.pi * radius**2)
        print(f"| {count} | {radius:g} | {size_px} | {covered} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
