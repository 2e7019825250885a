"""How far each accuracy is from exact: ``python -m benchmarks.accuracy [SIDE ...] [PRESET ...]``, from the root.

For square images of each side, in float64: the worst relative error of the gradient (2-norm) over the kinds of images
of ``tests/core/contents.py`` and some seeds, by preset, as a share of what was promised. Prints a Markdown table; the
exit code is 1 if a promise is broken.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Final

import numpy as np

from loi_core import LOIObjective, ScaleSpace
from tests.core.contents import CONTENTS

SIDES: Final = (16, 32, 64, 128, 256, 512, 1024, 2048)
ACCURACIES: Final[dict[str, float]] = {"balanced": 1e-2, "fast": 5e-2}
PRESETS: Final[dict[str, Callable[[int], ScaleSpace]]] = {
    "vector": lambda _: ScaleSpace.paper("vector"),
    "path": lambda _: ScaleSpace.paper("path"),
    "raster": lambda _: ScaleSpace.paper("raster"),
    "for_image": lambda side: ScaleSpace.for_image(side, side),
    "released": lambda _: ScaleSpace.released((1, 5), (1, 5, 15, 45), 8, 121),
}


def seeds_for(side: int) -> range:
    """Fewer where each takes long: the more pixels, the less chance decides."""
    return range(max(1, min(5, 512 // side)))


def worst(side: int, scales: ScaleSpace) -> dict[str, tuple[float, str]]:
    """By accuracy, the largest error in units of its tolerance, and the kind of image."""
    found = dict.fromkeys(ACCURACIES, (0.0, ""))
    for kind, make in CONTENTS.items():
        for seed in seeds_for(side):
            image, reference = make((side, side, 1), np.random.default_rng(seed))
            exact = LOIObjective(reference, scales).value_and_grad(image)[1]
            for accuracy, tolerance in ACCURACIES.items():
                gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)[1]
                error = float(np.linalg.norm(gradient - exact) / np.linalg.norm(exact))
                found[accuracy] = max(found[accuracy], (error / tolerance, kind))
    return found


def main() -> int:
    """Print the table, a row as soon as it is known."""
    sides = [int(argument) for argument in sys.argv[1:] if argument.isdigit()] or SIDES
    presets = [argument for argument in sys.argv[1:] if argument in PRESETS] or PRESETS
    kept = True
    print("| side | preset | " + " | ".join(f"{name}: error / promise | worst on" for name in ACCURACIES) + " |")
    print("| --- | --- |" + " --- | --- |" * len(ACCURACIES))
    for side in sides:
        for name in presets:
            found = worst(side, PRESETS[name](side))
            kept = kept and all(share <= 1.0 for share, _ in found.values())
            cells = " | ".join(f"{share:.2f} | {kind}" for share, kind in found.values())
            print(f"| {side} | {name} | {cells} |", flush=True)
    return int(not kept)


if __name__ == "__main__":
    sys.exit(main())
