"""How far each accuracy is from exact: ``python -m benchmarks.accuracy [SIDE ...] [PRESET ...]``, from the root.

For square images of each side, in float64: the worst relative error of the gradient (2-norm) over the kinds of images
of ``tests/contents.py`` and some seeds, by preset, as a share of what was promised; and of how many images the
plan could not vouch for its accuracy, so that they were compared exactly. "Ordinary" are the kinds that plans are made
for, "hard" are periodic images and such as nearly equal their reference. Prints a Markdown table; the exit code is 1 if
a promise is broken.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core import LOIObjective, ScaleSpace
from tests.contents import CONTENTS, HARD

SIDES: Final = (16, 32, 64, 128, 256, 512, 1024, 2048)
ACCURACIES: Final[dict[str, float]] = {"balanced": 1e-2, "fast": 5e-2}
PRESETS: Final[dict[str, Callable[[int], ScaleSpace]]] = {
    "vector": lambda _: ScaleSpace.paper("vector"),
    "path": lambda _: ScaleSpace.paper("path"),
    "raster": lambda _: ScaleSpace.paper("raster"),
    "for_image": lambda side: ScaleSpace.for_image(side, side),
    "released": lambda _: ScaleSpace.released((1, 5), (1, 5, 15, 45), 8, 121),
}


KINDS: Final = {"ordinary": CONTENTS, "hard": HARD}


def seeds_for(side: int) -> range:
    """Fewer where each takes long: the more pixels, the less chance decides."""
    return range(max(2, min(20, 2048 // side)))


@dataclass
class Found:
    """What came of one accuracy on one group of kinds."""

    cases: int = 0
    exact: int = 0
    broken: int = 0
    worst: float = 0.0
    kind: str = ""

    def add(self, kind: str, error: float, *, exact: bool) -> None:
        """Count a case with an error in units of its tolerance."""
        self.cases += 1
        self.exact += exact
        self.broken += error > 1.0
        if error >= self.worst:
            self.worst, self.kind = error, kind


def found_for(side: int, scales: ScaleSpace) -> dict[tuple[str, str], Found]:
    """By group of kinds and accuracy."""
    found = {(group, accuracy): Found() for group in KINDS for accuracy in ACCURACIES}
    for group, kinds in KINDS.items():
        for kind, make in kinds.items():
            for seed in seeds_for(side):
                image, reference = make((side, side, 1), np.random.default_rng(seed))
                exact = LOIObjective(reference, scales).value_and_grad(image)[1]
                size = float(np.linalg.norm(exact))
                for accuracy, tolerance in ACCURACIES.items():
                    gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)[1]
                    error = float(np.linalg.norm(gradient - exact)) / (size or 1.0) / tolerance
                    found[group, accuracy].add(kind, error, exact=np.array_equal(gradient, exact))
    return found


def main() -> int:
    """Print the table, a row as soon as it is known."""
    sides = [int(argument) for argument in sys.argv[1:] if argument.isdigit()] or SIDES
    presets = [argument for argument in sys.argv[1:] if argument in PRESETS] or PRESETS
    cases = broken = 0
    heads = [f"{accuracy}: error / promise | worst on | exact" for accuracy in ACCURACIES]
    print("| side | preset | images | " + " | ".join(heads) + " |")
    print("| --- | --- | --- |" + " --- | --- | --- |" * len(ACCURACIES))
    for side in sides:
        for name in presets:
            found = found_for(side, PRESETS[name](side))
            for group in KINDS:
                each = [found[group, accuracy] for accuracy in ACCURACIES]
                cells = " | ".join(f"{one.worst:.2f} | {one.kind} | {one.exact / one.cases:.0%}" for one in each)
                print(f"| {side} | {name} | {group} | {cells} |", flush=True)
                cases += sum(one.cases for one in each)
                broken += sum(one.broken for one in each)
    print(f"\n{cases} cases, {broken} broken promises")
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
