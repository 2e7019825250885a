"""A scene next to the one that is fitted, with gradients where Mitsuba has none: small lamps instead of points.

The image is that of the scene as it is. Only the gradient by what moves is taken from the neighbour, which differs from
the scene by just enough: hardly any ray hits a point light, but a small sphere has an outline behind which rays that
graze a shape find light or none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

import mitsuba as mi
import numpy as np

from loi_core.errors import OptionError
from loi_core.support.values import real_number
from loi_core.support.wording import shown
from loi_mitsuba.loading import Loaded, parsed

__all__ = ["KINDS", "Exchange", "Neighbour", "Surroundings", "neighbour_of"]

ROUGH: Final = {"conductor": "roughconductor", "dielectric": "roughdielectric", "plastic": "roughplastic"}
KINDS: Final = {"PointLight": "point", "SpotLight": "spot", "DirectionalEmitter": "directional"}
FAR: Final = 100.0  # how many times the scene's radius away the disk is that stands for a directional light


@dataclass(frozen=True)
class Neighbour:
    """How far the neighbouring scene may be from the scene itself; 0 leaves what it is about as it is.

    Attributes
    ----------
    lights : float
        Radius of the sphere that stands for a point or spot light, over its distance from what moves; and half the
        angle, in radians, of the disk that stands for a directional light. 0 to 0.5. A shadow is blurred by about its
        distance from what casts it, times this; a smaller lamp is hit by fewer rays, and its gradient noisier.
    mirrors : float
        Roughness (`alpha`) of what stands for perfect mirrors and clear glass. 0 to 0.5.

    Raises
    ------
    OptionError
        If a value is out of its range.
    """

    lights: float = 0.05
    mirrors: float = 0.05

    def __post_init__(self) -> None:
        for field in fields(self):
            value = real_number(getattr(self, field.name))
            if not 0.0 <= value <= 0.5:
                msg = f"`neighbour.{field.name}` must be 0 to 0.5, got {shown(getattr(self, field.name))}"
                raise OptionError(msg)

    @classmethod
    def of(cls, value: object) -> Neighbour:
        """From settings, a table of them, or None for no exchange at all."""
        if isinstance(value, Neighbour):
            return value
        if value is None:
            return cls(0.0, 0.0)
        names = [field.name for field in fields(cls)]
        if not isinstance(value, Mapping) or set(value) - set(names):
            msg = f"`neighbour` must be a Neighbour, None, or a table of {' and '.join(names)}, got {shown(value)}"
            raise OptionError(msg)
        return cls(**value)


@dataclass(frozen=True)
class Exchange:
    """One thing that the neighbour has instead of another: what, and in a line why and how large.

    Of a light, also which of the scene's lights without a size it is, from 0, what the lamp in its place is called, and
    by how much that is brighter.
    """

    what: str
    reason: str
    light: int | None = None
    lamp: str = ""
    factor: float = 1.0


@dataclass(frozen=True)
class Surroundings:
    """Where things move.

    Attributes
    ----------
    centre : array, shape (3,)
        Of what moves, about which lamps are measured.
    middle : array, shape (3,)
        Of the whole scene.
    radius : float
        Of a sphere around the whole scene.
    """

    centre: np.ndarray[Any, np.dtype[np.float64]]
    middle: np.ndarray[Any, np.dtype[np.float64]]
    radius: float

    @classmethod
    def of(cls, scene: Any, moving: list[Any]) -> Surroundings:
        """Of a loaded scene and the shapes that move in it."""
        centres = [np.array(one.bbox().center(), dtype=np.float64).reshape(3) for one in moving]
        box = scene.bbox()
        low, high = (np.array(one, dtype=np.float64).reshape(3) for one in (box.min, box.max))
        return cls(np.mean(centres, axis=0), 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)))


def neighbour_of(
    scene: Any,
    near: Neighbour,
    around: Surroundings,
    *,
    floats: bool = False,
    keep: frozenset[int | None] = frozenset(),
) -> tuple[Loaded, tuple[Exchange, ...]] | None:
    """The neighbouring scene of one that can be loaded, and what was exchanged; None if nothing is to be.

    Parameters
    ----------
    scene : dict, path or mi.Scene
        Which has been loaded before, so that it is known to be sound. Of a loaded scene only lights are exchanged, and
        the neighbour shares its shapes.
    near : Neighbour
    around : Surroundings
    floats : bool
        Whether textures are to hold floats.
    keep : frozenset of int
        Numbers of lights that are not exchanged.
    """
    if isinstance(scene, mi.Scene):
        described, shared = _described(scene)
        ids = [one.id() for one in shared]
        try:
            found = neighbour_of(described, near, around)
        finally:  # what a dict holds is called by its key
            for one, own in zip(shared, ids, strict=True):
                one.set_id(own)
        return None if found is None else (Loaded(found[0].scene, in_order=False), found[1])
    exchanges: list[Exchange] = []
    lights = 0
    with parsed(scene, floats=floats) as (config, state):
        for index in range(len(state.nodes)):
            node = state.nodes[index]
            kind = node.props.plugin_name()
            if kind in KINDS.values() and node.type == mi.ObjectType.Emitter:
                if near.lights > 0.0 and lights not in keep:
                    _exchange_light(state, index, lights, near.lights, around, exchanges)
                lights += 1
            elif kind in ROUGH and node.type == mi.ObjectType.BSDF and near.mirrors > 0.0:
                _exchange_surface(node, near.mirrors, exchanges)
        if not exchanges:
            return None
        loaded = mi.parser.instantiate(config, state)
    made = loaded[0] if isinstance(loaded, list) else loaded
    left = _brighten(made, {one.lamp: one.factor for one in exchanges if one.lamp})
    if left:
        kept = keep | {one.light for one in exchanges if one.lamp in left}
        return neighbour_of(scene, near, around, floats=floats, keep=kept)
    return Loaded(made, in_order=True, floats=floats), tuple(exchanges)


def _described(scene: Any) -> tuple[dict[str, Any], list[Any]]:
    """A loaded scene as a dict of its objects, but of lights that can be exchanged a description; and those objects."""
    emitters = [one for one in scene.emitters() if not mi.has_flag(one.flags(), mi.EmitterFlags.Surface)]
    described: dict[str, Any] = {"type": "scene"}
    shared = []
    for number, one in enumerate([*scene.sensors(), *scene.shapes(), *emitters, scene.integrator()]):
        light = _light(one)
        described[one.id() or f"loi_{number}"] = one if light is None else light
        if light is None:
            shared.append(one)
    return described, shared


def _light(emitter: Any) -> dict[str, Any] | None:
    """What a light that can be exchanged is loaded from."""
    kind = KINDS.get(emitter.class_name())
    if kind is None:
        return None
    params = mi.traverse(emitter)
    power = "irradiance" if kind == "directional" else "intensity"
    if f"{power}.value" not in params:
        return None
    value = np.array(params[f"{power}.value"], dtype=np.float64).reshape(-1)
    told: dict[str, Any] = {"type": kind, power: {"type": "rgb", "value": np.resize(value, 3).tolist()}}
    if kind == "point":
        return told | {"position": np.array(params["position"]).reshape(3).tolist()}
    place = np.array(params["to_world"].matrix, dtype=np.float32).reshape(4, 4)
    told["to_world"] = mi.ScalarTransform4f(place)
    if kind == "spot":
        told |= {name: float(np.array(params[name]).reshape(-1)[0]) for name in ("cutoff_angle", "beam_width")}
    return told


def _exchange_surface(node: Any, alpha: float, exchanges: list[Exchange]) -> None:
    kind = node.props.plugin_name()
    node.props.set_plugin_name(ROUGH[kind])
    node.props["alpha"] = alpha
    named = f" {node.props.id()!r}" if node.props.id() else ""
    exchanges.append(
        Exchange(
            f"{kind}{named}",
            f"a {ROUGH[kind]} of roughness {alpha:g}, for edges seen in what is perfectly smooth have no gradient",
        )
    )


def _exchange_light(
    state: Any,
    index: int,
    number: int,
    size: float,
    around: Surroundings,
    exchanges: list[Exchange],
) -> None:
    props = state.nodes[index].props
    kind, called = props.plugin_name(), props.id()
    name = f"loi_lamp_{number}"
    place = np.array(props["to_world"].matrix, dtype=np.float64) if "to_world" in props else np.eye(4)
    power = "irradiance" if kind == "directional" else "intensity"
    if kind == "directional":
        along = np.array(props["direction"]) if "direction" in props else place[:3, 2]
        along = along / np.linalg.norm(along)
        away = FAR * around.radius
        origin = around.middle - away * along
        up = np.eye(3)[int(np.argmin(np.abs(along)))]
        pose = mi.ScalarTransform4f().look_at(origin.tolist(), around.middle.tolist(), up.tolist())
        radius, shape = away * math.tan(size), "disk"
        # Seen from the scene, a disk of half the angle a lights what faces it with pi sin(a)^2 of its radiance.
        bright = 1.0 / (math.pi * math.sin(math.atan(math.tan(size))) ** 2)
        how = f"a disk of {math.degrees(2.0 * size):.2g} degrees, for"
    else:
        origin = np.array(props["position"]) if "position" in props else place[:3, 3]
        away = float(np.linalg.norm(around.centre - origin))
        if kind == "spot" and not _is_lit(props, place, origin, around.centre):
            return
        radius, shape = max(size * away, 1e-4 * around.radius), "sphere"
        pose = mi.ScalarTransform4f().translate(origin.tolist())
        bright = 1.0 / (math.pi * radius**2)
        how = f"a sphere of radius {radius:.3g}, {size:g} of its distance from what moves, for"
    lamp, surface = mi.Properties("area"), mi.Properties("diffuse")
    if power in props:
        lamp["radiance"] = props[power]
    surface["reflectance"] = 0.0
    parts = {"emitter": (lamp, mi.ObjectType.Emitter), "bsdf": (surface, mi.ObjectType.BSDF)}
    for own, kind_of in parts.values():
        one = mi.parser.SceneNode()
        one.props, one.type = own, kind_of
        state.nodes.append(one)  # which moves all nodes: what was referred to before is gone
    node = state.nodes[index]
    for key in list(node.props.keys()):
        del node.props[key]
    node.props.set_plugin_name(shape)
    node.props.set_id(name)
    node.props["to_world"] = pose @ mi.ScalarTransform4f().scale(radius)
    for place_of, key in enumerate(parts, len(state.nodes) - len(parts)):
        node.props[key] = mi.Properties.ResolvedReference(place_of)
    node.type = mi.ObjectType.Shape
    named = f" {called!r}" if called else ""
    told = "; outside of its cone the gradient is not that of a spot" if kind == "spot" else ""
    reason = f"{how} a shadow of light from a point has no gradient{told}"
    exchanges.append(Exchange(f"{kind} light{named}", reason, number, name, bright))


def _is_lit(props: Any, place: Any, origin: Any, centre: Any) -> bool:
    """Whether what moves is within the cone of a spot."""
    along = place[:3, 2]
    towards = centre - origin
    cosine = float(along @ towards / max(np.linalg.norm(along) * np.linalg.norm(towards), 1e-12))
    cutoff = float(props["cutoff_angle"]) if "cutoff_angle" in props else 20.0
    return cosine > math.cos(math.radians(cutoff))


def _brighten(scene: Any, brightness: Mapping[str, float]) -> list[str]:
    """Make lamps, which have the intensity of the lights that they stand for as their radiance, as bright as these.

    Those whose spectrum is of a kind that cannot be scaled, such as a black body's, are given back.
    """
    params = mi.traverse(scene)
    left = []
    for lamp, factor in brightness.items():
        keys = [key for key in params.properties if key.startswith(f"{lamp}.emitter.radiance.")]
        keys = [key for key in keys if key.rpartition(".")[2] in ("value", "data")]
        if len(keys) == 1:
            params[keys[0]] = type(params[keys[0]])(params[keys[0]] * factor)
        else:
            left.append(lamp)
    params.update()
    return left
