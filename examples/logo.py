"""A logo of three shapes, found again in its PNG from starts where no shape meets its own place.

python -m examples.logo            # three starts; writes docs/images/logo.png
python -m examples.logo --quick    # one start, half the size, for a test
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from examples.plots import new_figure
from loi_core import FitResult, Free, LOIObjective, ScaleSpace, fit
from loi_core.io.images import read_image, write_png
from loi_core.objectives import ImageObjective, PixelL2
from loi_torch.vector import Circle, Rectangle, Shape, Vector
from loi_torch.vector import Path as Curves

LOGO: Final = Path(__file__).with_name("logo.svg")
PLOT: Final = Path(__file__).parents[1] / "docs" / "images" / "logo.png"
FULL: Final = 96  # pixels
STEPS: Final = 200
STARTS: Final = (  # of ring, leaf and brick, at full size
    ((22.0, 24.0), (72.0, 70.0), (22.0, 60.0)),
    ((24.0, 66.0), (74.0, 26.0), (24.0, 24.0)),
    ((30.0, 70.0), (64.0, 66.0), (34.0, 26.0)),
)
START_ROTATIONS_DEGREES: Final = np.array([0.0, 25.0, -25.0])
START_SIZE_FACTOR: Final = 0.85
RATES: Final = {"sizes": 0.1, "rotations": 2.5, "widths": 0.1}

Host: TypeAlias = np.ndarray[Any, Any]


def search(
    renderer: Vector, objective: ImageObjective[Any], start_positions: Sequence[Sequence[float]], size: int, steps: int
) -> FitResult:
    """Fit positions, sizes, rotations and the stroke's width, from a smaller, rotated and displaced logo."""
    truth = {name: value.numpy() for name, value in renderer.parameters().items()}
    start = {name: START_SIZE_FACTOR * truth[name] for name in ("sizes", "widths")} | {
        "rotations": truth["rotations"] + START_ROTATIONS_DEGREES
    }
    free = {name: Free(initial=value, learning_rate=RATES[name]) for name, value in start.items()}
    scale = size / FULL
    free["positions"] = Free(scale * np.array(start_positions), 0.0, float(size), 2.0 * scale)
    return fit(renderer, objective, steps=steps, learning_rate=1.0, optimise=free)


def worst(renderer: Vector, params: Mapping[str, Any]) -> float:
    """Return the largest distance in pixels between marks of a fitted shape and of its counterpart in the logo."""
    true = renderer.shapes(renderer.parameters())
    return max(_hausdorff(_marks(a), _marks(b)) for a, b in zip(renderer.shapes(params), true, strict=True))


def _marks(shape: Shape) -> Host:
    """Return points that move with all fitted numbers: control points, corners, or both edges of a ring."""
    if isinstance(shape, Curves):
        return np.concatenate([np.asarray(outline.points) for outline in shape.outlines])
    if isinstance(shape, Circle):
        reach = np.array([shape.radius - 0.5 * shape.paint.width, shape.radius + 0.5 * shape.paint.width])
        return np.concatenate([np.asarray(shape.centre) + reach[:, None] * np.array(axis) for axis in np.eye(2)])
    assert isinstance(shape, Rectangle)
    angle = np.deg2rad(shape.rotation)
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    corners: Host = np.asarray(shape.centre) + (0.5 * signs * np.asarray(shape.sides)) @ rotation
    return corners


def _hausdorff(first: Host, second: Host) -> float:
    """Return the Hausdorff distance of two sets of points."""
    distances = np.linalg.norm(first[:, None] - second[None], axis=-1)
    return float(max(distances.min(axis=0).max(), distances.min(axis=1).max()))


def plot(pictures: Mapping[str, Host], path: Path) -> None:
    """Draw pictures in a row."""
    figure = new_figure(2.2 * len(pictures), 2.5)
    axes = figure.subplots(1, len(pictures))
    for axis, (title, picture) in zip(axes, pictures.items(), strict=True):
        axis.imshow(np.clip(picture, 0.0, 1.0), interpolation="nearest")
        axis.set(xticks=[], yticks=[])
        axis.set_title(title, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the error of each fit, and write the plot of the last start."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--quick", action="store_true", help="one start, half the size, for a test")
    parser.add_argument("--output", type=Path, default=PLOT, help="where to write the plot")
    options = parser.parse_args(arguments)
    size, starts = (FULL // 2, STARTS[-1:]) if options.quick else (FULL, STARTS)
    renderer = Vector(size, size, svg=LOGO, encoding="srgb")
    with tempfile.TemporaryDirectory() as folder:
        write_png(Path(folder) / "logo.png", renderer.render(renderer.parameters()).numpy())
        target = read_image(Path(folder) / "logo.png")
    objectives: dict[str, ImageObjective[Any]] = {
        "loi": LOIObjective(target, ScaleSpace.for_image(size, size), accuracy="fast"),
        "pixel L2": PixelL2(target),
    }
    print("| start | " + " | ".join(f"{name}, px off" for name in objectives) + " |")
    print("| --- |" + " --- |" * len(objectives))
    for number, start_positions in enumerate(starts, start=1):
        results = {
            name: search(renderer, objective, start_positions, size, STEPS) for name, objective in objectives.items()
        }
        errors = {name: worst(renderer, result.best_params) for name, result in results.items()}
        print(f"| {number} | " + " | ".join(f"{error:.3f}" for error in errors.values()) + " |")
    start = search(renderer, objectives["loi"], starts[-1], size, 1).best_params
    pictures = {"start": renderer.render(start).numpy(), "target": target}
    pictures |= {f"{name}: {errors[name]:.3f} px off": np.asarray(result.image) for name, result in results.items()}
    plot(pictures, options.output)


if __name__ == "__main__":
    main()
