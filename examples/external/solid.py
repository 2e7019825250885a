"""Problems in three dimensions: orientations, cameras, views, joints and light from afar."""

from __future__ import annotations

from typing import Final

from examples.external.problem import Problem
from examples.external.solid_arm import ARMS
from examples.external.solid_camera import CAMERAS
from examples.external.solid_cubes import CUBES
from examples.external.solid_duck import DUCKS
from examples.external.solid_light import LIGHTS
from examples.external.solid_views import VIEWS

__all__ = ["SOLIDS"]

SOLIDS: Final[tuple[Problem, ...]] = (*CUBES, *CAMERAS, *VIEWS, *ARMS, *DUCKS, *LIGHTS)
