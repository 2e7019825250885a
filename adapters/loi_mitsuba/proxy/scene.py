"""A scene next to the one that is fitted, with gradients where Mitsuba has none: small lamps instead of points.

The image is that of the scene as it is. Only the gradient by what moves is taken from the neighbour, which differs from
the scene by just enough: hardly any ray hits a point light, but a small sphere has an outline behind which rays that
graze a shape find light or none; where a mesh stores the vertices of an edge twice, its triangles share them; and where
a texture has steps, it has ramps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import mitsuba as mi
import numpy as np

from loi_core.errors import OptionError
from loi_core.support.values import real_number
from loi_core.support.wording import shown
from loi_mitsuba.geometry.mesh import weld_vertices
from loi_mitsuba.proxy.light_size import KINDS, LightContext, delta_lights, light_intensity
from loi_mitsuba.proxy.substitutions import (
    LAMP,
    LIGHT,
    ROUGH,
    Substitution,
    interpolate_textures,
    substitute_light,
    substitute_surface,
    welding_of,
)
from loi_mitsuba.scene.load import LoadedScene, SceneLoadError, parsed_scene
from loi_mitsuba.scene.queries import parts_of

__all__ = ["MovingShapes", "ProxyScene", "ProxySettings", "build_proxy_scene"]


@dataclass(frozen=True)
class ProxySettings:
    """How far the neighbouring scene may be from the scene itself; 0 leaves what it is about as it is.

    Attributes
    ----------
    lights : float
        Radius of the sphere that stands for a point or spot light, over its distance from what moves, though no larger
        than twice the least of that; and half the angle, in radians, of the disk that stands for a directional light.
        0 to 0.5. A shadow is blurred by about its distance from what casts it, times this; a smaller lamp is hit by
        fewer rays, and its gradient noisier.
    mirrors : float
        Roughness (`alpha`) of what stands for perfect mirrors, smooth plastic and clear glass. 0 to 0.5. A mirror or
        plastic that moves is six times as rough, at most 1, since the noise of its gradient grows steeply as it gets
        smoother.
    seams : bool
        Whether the triangles of meshes that move share the vertices at one place. Along the seams of a texture,
        triangles may then show another part of it.
    textures : bool
        Whether checkerboards, and bitmaps that are not interpolated, are interpolated on what moves.

    Raises
    ------
    OptionError
        If a value is out of its range.
    """

    lights: float = 0.1
    mirrors: float = 0.05
    seams: bool = True
    textures: bool = True

    def __post_init__(self) -> None:
        for name in ("lights", "mirrors"):
            value = real_number(getattr(self, name))
            if not 0.0 <= value <= 0.5:
                msg = f"`proxy.{name}` must be 0 to 0.5, got {shown(getattr(self, name))}"
                raise OptionError(msg)
        for name in ("seams", "textures"):
            if not isinstance(getattr(self, name), bool):
                msg = f"`proxy.{name}` must be true or false, got {shown(getattr(self, name))}"
                raise OptionError(msg)

    @classmethod
    def of(cls, value: object) -> ProxySettings:
        """From settings, a table of them, or None for no exchange at all."""
        if isinstance(value, ProxySettings):
            return value
        if value is None:
            return cls(0.0, 0.0, seams=False, textures=False)
        names = [one.name for one in fields(cls)]
        if not isinstance(value, Mapping) or set(value) - set(names):
            msg = f"`proxy` must be a ProxySettings, None, or a table of {', '.join(names)}, got {shown(value)}"
            raise OptionError(msg)
        return cls(**value)


@dataclass(frozen=True)
class ProxyScene:
    """A neighbouring scene: what it has otherwise, and whether surfaces are left in it that are perfectly smooth."""

    loaded: LoadedScene
    exchanges: tuple[Substitution, ...]
    smooth: bool


@dataclass(frozen=True)
class MovingShapes:
    """What moves, by the numbers of shapes in the scene, from 0. Of a scene that is loaded already, none of it counts.

    Attributes
    ----------
    shapes : frozenset of int
        All of them, whose smooth surfaces are rougher.
    split : dict of mi.Shape
        Meshes whose vertices are to be shared.
    stepped : dict of mi.Shape
        Shapes whose textures are to be interpolated.
    """

    shapes: frozenset[int] = frozenset()
    split: Mapping[int, Any] = field(default_factory=dict)
    stepped: Mapping[int, Any] = field(default_factory=dict)


def build_proxy_scene(
    scene: Any,
    near: ProxySettings,
    around: LightContext,
    in_view: Callable[[Any], bool],
    moved: MovingShapes = MovingShapes(),
    *,
    float_textures: bool = False,
    unlit: bool = False,
) -> ProxyScene | None:
    """The neighbouring scene of one that can be loaded; None if nothing is to be exchanged, or can be.

    Parameters
    ----------
    scene : dict, path or mi.Scene
        Which has been loaded before, so that it is known to be sound. Of a loaded scene only lights are exchanged, and
        the neighbour shares its shapes.
    near : ProxySettings
    around : LightContext
    in_view : callable
        Whether the camera may see a shape. A lamp that it sees is not exchanged, for the light is never seen.
    moved : MovingShapes
    float_textures : bool
        Whether textures are to hold floats.
    unlit : bool
        Whether what stands for lights without a size is to have no image in what stands for mirrors.
    """
    if isinstance(scene, mi.Scene):
        described, shared = _described(scene)
        ids = [one.id() for one in shared]
        try:
            found = build_proxy_scene(described, near, around, in_view, unlit=unlit)
        except SceneLoadError:  # not every scene can be made of the objects of another, such as one with instances
            return None
        finally:  # what a dict holds is called by its key
            for one, own in zip(shared, ids, strict=True):
                one.set_id(own)
        return None if found is None else replace(found, loaded=LoadedScene(found.loaded.scene, in_order=False))
    keep: frozenset[int | None] = frozenset()
    while True:
        exchanged = _exchanged(scene, near, around, moved, keep, float_textures=float_textures, unlit=unlit)
        if exchanged is None:
            return None
        made, exchanges = exchanged
        seen = {shape.id() for shape in made.shapes() if shape.id().startswith(LAMP) and in_view(shape)}
        if not seen:
            break
        keep |= {one.light for one in exchanges if f"{LAMP}{one.light}" in seen}
    flags = [int(shape.bsdf().flags()) for shape in made.shapes() if shape.bsdf() is not None]
    smooth = any(one & int(mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.DeltaTransmission) for one in flags)
    return ProxyScene(LoadedScene(made, in_order=True, float_textures=float_textures), _distinct(exchanges), smooth)


def _exchanged(
    scene: Any,
    near: ProxySettings,
    around: LightContext,
    moved: MovingShapes,
    keep: frozenset[int | None],
    *,
    float_textures: bool,
    unlit: bool,
) -> tuple[Any, list[Substitution]] | None:
    """A neighbouring scene in which some lights are kept, and what is exchanged in it; None if nothing is."""
    exchanges: list[Substitution] = []
    lights = 0
    with parsed_scene(scene, float_textures=float_textures) as (config, state):
        if any(node.props.plugin_name() == "shapegroup" for node in state.nodes):
            moved = MovingShapes()  # the shapes of a group have no number
        surfaces = (parts_of(state, number, mi.ObjectType.BSDF) for number in moved.shapes)
        rougher = {index for parts in surfaces for index in parts}
        for number, shape in moved.stepped.items():
            interpolate_textures(state, number, shape, exchanges)
        for index in range(len(state.nodes)):
            node = state.nodes[index]
            kind = node.props.plugin_name()
            if kind in KINDS.values() and node.type == mi.ObjectType.Emitter:
                called = node.props.id()
                node.props.set_id(called or f"{LIGHT}{lights}")
                power = around.powers[lights] if lights < len(around.powers) else None
                if near.lights > 0.0 and power is not None and lights not in keep:
                    substitute_light(state, index, lights, near.lights, power, around, exchanges, unseen=unlit)
                lights += 1
            elif kind in ROUGH and node.type == mi.ObjectType.BSDF and near.mirrors > 0.0:
                substitute_surface(state, index, near.mirrors, exchanges, moves=index in rougher, unlit=unlit)
        if not exchanges and not moved.split:
            return None
        loaded = mi.parser.instantiate(config, state)
    made = loaded[0] if isinstance(loaded, list) else loaded
    own = [shape for shape in made.shapes() if not shape.id().startswith(LAMP)]
    for number, shape in moved.split.items():
        if own[number] != shape:  # what a dict holds as an object is the scene's as well
            weld_vertices(own[number])
            exchanges.append(welding_of(shape))
    return (made, exchanges) if exchanges else None


def _distinct(exchanges: list[Substitution]) -> tuple[Substitution, ...]:
    """Exchanges under names of their own: those that share one are numbered."""
    names = [one.what for one in exchanges]
    return tuple(
        replace(one, what=f"{one.what} ({names[: k + 1].count(one.what)})") if names.count(one.what) > 1 else one
        for k, one in enumerate(exchanges)
    )


def _described(scene: Any) -> tuple[dict[str, Any], list[Any]]:
    """A loaded scene as a dict of its objects, but of lights that can be exchanged a description; and those objects."""
    emitters = [one for one in scene.emitters() if not mi.has_flag(one.flags(), mi.EmitterFlags.Surface)]
    lights = delta_lights(scene)
    described: dict[str, Any] = {"type": "scene"}
    shared = []
    for number, one in enumerate([*scene.sensors(), *scene.shapes(), *emitters, scene.integrator()]):
        light = _described_light(one) if one in lights else None
        key = one.id() or (f"{LIGHT}{lights.index(one)}" if one in lights else f"loi_{number}")
        described[key] = one if light is None else light
        if light is None:
            shared.append(one)
    return described, shared


def _described_light(light: Any) -> dict[str, Any] | None:
    """What a light that can be exchanged is loaded from."""
    kind, value = KINDS[light.class_name()], light_intensity(light)
    if value is None:
        return None
    params = mi.traverse(light)
    power = "irradiance" if kind == "directional" else "intensity"
    told: dict[str, Any] = {"type": kind, power: {"type": "rgb", "value": value.tolist()}}
    if kind == "point":
        return told | {"position": np.array(params["position"]).reshape(3).tolist()}
    place = np.array(params["to_world"].matrix, dtype=np.float32).reshape(4, 4)
    told["to_world"] = mi.ScalarTransform4f(place)
    if kind == "spot":
        told |= {name: float(np.array(params[name]).reshape(-1)[0]) for name in ("cutoff_angle", "beam_width")}
    return told
