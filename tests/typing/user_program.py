"""A program of a user with all kinds of public names, which strict type checkers must accept.

It is checked against the installed packages, and run. ``assert_type`` states the expected type of a value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, assert_type

import numpy as np
import numpy.typing as npt

import loi
from loi.renderers import Disks

Image = npt.NDArray[np.float64]


class Brightness:
    """A user-defined renderer: a grey image with its brightness as parameter."""

    def __init__(self, height: int, width: int) -> None:
        self.height, self.width = height, width

    def parameters(self) -> dict[str, Image]:
        return {"level": np.array(0.2)}

    def render(self, params: Mapping[str, Image], *, seed: int = 0) -> Image:
        return np.full((self.height, self.width, 1), float(params["level"]))

    def render_vjp(self, params: Mapping[str, Image], *, seed: int = 0) -> tuple[Image, loi.Pullback]:
        def pullback(cotangent: Image) -> dict[str, Image]:
            return {"level": np.asarray(cotangent.sum())}

        return self.render(params, seed=seed), pullback


class Quartic:
    """A user-defined objective."""

    def value(self, image: Image) -> Image:
        return np.asarray(np.mean((image - 0.6) ** 4), np.float64)

    def value_and_grad(self, image: Image) -> tuple[Image, Image]:
        return self.value(image), np.asarray(4.0 * (image - 0.6) ** 3 / image.size, np.float64)


def compare(image: Image, reference: Image) -> dict[str, float]:
    """Evaluate every objective, as in a user's own loop."""
    scales = loi.ScaleSpace.for_image(*reference.shape[:2])
    assert_type(scales, loi.ScaleSpace)
    assert_type(scales.sigma, tuple[float, ...])
    mask = np.ones(reference.shape[:2])
    objectives: list[loi.Objective] = [
        loi.LOIObjective(reference, scales, "balanced", weights=mask),
        loi.LOIObjective(reference, loi.ScaleSpace(1, (3, 9), 0.125), 0.02, tone=loi.LogTone(peak=1.0)),
        loi.PixelL2(reference),
        loi.GaussianPyramid(reference),
        loi.MSSSIM(reference, levels=1),
    ]
    values: dict[str, float] = {}
    for objective in objectives:
        value, gradient = objective.value_and_grad(image)
        assert gradient.shape == image.shape
        values[repr(objective)] = float(value)
    objective = loi.LOIObjective(reference, scales)
    plan = objective.plan()
    assert_type(plan.error, float)
    assert_type(plan.is_sampled, bool)
    for (alpha, beta, sigma), term in objective.terms(image).items():
        assert_type((alpha, beta, sigma), tuple[float, float, float])
        values[f"{alpha} {beta} {sigma}"] = float(term)
    return values


def recover(start: Image, target: Image) -> float:
    """Fit a disk with the loop of the library and return the best value."""
    renderer = Disks(24, 32, target, 5.0, [[0.9, 0.4, 0.1]])
    reference = renderer.render(renderer.parameters())
    watched: list[float] = []

    def watch(step: loi.FitStep, params: loi.Parameters, image: Any) -> bool:
        assert_type(step.value, float)
        assert_type(step.stage, int)
        watched.append(step.value)
        return len(watched) == 8

    free = {"positions": loi.Free(start, 0.0, 32.0, learning_rate="1.5 px")}
    result = loi.fit(renderer, loi.LOIObjective(reference), steps=10, optimise=free, callback=watch)
    assert_type(result, loi.FitResult)
    assert_type(result.history, list[loi.FitStep])
    assert_type(result.best_value, float)
    assert_type(result.psnr, float | None)
    assert_type(result.diagnosis, loi.Diagnosis | None)
    if result.diagnosis is not None:
        assert_type(result.diagnosis.ok, bool)
        assert_type(result.diagnosis.advice, str)
    assert_type(len(result.history), int)
    assert watched == [step.value for step in result.history]
    return result.best_value


def several_views() -> loi.FitResult:
    """Fit a user-defined renderer with a user-defined objective, and handle errors."""
    views: dict[str, loi.Renderer] = {"left": Brightness(4, 4), "right": Brightness(4, 6)}
    objectives: dict[str, loi.Objective] = {"left": Quartic(), "right": Quartic()}
    try:
        return loi.fit(views, objectives, steps=3, optimise=["level"], learning_rate=0.1, decay="none")
    except loi.FitDivergedError as error:
        assert_type(error, loi.FitDivergedError)
        raise
    except loi.LoiError as error:
        raise SystemExit(str(error)) from error


def own_loop(image: Image, reference: Image) -> int:
    """Descend from far to near in a user's own loop."""
    schedule = loi.FarToNear(2, steps=6)
    stages: Sequence[loi.Objective] = [loi.GaussianPyramid(reference), loi.PixelL2(reference)]
    for _ in range(6):
        value, gradient = stages[schedule.stage].value_and_grad(image)
        image = image - gradient
        schedule.step(float(value))
    assert_type(schedule.stage, int)
    return schedule.stage


def from_file(path: Path) -> tuple[int, ...]:
    """Use a photograph as the reference."""
    target = loi.read_target(path, to="linear")
    assert_type(target, loi.Target)
    objective = loi.LOIObjective(target.image, weights=target.weights)
    return tuple(objective.reference.shape)


def main() -> None:
    """Run the program."""
    rng = np.random.default_rng(0)
    image, reference = rng.random((24, 32, 3)), rng.random((24, 32, 3))
    print(len(compare(image, reference)))
    print(recover(np.array([[20.0, 6.0]]), np.array([[8.0, 16.0]])))
    print(several_views().best_value, own_loop(image, reference))
    print([info.name for info in loi.available_renderers()], loi.__version__)
    renderer: loi.Renderer = loi.load_renderer("disks")(8, 8, [[4.0, 4.0]], 2.0, [[1.0, 1.0, 1.0]])
    print(sorted(renderer.parameters()))


if __name__ == "__main__":
    main()
