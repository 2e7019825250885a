"""What is to be found in each column, and how well it was."""

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

REFERENCE: Final = 1024  # samples a pixel of the images that are compared at the end
TARGET_SEED: Final = 10**6


@dataclass(frozen=True)
class Column:
    """One column of the table.

    Attributes
    ----------
    name : str
    seeds : int
        How many starts the table has.
    width : int
        Of the image, in pixels; its height is three quarters of it.
    samples : int
        Per pixel and step, of the image and of each part of its gradient.
    alike : tuple of str
        Things that nothing tells apart, so that any of them may be at the place of any other.
    scene : str
        Of :data:`SCENES`; that of the column's name by default.
    crowded : bool
        Whether many things of many colours move, which throw shadows on each other.
    """

    name: str
    seeds: int = 3
    width: int = 256
    samples: int = 32
    alike: tuple[str, ...] = ()
    scene: str = ""
    crowded: bool = False

    def at(self, seed: int) -> Built:
        """The scene for a seed."""
        return SCENES[self.scene or self.name](self.width, self.height, seed)

    @property
    def height(self) -> int:
        """Of the image, in pixels."""
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
    """One start, with its target.

    Attributes
    ----------
    column : Column
    built : Built
    target : array, shape (H, W, 3)
        Linear RGB, float32, without visible noise.
    """

    column: Column
    built: Built
    target: Any = field(repr=False)

    @classmethod
    def of(cls, column: Column, seed: int) -> Problem:
        """The problem of a column and seed."""
        built = column.at(seed)
        return cls(column, built, _target(column))

    def picture(self, found: Mapping[str, Any], samples: int = REFERENCE) -> Any:
        """The image at some parameters, by default with the very samples of the target: what differs is not noise."""
        return images_of(self.built, samples).render(numbers(found), seed=TARGET_SEED)

    def error(self, found: Mapping[str, Any]) -> float:
        """Mean absolute error of all parameters, units of the scene; what is alike in whichever order is best."""
        truth = self.built.truth
        alike = self.column.alike
        orders = [dict(zip(alike, order, strict=True)) for order in permutations(alike)]
        return min(
            float(np.mean([abs(float(found[name]) - truth[_renamed(name, order)]) for name in truth]))
            for order in orders
        )


@lru_cache
def _target(column: Column) -> Any:
    built = column.at(0)  # whose truth all seeds share
    return images_of(built, REFERENCE).render(numbers(built.truth), seed=TARGET_SEED)


def images_of(built: Built, samples: int) -> MitsubaRenderer:
    """The scene with all its light, for images only."""
    return MitsubaRenderer(
        built.scene, built.parameters, spp=samples, integrator="scene", without_gradient=tuple(built.parameters)
    )


def numbers(values: Mapping[str, Any]) -> Parameters:
    """As parameters of Mitsuba."""
    return {name: np.array(value, dtype=np.float32) for name, value in values.items()}


def _renamed(name: str, order: Mapping[str, str]) -> str:
    thing, letter = name.rsplit("_", 1)
    return f"{order.get(thing, thing)}_{letter}"
