"""Build a proxy scene, which has the gradients that the scene itself lacks.

The image is always rendered from the scene itself; only gradients of moving shapes come from the proxy, which differs
as little as possible. Rays cannot hit a point light, but they can hit a small sphere, whose visibility from a surface
changes continuously as an occluder moves. Meshes that store their edges twice are welded, and textures with steps have
ramps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from typing import Any, Final, TypeAlias

import mitsuba as mi
import numpy as np

from mitsuba_boundaries.geometry.mesh import weld_vertices
from mitsuba_boundaries.proxy.light_size import DELTA_LIGHTS, LightContext, delta_lights, light_intensity
from mitsuba_boundaries.proxy.substitutions import (
    LIGHT_ID,
    PROXY_EMITTER_ID,
    ROUGH_BSDFS,
    Substitution,
    nodes_of_shape,
    substitute_light,
    substitute_surface,
    substitute_textures,
    welding,
)

__all__ = ["MovingShapes", "ProxyScene", "ProxySettings", "SceneParser", "build_proxy_scene"]

SceneParser: TypeAlias = Callable[[Any], AbstractContextManager[tuple[Any, Any]]]
"""Opens a dict or a path as the configuration and state of Mitsuba's parser; raises ValueError if Mitsuba fails."""

MAX_SIZE: Final = 0.5  # of lights and roughness


@dataclass(frozen=True)
class ProxySettings:
    """How far the proxy scene may differ from the scene; 0 or False turns a substitution off.

    Attributes
    ----------
    lights : float
        Radius of the sphere in place of a point or spot light over its distance from the moving shapes, at most the
        longest side of the smallest one; half the angle, in radians, of the disk in place of a directional light.
        0 to 0.5. A shadow is blurred by about its distance from the occluder times this value. A smaller light is hit
        by fewer rays, and its gradient is noisier.
    mirrors : float
        Roughness (`alpha`) in place of perfect mirrors, smooth plastic and clear glass. 0 to 0.5. A moving mirror or
        plastic is six times as rough, at most 1, because the noise of its gradient grows steeply as it gets smoother.
    seams : bool
        Whether coincident vertices of moving meshes are welded. Along the seams of a texture, triangles may then show
        another region of it.
    textures : bool
        Whether checkerboards and bitmaps of filter type "nearest" are interpolated on moving shapes.

    Raises
    ------
    ValueError
        If a value is out of range.
    """

    lights: float = 0.1
    mirrors: float = 0.05
    seams: bool = True
    textures: bool = True

    def __post_init__(self) -> None:
        for name in ("lights", "mirrors"):
            value = getattr(self, name)
            if not isinstance(value, Real) or isinstance(value, bool) or not 0.0 <= float(value) <= MAX_SIZE:
                msg = f"`proxy.{name}` must be 0 to {MAX_SIZE:g}, got {value!r}"
                raise ValueError(msg)
        for name in ("seams", "textures"):
            if not isinstance(getattr(self, name), bool):
                msg = f"`proxy.{name}` must be true or false, got {getattr(self, name)!r}"
                raise ValueError(msg)

    @classmethod
    def of(cls, value: object) -> ProxySettings:
        """Return settings as they are, from a table of them, or for None those that replace nothing."""
        if isinstance(value, ProxySettings):
            return value
        if value is None:
            return cls(0.0, 0.0, seams=False, textures=False)
        names = [setting.name for setting in fields(cls)]
        if not isinstance(value, Mapping) or set(value) - set(names):
            msg = f"`proxy` must be a ProxySettings, None, or a table of {', '.join(names)}, got {value!r}"
            raise ValueError(msg)
        return cls(**value)


@dataclass(frozen=True)
class ProxyScene:
    """A proxy scene, its substitutions, and whether it still has BSDFs with delta lobes."""

    scene: Any
    substitutions: tuple[Substitution, ...]
    has_delta_bsdf: bool


@dataclass(frozen=True)
class MovingShapes:
    """Indices of the moving shapes in the scene. Ignored for scenes that are loaded already.

    Attributes
    ----------
    shapes : frozenset of int
        All moving shapes, whose delta BSDFs are made rougher.
    unwelded : dict of mi.Shape
        Meshes whose vertices are welded, by index.
    stepped : dict of mi.Shape
        Shapes whose textures are interpolated, by index.
    """

    shapes: frozenset[int] = frozenset()
    unwelded: Mapping[int, Any] = field(default_factory=dict)
    stepped: Mapping[int, Any] = field(default_factory=dict)


def build_proxy_scene(
    scene: Any,
    settings: ProxySettings,
    context: LightContext,
    is_visible: Callable[[Any], bool],
    moving: MovingShapes = MovingShapes(),
    *,
    parse: SceneParser,
    unlit: bool = False,
) -> ProxyScene | None:
    """Build the proxy of a scene; None if nothing needs replacing or can be replaced.

    Parameters
    ----------
    scene : dict, path or mi.Scene
        A scene that Mitsuba has loaded before. The proxy of a loaded scene shares its shapes, and has only its lights
        replaced.
    settings : ProxySettings
    context : LightContext
    is_visible : callable
        Whether the camera may see a shape. A light whose proxy would be in view is not replaced: delta lights are
        invisible.
    moving : MovingShapes
    parse : SceneParser
    unlit : bool
        Whether proxy lights must not be seen in the surfaces that replace mirrors.
    """
    if isinstance(scene, mi.Scene):
        description, shared = _describe(scene)
        ids = [node.id() for node in shared]
        try:
            return build_proxy_scene(description, settings, context, is_visible, parse=parse, unlit=unlit)
        except ValueError:  # a scene with instances cannot be made of the objects of another
            return None
        finally:  # Mitsuba sets the ids of a dict's objects to their keys
            for node, node_id in zip(shared, ids, strict=True):
                node.set_id(node_id)
    unchanged: frozenset[int | None] = frozenset()
    while True:
        built = _substitute(scene, settings, context, moving, unchanged, parse, unlit=unlit)
        if built is None:
            return None
        proxy, substitutions = built
        visible = {
            shape.id() for shape in proxy.shapes() if shape.id().startswith(PROXY_EMITTER_ID) and is_visible(shape)
        }
        if not visible:
            break
        unchanged |= {
            substitution.light for substitution in substitutions if f"{PROXY_EMITTER_ID}{substitution.light}" in visible
        }
    delta = int(mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.DeltaTransmission)
    has_delta_bsdf = any(int(shape.bsdf().flags()) & delta for shape in proxy.shapes() if shape.bsdf() is not None)
    return ProxyScene(proxy, _numbered(substitutions), has_delta_bsdf)


def _substitute(
    scene: Any,
    settings: ProxySettings,
    context: LightContext,
    moving: MovingShapes,
    unchanged: frozenset[int | None],
    parse: SceneParser,
    *,
    unlit: bool,
) -> tuple[Any, list[Substitution]] | None:
    """Return a proxy scene and its substitutions, without the lights `unchanged`; None if nothing is replaced."""
    substitutions: list[Substitution] = []
    lights = 0
    with parse(scene) as (config, state):
        if any(node.props.plugin_name() == "shapegroup" for node in state.nodes):
            moving = MovingShapes()  # the indices of parsed and loaded shapes differ
        moving_bsdfs = {bsdf for shape in moving.shapes for bsdf in nodes_of_shape(state, shape, mi.ObjectType.BSDF)}
        for number, shape in moving.stepped.items():
            substitutions += substitute_textures(state, number, shape)
        for index in range(len(state.nodes)):
            node = state.nodes[index]
            plugin = node.props.plugin_name()
            if plugin in DELTA_LIGHTS.values() and node.type == mi.ObjectType.Emitter:
                node.props.set_id(node.props.id() or f"{LIGHT_ID}{lights}")
                intensity = context.intensities[lights] if lights < len(context.intensities) else None
                if settings.lights > 0.0 and intensity is not None and lights not in unchanged:
                    light = substitute_light(state, index, lights, settings.lights, intensity, context, unseen=unlit)
                    substitutions += [] if light is None else [light]
                lights += 1
            elif plugin in ROUGH_BSDFS and node.type == mi.ObjectType.BSDF and settings.mirrors > 0.0:
                moves = index in moving_bsdfs
                substitutions.append(substitute_surface(state, index, settings.mirrors, moves=moves, unlit=unlit))
        if not substitutions and not moving.unwelded:
            return None
        loaded = mi.parser.instantiate(config, state)
    proxy = loaded[0] if isinstance(loaded, list) else loaded
    shapes = [shape for shape in proxy.shapes() if not shape.id().startswith(PROXY_EMITTER_ID)]
    for number, shape in moving.unwelded.items():
        if shapes[number] != shape:  # an object in a dict belongs to the scene as well
            weld_vertices(shapes[number])
            substitutions.append(welding(shape))
    return (proxy, substitutions) if substitutions else None


def _numbered(substitutions: list[Substitution]) -> tuple[Substitution, ...]:
    """Number the substitutions of objects that have one name."""
    names = [substitution.original for substitution in substitutions]
    return tuple(
        replace(substitution, original=f"{name} ({names[: k + 1].count(name)})")
        if names.count(name) > 1
        else substitution
        for k, (name, substitution) in enumerate(zip(names, substitutions, strict=True))
    )


def _describe(scene: Any) -> tuple[dict[str, Any], list[Any]]:
    """Return a loaded scene as a dict of its objects, with descriptions of its delta lights; and the shared objects."""
    emitters = [emitter for emitter in scene.emitters() if not mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface)]
    lights = delta_lights(scene)
    description: dict[str, Any] = {"type": "scene"}
    shared = []
    for number, node in enumerate([*scene.sensors(), *scene.shapes(), *emitters, scene.integrator()]):
        light = _describe_light(node) if node in lights else None
        key = node.id() or (f"{LIGHT_ID}{lights.index(node)}" if node in lights else f"shared_object_{number}")
        description[key] = node if light is None else light
        if light is None:
            shared.append(node)
    return description, shared


def _describe_light(light: Any) -> dict[str, Any] | None:
    """Return the dict that loads a delta light; None if its intensity is unknown."""
    plugin, value = DELTA_LIGHTS[light.class_name()], light_intensity(light)
    if value is None:
        return None
    params = mi.traverse(light)
    quantity = "irradiance" if plugin == "directional" else "intensity"
    description: dict[str, Any] = {"type": plugin, quantity: {"type": "rgb", "value": value.tolist()}}
    if plugin == "point":
        return description | {"position": np.array(params["position"]).reshape(3).tolist()}
    to_world = np.array(params["to_world"].matrix, dtype=np.float32).reshape(4, 4)
    description["to_world"] = mi.ScalarTransform4f(to_world)
    if plugin == "spot":
        description |= {name: float(np.array(params[name]).reshape(-1)[0]) for name in ("cutoff_angle", "beam_width")}
    return description
