"""Gradients of attached samples: the supported parameters, and a comparison with Mitsuba's gradient."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import mitsuba as mi
import numpy as np

from loi_core.effects import Draws, Frozen
from loi_core.effects.frozen import CLEAR_ERRORS
from loi_mitsuba.effects.traits import group_by_shape
from loi_mitsuba.renderer import MitsubaRenderer, split_seed
from loi_mitsuba.scene.binding import ParameterBinding
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import SceneIndex
from loi_mitsuba.scene.poses import Rotate, Scale
from loi_mitsuba.scene.settings import Settings
from mitsuba_boundaries.attached.dielectrics import AttachedDielectrics, is_attachable_glass
from mitsuba_boundaries.attached.emitters import (
    ROTATION_STEP_DEG,
    SCALE_STEP,
    AttachedEmitters,
    is_attachable_light,
    translation_step,
    visible_points,
)
from mitsuba_boundaries.diagnostics import has_medium
from mitsuba_boundaries.drjit.arrays import Float32Array, Float64Array
from mitsuba_boundaries.geometry.bounds import bounding_box
from mitsuba_boundaries.proxy.light_size import light_position
from mitsuba_boundaries.sensing.frustum import Frustum

__all__ = ["AttachedGradient", "AttachedParameters", "attachable_emitters"]

DRAWS: Final = 4
SILHOUETTE: Final = Settings("direct_projective", max_depth=2, sppc=0)
GLASS_REASON: Final = "it moves clear glass, and attached samples have its gradient, except for edges seen through it"


@dataclass(frozen=True)
class AttachedParameters:
    """The parameters that attached samples can differentiate.

    Attributes
    ----------
    lights : dict of mi.Shape or mi.Emitter
        The light that each parameter moves.
    glass : dict of mi.Shape
        The shape of clear glass that each parameter moves.
    """

    lights: Mapping[str, Any]
    glass: Mapping[str, Any]

    @classmethod
    def of(
        cls, index: SceneIndex, targets: Mapping[str, ParameterTarget], sensor: Any, *, lights: bool, glass: bool
    ) -> AttachedParameters:
        """Find the parameters of lights, of glass, or of both among `targets`."""
        return cls(
            attachable_emitters(index, targets) if lights else {},
            _attachable_dielectrics(index, targets, sensor) if glass else {},
        )

    @property
    def without_gradient(self) -> frozenset[str]:
        """Parameters of point lights and glass, which have no usable gradient in Mitsuba."""
        points = (name for name, light in self.lights.items() if not isinstance(light, mi.Shape))
        return frozenset((*points, *self.glass))

    def reason_of(self, name: str) -> str:
        """Return the plan's reason for the attached gradient of a parameter."""
        if name in self.glass:
            return GLASS_REASON
        light = self.lights[name]
        light_type = light.class_name() if isinstance(light, mi.Emitter) else "area light"
        return f"it moves the {light_type}, and attached samples of its direct light have the gradient"


def attachable_emitters(index: SceneIndex, targets: Mapping[str, ParameterTarget]) -> dict[str, Any]:
    """Return the parameters that move a light with attached samples, with the light.

    There are none in a scene with a medium or polarised light.
    """
    if mi.is_polarized or has_medium(index.scene):
        return {}
    lights = {
        name: index.positioned_light(target) if isinstance(target, str) else index.find_movable(target.shape)[1]
        for name, target in targets.items()
    }
    return {
        name: light
        for name, light in lights.items()
        if is_attachable_light(light, index.scene, scaled=isinstance(targets[name], Scale))
    }


def _attachable_dielectrics(index: SceneIndex, targets: Mapping[str, ParameterTarget], sensor: Any) -> dict[str, Any]:
    """Return the parameters that move clear glass with attached samples, with its shape.

    There are none if colours are not RGB, if there is a medium, or without a perspective camera that sees all emitters.
    """
    perspective = sensor.class_name() == "PerspectiveCamera"
    if not mi.is_rgb or mi.is_polarized or not perspective or has_medium(index.scene):
        return {}
    if getattr(index.scene.integrator(), "hide_emitters", False):
        return {}
    shapes = {}
    for name, target in targets.items():
        if isinstance(target, str):
            parameter = index.get(target)
            shape = None if parameter is None or parameter.problem else index.moved_shape(parameter)
        else:
            shape = index.find_movable(target.shape)[1]
        if not isinstance(shape, mi.Shape) or shape not in index.scene.shapes():
            continue
        if is_attachable_glass(shape, rigid=not isinstance(target, (str, Scale))):
            shapes[name] = shape
    return shapes


class AttachedGradient:
    """The gradient of attached emitter samples and attached samples on dielectrics.

    Parameters
    ----------
    renderer : MitsubaRenderer
        Renderer of the scene, which has its initial values.
    parameters : AttachedParameters
    samples : int
        Samples per pixel.
    """

    def __init__(self, renderer: MitsubaRenderer, parameters: AttachedParameters, samples: int) -> None:
        self._renderer = renderer
        self._parameters = parameters
        self._silhouette = replace(SILHOUETTE, sppp=samples)
        scene, sensor, targets = renderer.scene, renderer.sensor, renderer.targets
        points = visible_points(scene, sensor)
        steps = {name: _step(targets[name], light, points) for name, light in parameters.lights.items()}
        binding = ParameterBinding(renderer.names, targets, tuple(targets))
        self._emitters = AttachedEmitters(scene, sensor, binding, parameters.lights, steps, samples)
        self._dielectrics = AttachedDielectrics(scene, sensor, binding, samples)

    def vjp(
        self, params: Mapping[str, Any], cotangent: Any, *, names: Iterable[str], seed: int = 0
    ) -> dict[str, Float32Array]:
        """Return the gradients of the parameters `names` for a cotangent of the image, shape (H, W, C)."""
        wrt = tuple(names)
        lights = [name for name in wrt if name in self._parameters.lights]
        glass = [name for name in wrt if name in self._parameters.glass]
        gradient_seed = split_seed(seed)[1]
        gradient: dict[str, Float32Array] = {}
        if lights:
            gradient |= self._emitters.vjp(params, cotangent, names=lights, seed=gradient_seed)
            frustum, shapes = Frustum(self._renderer.sensor), self._parameters.lights
            visible = [name for name in lights if isinstance(shapes[name], mi.Shape) and frustum.overlaps(shapes[name])]
            if visible:
                renderer = self._renderer.with_integrator(self._silhouette.load(), wrt=visible)
                silhouettes = renderer.vjp(params, cotangent, seed=seed)
                gradient |= {name: gradient[name] + silhouettes[name] for name in visible}
        if glass:
            gradient |= self._dielectrics.vjp(params, cotangent, names=glass, seed=gradient_seed)
        return gradient

    def vanishing(
        self, params: Mapping[str, Any], cotangent: Any, *, names: Sequence[str], seed: int = 0
    ) -> frozenset[str]:
        """Return the parameters of those lights and shapes whose gradient is exactly 0 in a few draws."""
        if not names:
            return frozenset()
        draws = self._draws(params, cotangent, names, seed)
        return frozenset(name for group in self._groups(names) if all(map(draws.is_zero, group)) for name in group)

    def preferred(
        self,
        mitsuba: MitsubaRenderer,
        params: Mapping[str, Any],
        cotangent: Any,
        *,
        names: Sequence[str],
        seed: int = 0,
    ) -> frozenset[str]:
        """Return the parameters whose attached gradient is significant and agrees with Mitsuba's within noise.

        The gradient of `mitsuba` contains all light. Where it disagrees, the attached gradient lacks something.
        """
        draws = self._draws(params, cotangent, names, seed)
        significant = frozenset(names) - Frozen.of(draws, self._groups(names)).reasons.keys()
        selected = tuple(name for name in names if name in significant)
        if not selected:
            return significant
        pulled = [mitsuba.vjp(params, cotangent, seed=seed + k) for k in range(DRAWS)]
        complete = Draws.of([{name: gradient[name] for name in selected} for gradient in pulled])
        missing = complete.minus(draws)
        disagreeing = {name for name in selected if missing.is_significant(name, CLEAR_ERRORS)}
        return frozenset(name for group in self._groups(selected) for name in group if not disagreeing & set(group))

    def _draws(self, params: Mapping[str, Any], cotangent: Any, names: Sequence[str], seed: int) -> Draws:
        return Draws.of([self.vjp(params, cotangent, names=names, seed=seed + k) for k in range(DRAWS)])

    def _groups(self, names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
        """Group the parameters of one light or shape."""
        moved = {**self._parameters.lights, **self._parameters.glass}
        return group_by_shape(names, {name: moved[name] for name in names})


def _step(target: ParameterTarget, light: Any, points: Float64Array) -> float:
    """Return the step of the central difference of a light's visibility, in the parameter's unit."""
    if isinstance(target, Rotate):
        return ROTATION_STEP_DEG
    if isinstance(target, Scale):
        return SCALE_STEP
    position = bounding_box(light).mean(axis=0) if isinstance(light, mi.Shape) else light_position(light)
    return translation_step(light, np.asarray(position), points)
