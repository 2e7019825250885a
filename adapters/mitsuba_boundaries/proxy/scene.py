"""Build a proxy scene, which has the gradients that the scene itself lacks.

The proxy differs from the scene as little as possible. Rays cannot hit a point light, but they can hit a small sphere,
whose visibility from a surface changes continuously as an occluder moves. Meshes that store their edges twice are
welded, and textures with steps have ramps.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from pathlib import Path
from typing import Any, Final

import mitsuba as mi
import numpy as np

from mitsuba_boundaries.geometry.mesh import is_flat_shaded, weld_vertices
from mitsuba_boundaries.geometry.mesh_checks import is_sharp_edged, is_unwelded
from mitsuba_boundaries.geometry.stepped_textures import has_stepped_texture
from mitsuba_boundaries.loading import load_unmerged, parsed_scene
from mitsuba_boundaries.proxy.light_size import DELTA_LIGHTS, LightContext, delta_lights, light_intensity
from mitsuba_boundaries.proxy.substitutions import (
    LIGHT_ID,
    ROUGH_BSDFS,
    Substitution,
    nodes_of_shape,
    substitute_light,
    substitute_surface,
    substitute_textures,
    welding,
)
from mitsuba_boundaries.sensing.frustum import Frustum

__all__ = ["ProxySettings", "build_proxy_scene", "differentiable_scene", "has_delta_bsdf"]

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
                msg = f"`{name}` must be 0 to {MAX_SIZE:g}, got {value!r}"
                raise ValueError(msg)
        for name in ("seams", "textures"):
            if not isinstance(getattr(self, name), bool):
                msg = f"`{name}` must be true or false, got {getattr(self, name)!r}"
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
            msg = f"must be a ProxySettings, None, or a table of {', '.join(names)}, got {value!r}"
            raise ValueError(msg)
        return cls(**value)


def differentiable_scene(
    scene: dict[str, Any] | str | Path | Any,
    moving: Iterable[str] | None = None,
    *,
    keep: Iterable[str] = (),
    sensor: int = 0,
    settings: ProxySettings = ProxySettings(),
) -> tuple[Any, tuple[Substitution, ...]]:
    """Return a scene with gradients in place of one without, and the substitutions that give it these.

    Point, spot and directional lights become small area lights, and their radiance `Substitution.factor` times their
    intensity. Perfect mirrors, smooth plastic and clear glass become slightly rough. On moving shapes, split vertices
    are welded, and textures with steps get ramps. A light keeps its id: ``lamp.position`` becomes ``lamp.to_world``,
    and ``lamp.intensity.value`` becomes ``lamp.emitter.radiance.value``. Render the scene by ``direct_boundaries`` or
    ``prb_boundaries``.

    Parameters
    ----------
    scene : dict, path or mi.Scene
        Of a scene that is loaded already, only the lights are replaced, and all other objects are shared.
    moving : iterable of str, optional
        Ids of the shapes that move, or whose shadow moves because a light does; by default all shapes. Lights are as
        large as these shapes allow, and the gradient of a small light is noisier.
    keep : iterable of str
        Ids of lights and shapes that stay as they are, as a mesh whose vertices move by themselves.
    sensor : int
        Index of the sensor. A light that it would see is not replaced, because delta lights are invisible.
    settings : ProxySettings

    Returns
    -------
    scene : mi.Scene
        The loaded scene itself if nothing is replaced.
    substitutions : tuple of Substitution

    Raises
    ------
    ValueError
        If `moving` or `keep` has the id of no object.
    RuntimeError
        If Mitsuba cannot load the scene.

    Examples
    --------
    >>> scene, substitutions = differentiable_scene("scene.xml", ["ball"])          # doctest: +SKIP
    >>> print([str(substitution) for substitution in substitutions])                # doctest: +SKIP
    """
    loaded = scene if isinstance(scene, mi.Scene) else load_unmerged(scene)
    shapes, sensors = loaded.shapes(), loaded.sensors()
    moved = shapes if moving is None else _with_ids("moving", moving, shapes)
    kept = _with_ids("keep", keep, [*shapes, *loaded.emitters()])
    camera = sensors[sensor] if sensors else None
    proxy = build_proxy_scene(scene, loaded, moved, keep=kept, sensor=camera, settings=settings)
    return (loaded, ()) if proxy is None else proxy


def _with_ids(argument: str, ids: Iterable[str], objects: Collection[Any]) -> list[Any]:
    """Return the objects with these ids."""
    by_id = {node.id(): node for node in objects if node.id()}
    wanted = list(ids)
    for name in wanted:
        if name not in by_id:
            msg = f"`{argument}` must have ids of {', '.join(by_id) or 'objects, and none has one'}, got {name!r}"
            raise ValueError(msg)
    return [by_id[name] for name in wanted]


def has_delta_bsdf(scene: Any) -> bool:
    """Return whether a scene has perfectly smooth surfaces."""
    delta = int(mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.DeltaTransmission)
    return any(int(shape.bsdf().flags()) & delta for shape in scene.shapes() if shape.bsdf() is not None)


@dataclass(frozen=True)
class _MovingShapes:
    """Indices of the moving shapes in a scene.

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

    @classmethod
    def of(
        cls,
        scene: Any,
        moving: Iterable[Any],
        settings: ProxySettings,
        *,
        keep: Collection[Any] = (),
        deforming: Collection[Any] = (),
    ) -> _MovingShapes:
        """Find the moving shapes that the settings let change; see :func:`build_proxy_scene`.

        A mesh with both smooth shading and sharp edges is not welded, because it would become smooth throughout.
        """
        shapes = list(scene.shapes())
        index = {shape: shapes.index(shape) for shape in dict.fromkeys(moving) if shape in shapes}
        free = [shape for shape in index if shape not in keep]
        unwelded = [shape for shape in free if settings.seams and shape not in deforming and is_unwelded(shape)]
        stepped = [
            shape
            for shape in (free if settings.textures else [])
            if has_stepped_texture(shape) and not any(node in keep for node in mi.traverse(shape).hierarchy)
        ]
        return cls(
            frozenset(index.values()),
            {index[shape]: shape for shape in unwelded if is_flat_shaded(shape) or not is_sharp_edged(shape)},
            {index[shape]: shape for shape in stepped},
        )


def build_proxy_scene(
    source: Any,
    loaded: Any,
    moving: Collection[Any],
    *,
    sensor: Any,
    keep: Collection[Any] = (),
    deforming: Collection[Any] = (),
    settings: ProxySettings = ProxySettings(),
    float_textures: bool = False,
) -> tuple[Any, tuple[Substitution, ...]] | None:
    """Build the proxy of a scene; None if nothing needs replacing or can be replaced.

    Parameters
    ----------
    source : dict, path or mi.Scene
        As for :func:`differentiable_scene`.
    loaded : mi.Scene
        The scene that Mitsuba has loaded from it.
    moving : collection of mi.Shape
        Its moving shapes.
    sensor : mi.Sensor or None
    keep : collection of objects
        Lights, shapes and textures that stay as they are.
    deforming : collection of mi.Mesh
        Meshes whose vertices move by themselves, which are not welded.
    settings : ProxySettings
    float_textures : bool
        Whether 8-bit textures are loaded as floats.
    """
    lights = delta_lights(loaded)
    has_mirrors = has_delta_bsdf(loaded)
    shapes = _MovingShapes.of(loaded, moving, settings, keep=keep, deforming=deforming)
    if not moving or not (lights or has_mirrors or shapes.unwelded or shapes.stepped):
        return None
    context = LightContext.of(loaded, moving, keep)
    # The surfaces that replace mirrors must not show the lights that mirrors do not show.
    changes = _Changes(settings, context, shapes, unlit=bool(lights) and has_mirrors, float_textures=float_textures)
    view = None if sensor is None else Frustum(sensor)
    if isinstance(source, mi.Scene):
        description, shared = _describe(source)
        ids = [node.id() for node in shared]
        try:
            return _replaced(description, replace(changes, moving=_MovingShapes()), view)
        except RuntimeError:  # a scene with instances cannot be made of the objects of another
            return None
        finally:  # Mitsuba sets the ids of a dict's objects to their keys
            for node, node_id in zip(shared, ids, strict=True):
                node.set_id(node_id)
    return _replaced(source, changes, view)


@dataclass(frozen=True)
class _Changes:
    """The changes that make a proxy of a scene.

    Attributes
    ----------
    settings : ProxySettings
    context : LightContext
    moving : _MovingShapes
    unlit : bool
        Whether proxy lights must not be seen in the surfaces that replace mirrors.
    float_textures : bool
    """

    settings: ProxySettings
    context: LightContext
    moving: _MovingShapes
    unlit: bool
    float_textures: bool


def _replaced(scene: Any, changes: _Changes, view: Frustum | None) -> tuple[Any, tuple[Substitution, ...]] | None:
    """Return a proxy scene and its substitutions, without lights that would be in view; None if nothing is replaced."""
    unchanged: frozenset[str] = frozenset()
    while True:
        built = _substitute(scene, changes, unchanged)
        if built is None:
            return None
        proxy, substitutions = built
        lights = {substitution.light for substitution in substitutions if substitution.light}
        visible = {shape.id() for shape in proxy.shapes() if shape.id() in lights and view and view.overlaps(shape)}
        if not visible:
            return proxy, _numbered(substitutions)
        unchanged |= visible


def _substitute(scene: Any, changes: _Changes, unchanged: Collection[str]) -> tuple[Any, list[Substitution]] | None:
    """Return a proxy scene and its substitutions, without the lights `unchanged`; None if nothing is replaced."""
    settings, moving, intensities = changes.settings, changes.moving, iter(changes.context.intensities)
    substitutions: list[Substitution] = []
    lights = 0
    with parsed_scene(scene, float_textures=changes.float_textures) as (config, state):
        if any(node.props.plugin_name() == "shapegroup" for node in state.nodes):
            moving = _MovingShapes()  # the indices of parsed and loaded shapes differ
        moving_bsdfs = {bsdf for shape in moving.shapes for bsdf in nodes_of_shape(state, shape, mi.ObjectType.BSDF)}
        for number, shape in moving.stepped.items():
            substitutions += substitute_textures(state, number, shape)
        for index in range(len(state.nodes)):
            node = state.nodes[index]
            plugin = node.props.plugin_name()
            if plugin in DELTA_LIGHTS.values() and node.type == mi.ObjectType.Emitter:
                node.props.set_id(node.props.id() or f"{LIGHT_ID}{lights}")
                intensity = next(intensities, None)
                if settings.lights > 0.0 and intensity is not None and node.props.id() not in unchanged:
                    light = substitute_light(
                        state, index, settings.lights, intensity, changes.context, unseen=changes.unlit
                    )
                    substitutions += [] if light is None else [light]
                lights += 1
            elif plugin in ROUGH_BSDFS and node.type == mi.ObjectType.BSDF and settings.mirrors > 0.0:
                moves = index in moving_bsdfs
                substitutions.append(
                    substitute_surface(state, index, settings.mirrors, moves=moves, unlit=changes.unlit)
                )
        if not substitutions and not moving.unwelded:
            return None
        loaded = mi.parser.instantiate(config, state)
    proxy = loaded[0] if isinstance(loaded, list) else loaded
    added = {substitution.light for substitution in substitutions if substitution.light}
    shapes = [shape for shape in proxy.shapes() if shape.id() not in added]
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
    integrators = [] if scene.integrator() is None else [scene.integrator()]
    for number, node in enumerate([*scene.sensors(), *scene.shapes(), *emitters, *integrators]):
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
