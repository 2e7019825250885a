"""Measure the error of each accuracy: ``python -m benchmarks.accuracy [SIDE ...] [PRESET ...]``, from the root.

For square images of each side in pixels, in float64: the largest relative error of the gradient (2-norm) over the
contents in ``tests/contents.py`` and some seeds, by preset, as a fraction of the tolerance; and the share of images
that were compared exactly because the estimated error exceeded the tolerance. "Hard" contents are periodic or nearly
equal to their reference; all others are "ordinary". Prints a Markdown table; the exit code
is 1 if an error exceeds its tolerance.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core import LOIObjective, ScaleSpace
from tests.contents import CONTENTS, HARD

SIZES_PX: Final = (16, 32, 64, 128, 256, 512, 1024, 2048)
ACCURACIES: Final[dict[str, float]] = {"balanced": 1e-2, "fast": 5e-2}
PRESETS: Final[dict[str, Callable[[int], ScaleSpace]]] = {
    "vector": lambda _: ScaleSpace.paper("vector"),
    "path": lambda _: ScaleSpace.paper("path"),
    "raster": lambda _: ScaleSpace.paper("raster"),
    "for_image": lambda size_px: ScaleSpace.for_image(size_px, size_px),
    "released": lambda _: ScaleSpace.released((1, 5), (1, 5, 15, 45), 8, 121),
}


GROUPS: Final = {"ordinary": CONTENTS, "hard": HARD}


def seeds_for(size_px: int) -> range:
    """Return fewer seeds for larger images, which take longer and vary less."""
    return range(max(2, min(20, 2048 // size_px)))


@dataclass
class Tally:
    """Errors of one accuracy on one group of contents."""

    cases: int = 0
    exact: int = 0
    broken: int = 0
    worst: float = 0.0
    content: str = ""

    def add(self, content: str, error: float, *, exact: bool) -> None:
        """Count a case with an error in units of its tolerance."""
        self.cases += 1
        self.exact += exact
        self.broken += error > 1.0
        if error >= self.worst:
            self.worst, self.content = error, content


def tallies_for(size_px: int, scales: ScaleSpace) -> dict[tuple[str, str], Tally]:
    """Return the errors by group of contents and accuracy."""
    tallies = {(group, accuracy): Tally() for group in GROUPS for accuracy in ACCURACIES}
    for group, contents in GROUPS.items():
        for content, make in contents.items():
            for seed in seeds_for(size_px):
                image, reference = make((size_px, size_px, 1), np.random.default_rng(seed))
                exact = LOIObjective(reference, scales).value_and_grad(image)[1]
                exact_norm = float(np.linalg.norm(exact))
                for accuracy, tolerance in ACCURACIES.items():
                    gradient = LOIObjective(reference, scales, accuracy).value_and_grad(image)[1]
                    error = float(np.linalg.norm(gradient - exact)) / (exact_norm or 1.0) / tolerance
                    tallies[group, accuracy].add(content, error, exact=np.array_equal(gradient, exact))
    return tallies


def main() -> int:
    """Print the table row by row."""
    sizes = [int(argument) for argument in sys.argv[1:] if argument.isdigit()] or SIZES_PX
    presets = [argument for argument in sys.argv[1:] if argument in PRESETS] or PRESETS
    cases = broken = 0
    heads = [f"{accuracy}: error / promise | worst on | exact" for accuracy in ACCURACIES]
    print("| size_px | preset | images | " + " | ".join(heads) + " |")
    print("| --- | --- | --- |" + " --- | --- | --- |" * len(ACCURACIES))
    for size_px in sizes:
        for name in presets:
            tallies = tallies_for(size_px, PRESETS[name](size_px))
            for group in GROUPS:
                row = [tallies[group, accuracy] for accuracy in ACCURACIES]
                cells = " | ".join(
                    f"{tally.worst:.2f} | {tally.content} | {tally.exact / tally.cases:.0%}" for tally in row
                )
                print(f"| {size_px} | {name} | {group} | {cells} |", flush=True)
                cases += sum(tally.cases for tally in row)
                broken += sum(tally.broken for tally in row)
    print(f"\n{cases} cases, {broken} broken promises")
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
