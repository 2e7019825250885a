"""A scene next to the one that is fitted, with gradients where Mitsuba has none: small lamps instead of points.

The image is that of the scene as it is. Only the gradient by what moves is taken from the neighbour, which differs from
the scene by just enough: hardly any ray hits a point light, but a small sphere has an outline behind which rays that
graze a shape find light or none; where a mesh stores the vertices of an edge twice, its triangles share them; and where
a texture has steps, it has ramps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Final, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_core.errors import OptionError
from loi_core.support.values import real_number
from loi_core.support.wording import shown
from loi_mitsuba.loading import Loaded, SceneLoadError, parsed
from loi_mitsuba.seams import merge_seams
from loi_mitsuba.steps import RAMP, interpolate, textures_of

__all__ = [
    "KINDS",
    "LAMP",
    "LIGHT",
    "Exchange",
    "Found",
    "Neighbour",
    "Surroundings",
    "lights_of",
    "neighbour_of",
    "position_of",
]

Host: TypeAlias = np.ndarray[Any, np.dtype[np.float64]]

ROUGH: Final = {"conductor": "roughconductor", "dielectric": "roughdielectric", "plastic": "roughplastic"}
KINDS: Final = {"PointLight": "point", "SpotLight": "spot", "DirectionalEmitter": "directional"}
LAMP: Final = "loi_lamp_"
LIGHT: Final = "loi_light_"
WIDEST: Final = 2.0  # times what casts a shadow: its umbra then reaches as far behind it as the lamp is before it
PLACES: Final = 64  # of a lamp, from which what moves is seen or hidden
OPEN: Final = 0.9  # of them, that see it if the light does; if that does not, none may
FAR: Final = 100.0  # how many times the scene's radius away the disk is that stands for a directional light


@dataclass(frozen=True)
class Neighbour:
    """How far the neighbouring scene may be from the scene itself; 0 leaves what it is about as it is.

    Attributes
    ----------
    lights : float
        Radius of the sphere that stands for a point or spot light, over its distance from what moves, though no larger
        than twice the least of that; and half the angle, in radians, of the disk that stands for a directional light.
        0 to 0.5. A shadow is blurred by about its distance from what casts it, times this; a smaller lamp is hit by
        fewer rays, and its gradient noisier.
    mirrors : float
        Roughness (`alpha`) of what stands for perfect mirrors and clear glass. 0 to 0.5.
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
                msg = f"`neighbour.{name}` must be 0 to 0.5, got {shown(getattr(self, name))}"
                raise OptionError(msg)
        for name in ("seams", "textures"):
            if not isinstance(getattr(self, name), bool):
                msg = f"`neighbour.{name}` must be true or false, got {shown(getattr(self, name))}"
                raise OptionError(msg)

    @classmethod
    def of(cls, value: object) -> Neighbour:
        """From settings, a table of them, or None for no exchange at all."""
        if isinstance(value, Neighbour):
            return value
        if value is None:
            return cls(0.0, 0.0, seams=False, textures=False)
        names = [field.name for field in fields(cls)]
        if not isinstance(value, Mapping) or set(value) - set(names):
            msg = f"`neighbour` must be a Neighbour, None, or a table of {', '.join(names)}, got {shown(value)}"
            raise OptionError(msg)
        return cls(**value)


@dataclass(frozen=True)
class Exchange:
    """One thing that the neighbour has instead of another: what, and in a line why and how large.

    Of a light, also which of the scene's lights without a size it is, from 0, and how many times its intensity the
    radiance is of what stands for it.
    """

    what: str
    reason: str
    light: int | None = None
    factor: float = 1.0


@dataclass(frozen=True)
class Found:
    """A neighbouring scene: what it has otherwise, and whether surfaces are left in it that are perfectly smooth."""

    loaded: Loaded
    exchanges: tuple[Exchange, ...]
    smooth: bool


@dataclass(frozen=True)
class Surroundings:
    """Where things move, and what lights there are.

    Attributes
    ----------
    boxes : array, shape (n, 2, 3)
        Lowest and highest corners of what moves.
    middle : array, shape (3,)
        Of the whole scene.
    radius : float
        Of a sphere around the whole scene.
    powers : tuple of array or None
        Intensity or irradiance of each light without a size, as red, green and blue; None where it is not known, or the
        light is to stay as it is.
    scene : mi.Scene
        What there is.
    """

    boxes: Host
    middle: Host
    radius: float
    powers: tuple[Host | None, ...]
    scene: Any

    @classmethod
    def of(cls, scene: Any, moving: Iterable[Any], stay: Iterable[int] = ()) -> Surroundings:
        """Of a loaded scene, the shapes that move in it, and the numbers of lights that are to stay as they are."""
        boxes = np.array([_corners(one.bbox()) for one in moving])
        low, high = _corners(scene.bbox())
        kept = set(stay)
        powers = tuple(None if k in kept else _power(one) for k, one in enumerate(lights_of(scene)))
        return cls(boxes, 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)), powers, scene)

    def distance(self, point: Host) -> float:
        """From a point to the nearest box, or if it is within one, to that one's middle."""
        outside = np.maximum(np.maximum(self.boxes[:, 0] - point, point - self.boxes[:, 1]), 0.0)
        away = np.linalg.norm(outside, axis=1)
        middles = np.linalg.norm(self.boxes.mean(axis=1) - point, axis=1)
        return float(np.min(np.where(away > 0.0, away, middles)))

    def fits(self, point: Host, radius: float) -> bool:
        """Whether a sphere at a light sees what moves where the light does, and does not where that has a shade."""
        turns = np.arange(PLACES) * math.pi * (3.0 - math.sqrt(5.0))
        away = np.sqrt((np.arange(PLACES) + 0.5) / PLACES)
        disk = radius * np.stack([away * np.cos(turns), away * np.sin(turns)], axis=1)
        for low, high in self.boxes:
            middle, reach = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
            before = float(np.linalg.norm(middle - point)) - reach  # from there on, it may be what moves itself
            if before <= 0.0:
                continue
            towards = (middle - point) / np.linalg.norm(middle - point)
            across = np.linalg.svd(towards[None, :])[2][1:]
            bulge = np.sqrt(radius**2 - np.sum(disk**2, axis=1))  # of the side of the sphere that is turned there
            origins = np.concatenate([point[None, :], point + disk @ across + bulge[:, None] * towards])
            room = before - np.append(0.0, bulge)
            corners = low + (high - low) * np.indices((2, 2, 2)).reshape(3, 8).T
            for goal in (middle, *corners):
                hidden = _first_hit(self.scene, origins, goal) < room
                if not (np.all(hidden) if hidden[0] else np.mean(~hidden) >= OPEN):
                    return False
        return True

    @property
    def least(self) -> float:
        """Half the longest side of the smallest box."""
        return 0.5 * float(np.min(np.max(self.boxes[:, 1] - self.boxes[:, 0], axis=1)))


def lights_of(scene: Any) -> list[Any]:
    """The lights without a size that can be exchanged, in the scene's order."""
    return [one for one in scene.emitters() if one.class_name() in KINDS]


def position_of(light: Any) -> Host:
    """Where a light without a size is, shape (3,); of a directional light, nowhere that means anything."""
    params = mi.traverse(light)
    told = params["position"] if "position" in params else params["to_world"].translation()
    return np.array(told, dtype=np.float64).reshape(3)


def _first_hit(scene: Any, origins: Host, goal: Host) -> Host:
    """How far away the first surface is on the ways from points, shape (n, 3), to one; infinite where there is none."""
    ways = goal - origins
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(origins.astype(np.float32).T), mi.Vector3f(ways.astype(np.float32).T))
    with dr.suspend_grad():
        return np.array(scene.ray_intersect_preliminary(ray).t, dtype=np.float64)


def _corners(box: Any) -> Host:
    return np.array([np.array(one, dtype=np.float64).reshape(3) for one in (box.min, box.max)])


def _power(light: Any) -> Host | None:
    """Of a light of one colour in all directions; None for others."""
    params = mi.traverse(light)
    power = "irradiance" if KINDS[light.class_name()] == "directional" else "intensity"
    textured = "texture.data" in params
    if f"{power}.value" not in params or textured:
        return None
    value = np.array(params[f"{power}.value"], dtype=np.float64).reshape(-1)
    return np.resize(value, 3) if value.size in (1, 3) else None


def neighbour_of(
    scene: Any,
    near: Neighbour,
    around: Surroundings,
    in_view: Callable[[Any], bool],
    *,
    floats: bool = False,
    keep: frozenset[int | None] = frozenset(),
    split: Mapping[int, Any] | None = None,
    stepped: Mapping[int, Any] | None = None,
) -> Found | None:
    """The neighbouring scene of one that can be loaded; None if nothing is to be exchanged, or can be.

    Parameters
    ----------
    scene : dict, path or mi.Scene
        Which has been loaded before, so that it is known to be sound. Of a loaded scene only lights are exchanged, and
        the neighbour shares its shapes.
    near : Neighbour
    around : Surroundings
    in_view : callable
        Whether the camera may see a shape. A lamp that it sees is not exchanged, for the light is never seen.
    floats : bool
        Whether textures are to hold floats.
    keep : frozenset of int
        Numbers of lights that are not exchanged.
    split : dict of mi.Shape, optional
        By their numbers in the scene, from 0, meshes whose vertices are to be shared; of a loaded scene, none are.
    stepped : dict of mi.Shape, optional
        By their numbers, shapes whose textures are to be interpolated; of a loaded scene, none are.
    """
    if isinstance(scene, mi.Scene):
        described, shared = _described(scene)
        ids = [one.id() for one in shared]
        try:
            found = neighbour_of(described, near, around, in_view)
        except SceneLoadError:  # not every scene can be made of the objects of another, such as one with instances
            return None
        finally:  # what a dict holds is called by its key
            for one, own in zip(shared, ids, strict=True):
                one.set_id(own)
        return None if found is None else replace(found, loaded=Loaded(found.loaded.scene, in_order=False))
    exchanges: list[Exchange] = []
    lights = 0
    with parsed(scene, floats=floats) as (config, state):
        grouped = any(node.props.plugin_name() == "shapegroup" for node in state.nodes)  # whose shapes are not numbered
        seams = dict(split or {}) if near.seams and not grouped else {}
        for number, shape in (stepped or {}).items() if near.textures and not grouped else ():
            _exchange_textures(state, number, shape, exchanges)
        for index in range(len(state.nodes)):
            node = state.nodes[index]
            kind = node.props.plugin_name()
            if kind in KINDS.values() and node.type == mi.ObjectType.Emitter:
                called = node.props.id()
                node.props.set_id(called or f"{LIGHT}{lights}")
                power = around.powers[lights] if lights < len(around.powers) else None
                if near.lights > 0.0 and power is not None and lights not in keep:
                    _exchange_light(state, index, lights, near.lights, power, around, exchanges)
                lights += 1
            elif kind in ROUGH and node.type == mi.ObjectType.BSDF and near.mirrors > 0.0:
                _exchange_surface(node, near.mirrors, exchanges)
        if not exchanges and not seams:
            return None
        loaded = mi.parser.instantiate(config, state)
    made = loaded[0] if isinstance(loaded, list) else loaded
    own = [shape for shape in made.shapes() if not shape.id().startswith(LAMP)]
    for number, shape in seams.items():
        if own[number] != shape:  # what a dict holds as an object is the scene's as well
            merge_seams(own[number])
            exchanges.append(_of_seams(shape))
    if not exchanges:
        return None
    seen = {shape.id() for shape in made.shapes() if shape.id().startswith(LAMP) and in_view(shape)}
    if seen:
        more = {one.light for one in exchanges if f"{LAMP}{one.light}" in seen}
        return neighbour_of(scene, near, around, in_view, floats=floats, keep=keep | more, split=split, stepped=stepped)
    flags = [int(shape.bsdf().flags()) for shape in made.shapes() if shape.bsdf() is not None]
    smooth = any(one & int(mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.DeltaTransmission) for one in flags)
    return Found(Loaded(made, in_order=True, floats=floats), _distinct(exchanges), smooth)


def _distinct(exchanges: list[Exchange]) -> tuple[Exchange, ...]:
    """Exchanges under names of their own: those that share one are numbered."""
    names = [one.what for one in exchanges]
    return tuple(
        replace(one, what=f"{one.what} ({names[: k + 1].count(one.what)})") if names.count(one.what) > 1 else one
        for k, one in enumerate(exchanges)
    )


def _described(scene: Any) -> tuple[dict[str, Any], list[Any]]:
    """A loaded scene as a dict of its objects, but of lights that can be exchanged a description; and those objects."""
    emitters = [one for one in scene.emitters() if not mi.has_flag(one.flags(), mi.EmitterFlags.Surface)]
    lights = lights_of(scene)
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
    kind, value = KINDS[light.class_name()], _power(light)
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


def _exchange_textures(state: Any, number: int, shape: Any, exchanges: list[Exchange]) -> None:
    for node in textures_of(state, number):
        kind = node.props.plugin_name()
        if interpolate(node.props):
            named = f" of {shape.id()!r}" if shape.id() else ""
            exchanges.append(Exchange(f"{kind}{named}", f"an interpolated bitmap {RAMP}"))


def _of_seams(shape: Any) -> Exchange:
    named = f" {shape.id()!r}" if shape.id() else ""
    reason = "with the vertices at one place shared, for an edge that is stored twice has its gradient twice"
    return Exchange(f"mesh{named}", reason)


def _exchange_light(
    state: Any,
    index: int,
    number: int,
    size: float,
    power: Host,
    around: Surroundings,
    exchanges: list[Exchange],
) -> None:
    props = state.nodes[index].props
    kind, called = props.plugin_name(), props.id()
    place = np.array(props["to_world"].matrix, dtype=np.float64) if "to_world" in props else np.eye(4)
    if kind == "directional":
        along = np.array(props["direction"]) if "direction" in props else place[:3, 2]
        along = along / np.linalg.norm(along)
        away = FAR * around.radius
        origin = around.middle - away * along
        up = np.eye(3)[int(np.argmin(np.abs(along)))]
        pose = mi.ScalarTransform4f().look_at(origin.tolist(), around.middle.tolist(), up.tolist())
        radius, shape = away * math.tan(size), "disk"
        # Seen from the scene, a disk of half the angle a lights what faces it with pi sin(a)^2 of its radiance.
        factor = 1.0 / (math.pi * math.sin(size) ** 2)
        how = f"a disk of {math.degrees(2.0 * size):.2g} degrees, for"
    else:
        origin = np.array(props["position"]) if "position" in props else place[:3, 3]
        if kind == "spot" and not _lights(props, place, origin, around):
            return
        share, most, least = size * around.distance(origin), WIDEST * around.least, 1e-4 * around.radius
        radius = widest = max(min(share, most), least)
        shape = "sphere"
        while radius > least and not around.fits(origin, radius):
            radius = max(0.5 * radius, least)
        pose = mi.ScalarTransform4f().translate(origin.tolist())
        factor = 1.0 / (math.pi * radius**2)
        of = f"{size:g} of its distance from what moves" if share <= most else f"{WIDEST:g} times that of what moves"
        of = f"{of}, less to stay within what is around it" if radius < widest else of
        how = f"a sphere of radius {radius:.3g}, {of}, for"
    lamp, surface = mi.Properties("area"), mi.Properties("diffuse")
    lamp["radiance"] = mi.ScalarColor3f((factor * power).tolist())
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
    node.props.set_id(f"{LAMP}{number}")
    node.props["to_world"] = pose @ mi.ScalarTransform4f().scale(radius)
    for place_of, key in enumerate(parts, len(state.nodes) - len(parts)):
        node.props[key] = mi.Properties.ResolvedReference(place_of)
    node.type = mi.ObjectType.Shape
    named = "" if called.startswith(LIGHT) else f" {called!r}"
    told = "; outside of its cone the gradient is not that of a spot" if kind == "spot" else ""
    reason = f"{how} a shadow of light from a point has no gradient{told}"
    exchanges.append(Exchange(f"{kind} light{named}", reason, number, factor))


def _lights(props: Any, place: Host, origin: Host, around: Surroundings) -> bool:
    """Whether anything that moves reaches into the cone of a spot, as spheres around the boxes tell."""
    along = place[:3, 2] / np.linalg.norm(place[:3, 2])
    cutoff = math.radians(float(props["cutoff_angle"]) if "cutoff_angle" in props else 20.0)
    for low, high in around.boxes:
        towards = 0.5 * (low + high) - origin
        away, radius = float(np.linalg.norm(towards)), 0.5 * float(np.linalg.norm(high - low))
        if away <= radius:
            return True
        angle = math.acos(min(max(float(along @ towards) / away, -1.0), 1.0))
        if angle - math.asin(radius / away) < cutoff:
            return True
    return False
