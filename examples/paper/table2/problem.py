"""The problem of each column, and the error of a solution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import permutations
from typing import Any, Final

import numpy as np

from examples.paper.table2.scenes import SCENES, Built
from loi_core.renderers.contract import Parameters
from loi_mitsuba import MitsubaRenderer

__all__ = ["COLUMNS", "Column", "Problem", "images_of", "numbers"]

REFERENCE_SAMPLES: Final = 1024  # per pixel, of the target and of the final image
TARGET_SEED: Final = 10**6


@dataclass(frozen=True)
class Column:
    """One column of the table.

    Attributes
    ----------
    name : str
    seeds : int
        Number of starts in the table.
    width : int
        Width of the image, in pixels; the height is three quarters of the width.
    samples : int
        Samples per pixel and step, for the image and for each term of its gradient.
    alike : tuple of str
        Indistinguishable objects, which may exchange positions.
    scene : str
        Name in :data:`SCENES`; the name of the column by default.
    crowded : bool
        Whether many objects of many colours move, and cast shadows on each other.
    """

    name: str
    seeds: int = 3
    width: int = 256
    samples: int = 32
    alike: tuple[str, ...] = ()
    scene: str = ""
    crowded: bool = False

    def at(self, seed: int) -> Built:
        """Return the scene for a seed."""
        return SCENES[self.scene or self.name](self.width, self.height, seed)

    @property
    def height(self) -> int:
        """Height of the image, in pixels."""
        return 3 * self.width // 4


COLUMNS: Final = (
    Column("Shadow"),
    Column("Shadow Mini"),
    Column("Caustics and Lights", alike=("ball_1", "ball_2")),
    Column("Sort", crowded=True),
    Column("Envlight"),
)


@dataclass(frozen=True)
class Problem:
    """One start and its target.

    Attributes
    ----------
    column : Column
    built : Built
    target : array, shape (H, W, 3)
        Image in linear RGB, float32, without visible noise.
    """

    column: Column
    built: Built
    target: Any = field(repr=False)

    @classmethod
    def of(cls, column: Column, seed: int) -> Problem:
        """Return the problem of a column and seed."""
        built = column.at(seed)
        return cls(column, built, _target(column))

    def picture(self, values: Mapping[str, Any], samples: int = REFERENCE_SAMPLES) -> Any:
        """Return the image at some parameters, by default with the samples of the target, so that noise cancels."""
        return images_of(self.built, samples).render(numbers(values), seed=TARGET_SEED)

    def error(self, values: Mapping[str, Any]) -> float:
        """Return the mean absolute error of all parameters, in world units, for the best order of equal objects."""
        truth = self.built.truth
        names = self.column.alike
        orders = [dict(zip(names, order, strict=True)) for order in permutations(names)]
        return min(
            float(np.mean([abs(float(values[name]) - truth[_renamed(name, order)]) for name in truth]))
            for order in orders
        )


@lru_cache
def _target(column: Column) -> Any:
    built = column.at(0)  # all seeds share the truth
    return images_of(built, REFERENCE_SAMPLES).render(numbers(built.truth), seed=TARGET_SEED)


def images_of(built: Built, samples: int) -> MitsubaRenderer:
    """Return a renderer of the scene with all light paths, without gradients."""
    return MitsubaRenderer(
        built.scene, built.parameters, spp=samples, integrator="scene", without_gradient=tuple(built.parameters)
    )


def numbers(values: Mapping[str, Any]) -> Parameters:
    """Return values as float32 parameters of Mitsuba."""
    return {name: np.array(value, dtype=np.float32) for name, value in values.items()}


def _renamed(name: str, order: Mapping[str, str]) -> str:
    shape, axis = name.rsplit("_", 1)
    return f"{order.get(shape, shape)}_{axis}"
