"""Table 2's *Sort* as flat disks, whose gradient is exact: what the loss does where the renderer is not in its way.

The same 65 places and colours, from the same starts, near and anywhere, at half the size. MAE is in units of the scene,
rates are in pixels of the table's image, and a disk is found within 0.1.

    python -m benchmarks.flat_sort    # three minutes
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

import loi_mitsuba  # noqa: F401  # before mitsuba, of which the scenes are made

# isort: split
import mitsuba as mi

from examples.paper.table2.scenes import SCENES, Built, FloatArray
from loi_core import Free, LOIObjective, fit
from loi_core.pixels.psnr import psnr
from loi_core.renderers import Disks
from loi_core.support.markdown import markdown

__all__ = ["main"]

WIDTH, HEIGHT = 128, 96
ACROSS: Final = 10.4  # units of the scene that the image shows, as the table's does
RADIUS: Final = 0.27
GROUND: Final = (0.3, 0.3, 0.3)
NEAR: Final = 0.1
SEEDS: Final = (0, 1, 2)
NEARBY, ANYWHERE = "Sort", "Sort, anywhere"
CASES: Final = (
    (NEARBY, 1.0, 200, False),
    (NEARBY, 3.0, 200, False),
    (NEARBY, 8.0, 200, True),
    (ANYWHERE, 3.0, 200, True),
    (ANYWHERE, 16.0, 200, True),
    (ANYWHERE, 16.0, 200, False),
    (ANYWHERE, 8.0, 500, True),
    (ANYWHERE, 8.0, 500, False),
)


def main() -> None:
    """Print the table."""
    mi.set_variant("llvm_ad_rgb")
    rows = []
    for scene, rate, steps, apart in CASES:
        found = np.array(
            [_fitted(SCENES[scene](2 * WIDTH, 2 * HEIGHT, seed), rate, steps, apart=apart) for seed in SEEDS]
        )
        error, count, decibels = found.mean(axis=0)
        kept = "yes" if apart else "no"
        rows.append([scene, f"{rate:g}", f"{steps}", kept, f"{error:.2f}", f"{count:.0f} of 65", f"{decibels:.1f}"])
    print("\n".join(markdown(["scene", "pixels a step", "steps", "kept apart", "MAE", "found", "PSNR, dB"], rows)))


def _fitted(built: Built, rate: float, steps: int, *, apart: bool) -> tuple[float, int, float]:
    truth, start = _places(built.truth), _places(built.start)
    target = _disks(built, truth, apart=False)
    image = target.render(target.parameters())
    low, high = np.zeros_like(start), np.tile([float(WIDTH), float(HEIGHT)], (len(start), 1))
    result = fit(
        _disks(built, start, apart=apart),
        LOIObjective(image, accuracy="balanced"),
        steps=steps,
        learning_rate=f"{rate * WIDTH / 256} px",
        optimise={"positions": Free(start, low, high)},
    )
    away = (np.asarray(result.params["positions"]) - truth) * ACROSS / WIDTH
    near = int(np.sum(np.hypot(*away.T) < NEAR))
    return float(np.mean(np.abs(away))), near, psnr(np.asarray(result.image), image)


def _disks(built: Built, places: FloatArray, *, apart: bool) -> Disks:
    things = list(dict.fromkeys(name.rsplit("_", 1)[0] for name in built.truth))
    colours: list[Any] = [built.scene[name]["bsdf"]["bsdf"]["reflectance"]["value"] for name in things]
    return Disks(HEIGHT, WIDTH, places, RADIUS * WIDTH / ACROSS, colours, GROUND, confine=apart)


def _places(values: Any) -> FloatArray:
    """In pixels."""
    flat = np.array(list(values.values()), dtype=np.float64).reshape(-1, 2)
    return np.asarray(flat * WIDTH / ACROSS + np.array([WIDTH / 2.0, HEIGHT / 2.0]))


if __name__ == "__main__":
    main()
