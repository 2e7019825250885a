"""Replace the nodes of a parsed scene that have no gradient in Mitsuba."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.arrays import Float64Array
from mitsuba_boundaries.geometry.mesh_checks import has_creases
from mitsuba_boundaries.geometry.stepped_textures import RAMP, ramp_texture
from mitsuba_boundaries.plugins.proxy_bsdf import register_proxy_bsdf
from mitsuba_boundaries.plugins.proxy_emitter import register_proxy_emitter
from mitsuba_boundaries.proxy.light_size import LightContext

__all__ = [
    "LIGHT_ID",
    "ROUGH_BSDFS",
    "Substitution",
    "nodes_of_shape",
    "substitute_light",
    "substitute_surface",
    "substitute_textures",
    "welding",
]

ROUGH_BSDFS: Final = {"conductor": "roughconductor", "dielectric": "roughdielectric", "plastic": "roughplastic"}
LIGHT_ID: Final = "delta_light_"  # followed by the number of a delta light without an id
MOVING_ROUGHNESS: Final = 6.0  # relative to a mirror at rest
MAX_RADIUS: Final = 2.0  # in half sizes of the smallest moving shape: its umbra is then as long as the light is far
MIN_RADIUS: Final = 1e-4  # in radii of the scene
SUN_DISTANCE: Final = 100.0  # of the disk that replaces a directional light, in radii of the scene
DEFAULT_CUTOFF_DEG: Final = 20.0  # of Mitsuba's spot light
DEFAULT_BEAM_FRACTION: Final = 0.75  # beam width of Mitsuba's spot light, relative to its cutoff angle


@dataclass(frozen=True)
class Substitution:
    """One substitution in the proxy scene.

    Attributes
    ----------
    original : str
        Name of the object that is replaced.
    reason : str
        One line: the replacement, its size, and why.
    only_shadows : bool
        Whether it improves nothing but the gradient of shadows.
    light : str
        Id of the delta light that is replaced, and of the shape in its place; empty for other objects.
    factor : float
        Ratio of the replacement's radiance to the light's intensity.
    """

    original: str
    reason: str
    only_shadows: bool = False
    light: str = ""
    factor: float = 1.0

    def __str__(self) -> str:
        """Return the substitution in one line."""
        return f"{self.original}: {self.reason}"


@dataclass(frozen=True)
class _AreaLight:
    """A shape with the irradiance of a delta light."""

    shape: str
    radius: float
    pose: Any
    factor: float
    description: str


def nodes_of_shape(state: Any, number: int, node_type: Any) -> Iterator[int]:
    """Yield the indices of a shape's descendants of one ``mi.ObjectType``."""
    nodes = state.nodes
    shapes = [child for child in _children(nodes[0].props) if nodes[child].type == mi.ObjectType.Shape]
    if number < len(shapes):
        yield from _descendants(nodes, shapes[number], node_type)


def _descendants(nodes: Any, parent: int, node_type: Any) -> Iterator[int]:
    for child in _children(nodes[parent].props):
        if nodes[child].type == node_type:
            yield child
        yield from _descendants(nodes, child, node_type)


def _children(props: Any) -> list[int]:
    values = (props[key] for key in props.keys())  # noqa: SIM118  # not a mapping
    return [value.index() for value in values if isinstance(value, mi.Properties.ResolvedReference)]


def substitute_surface(state: Any, index: int, roughness: float, *, moves: bool, unlit: bool) -> Substitution:
    """Make a delta BSDF slightly rough.

    Parameters
    ----------
    state : parser state
    index : int
        Node of the BSDF.
    roughness : float
        `alpha` of a surface at rest.
    moves : bool
        Whether its shape moves, so that it is made rougher.
    unlit : bool
        Whether it must not reflect light of emitter samples.
    """
    props = state.nodes[index].props
    plugin = props.plugin_name()
    rougher = moves and plugin != "dielectric"  # rough glass would blur the view through it
    alpha = min(MOVING_ROUGHNESS * roughness, 1.0) if rougher else roughness
    props.set_plugin_name(ROUGH_BSDFS[plugin])
    props["alpha"] = alpha
    suffix = f" {props.id()!r}" if props.id() else ""
    reason = "because edges seen in a perfectly smooth surface have no gradient"
    noise = "; the rougher a moving surface, the less noisy its gradient" if rougher else ""
    if unlit:
        rough = mi.parser.SceneNode()
        rough.props, rough.type = mi.Properties(ROUGH_BSDFS[plugin]), mi.ObjectType.BSDF
        for key in list(props.keys()):
            rough.props[key] = props[key]
            del props[key]
        props.set_plugin_name(register_proxy_bsdf())
        props["rough"] = mi.Properties.ResolvedReference(len(state.nodes))
        state.nodes.append(rough)  # moves all nodes in memory: earlier references to them are invalid
    return Substitution(f"{plugin}{suffix}", f"a {ROUGH_BSDFS[plugin]} of roughness {alpha:g}, {reason}{noise}")


def substitute_textures(state: Any, number: int, shape: Any) -> list[Substitution]:
    """Interpolate the textures of a shape that have steps."""
    substitutions = []
    suffix = f" of {shape.id()!r}" if shape.id() else ""
    for index in nodes_of_shape(state, number, mi.ObjectType.Texture):
        node = state.nodes[index]
        plugin = node.props.plugin_name()
        if ramp_texture(node.props):
            substitutions.append(Substitution(f"{plugin}{suffix}", f"an interpolated bitmap {RAMP}"))
    return substitutions


def welding(shape: Any) -> Substitution:
    """Describe the welding of a mesh's vertices."""
    suffix = f" {shape.id()!r}" if shape.id() else ""
    reason = "with coincident vertices welded, because the gradient of an edge that is stored twice counts twice"
    # Welding changes the texture coordinates of a box. Its outlines are sampled in the scene itself, with its texture.
    return Substitution(f"mesh{suffix}", reason, only_shadows=has_creases(shape))


def substitute_light(
    state: Any, index: int, size: float, intensity: Any, context: LightContext, *, unseen: bool
) -> Substitution | None:
    """Replace a delta light by a small area light.

    Parameters
    ----------
    state : parser state
    index : int
        Node of the light.
    size : float
        Radius over distance from the moving shapes; half the angle of a directional light's disk.
    intensity : array, shape (3,)
    context : LightContext
    unseen : bool
        Whether rays that hit the area light by chance must not see its radiance.

    Returns
    -------
    Substitution or None
        None if a spot lights none of the moving shapes; it is not replaced.
    """
    props = state.nodes[index].props
    plugin, light_id = props.plugin_name(), props.id()
    to_world = np.array(props["to_world"].matrix, dtype=np.float64) if "to_world" in props else np.eye(4)
    if plugin == "directional":
        direction = np.array(props["direction"]) if "direction" in props else to_world[:3, 2]
        area_light = _disk(direction / np.linalg.norm(direction), size, context)
    else:
        origin = np.array(props["position"]) if "position" in props else to_world[:3, 3]
        if plugin == "spot" and not _lights_moving_shapes(props, to_world, origin, context):
            return None
        area_light = _sphere(origin, to_world if plugin == "spot" else None, size, context)
    emitter = mi.Properties(register_proxy_emitter() if unseen or plugin == "spot" else "area")
    surface = mi.Properties("diffuse")
    if plugin == "spot":
        emitter["cutoff_angle"] = cutoff = _cutoff_angle(props)
        emitter["beam_width"] = float(props["beam_width"]) if "beam_width" in props else DEFAULT_BEAM_FRACTION * cutoff
    emitter["radiance"] = mi.ScalarColor3f((area_light.factor * intensity).tolist())
    surface["reflectance"] = 0.0
    children = {"emitter": (emitter, mi.ObjectType.Emitter), "bsdf": (surface, mi.ObjectType.BSDF)}
    for child_props, child_type in children.values():
        child = mi.parser.SceneNode()
        child.props, child.type = child_props, child_type
        state.nodes.append(child)  # moves all nodes in memory: earlier references to them are invalid
    node = state.nodes[index]
    for key in list(node.props.keys()):
        del node.props[key]
    node.props.set_plugin_name(area_light.shape)
    node.props.set_id(light_id)
    node.props["to_world"] = area_light.pose @ mi.ScalarTransform4f().scale(area_light.radius)
    for child_index, key in enumerate(children, len(state.nodes) - len(children)):
        node.props[key] = mi.Properties.ResolvedReference(child_index)
    node.type = mi.ObjectType.Shape
    suffix = "" if light_id.startswith(LIGHT_ID) else f" {light_id!r}"
    cause = "the motion of a delta light, and of its shadows seen in other surfaces, has no gradient"
    reason = f"{area_light.description}, because {cause}"
    # The scene itself has all gradients except of shadows, with less noise.
    return Substitution(f"{plugin} light{suffix}", reason, only_shadows=True, light=light_id, factor=area_light.factor)


def _disk(direction: Float64Array, half_angle: float, context: LightContext) -> _AreaLight:
    distance = SUN_DISTANCE * context.radius
    origin = context.centre - distance * direction
    up = np.eye(3)[int(np.argmin(np.abs(direction)))]
    pose = mi.ScalarTransform4f().look_at(origin.tolist(), context.centre.tolist(), up.tolist())
    # The irradiance of a disk of half angle a, on a surface that faces it, is pi sin(a)^2 times its radiance.
    factor = 1.0 / (math.pi * math.sin(half_angle) ** 2)
    description = f"a disk of {math.degrees(2.0 * half_angle):.2g} degrees"
    return _AreaLight("disk", distance * math.tan(half_angle), pose, factor, description)


def _sphere(origin: Float64Array, to_world: Float64Array | None, size: float, context: LightContext) -> _AreaLight:
    """Return a sphere for a point light, or with `to_world` for a spot, oriented as its cone."""
    relative = size * context.distance(origin)
    largest, smallest = MAX_RADIUS * context.smallest_half_size, MIN_RADIUS * context.radius
    radius = initial = max(min(relative, largest), smallest)
    while radius > smallest and not context.preserves_visibility(origin, radius):
        radius = max(0.5 * radius, smallest)
    pose = mi.ScalarTransform4f().translate(origin.tolist())
    if to_world is not None:
        rotation = np.eye(4)
        rotation[:3, :3] = to_world[:3, :3] / np.linalg.norm(to_world[:3, :3], axis=0)
        pose = pose @ mi.ScalarTransform4f(rotation)
    rule = f"{size:g} of its distance from the moving shapes"
    if relative > largest:
        rule = "the size of the smallest moving shape"
    if radius < initial:
        rule = f"{rule}, reduced until it fits between the shapes around it"
    return _AreaLight("sphere", radius, pose, 1.0 / (math.pi * radius**2), f"a sphere of radius {radius:.3g}, {rule}")


def _lights_moving_shapes(props: Any, to_world: Any, origin: Any, context: LightContext) -> bool:
    """Return whether the bounding sphere of a moving shape reaches into the cone of a spot."""
    axis = to_world[:3, 2] / np.linalg.norm(to_world[:3, 2])
    cutoff = math.radians(_cutoff_angle(props))
    for lower, upper in context.boxes:
        offset = 0.5 * (lower + upper) - origin
        distance, radius = float(np.linalg.norm(offset)), 0.5 * float(np.linalg.norm(upper - lower))
        if distance <= radius:
            return True
        angle = math.acos(min(max(float(axis @ offset) / distance, -1.0), 1.0))
        if angle - math.asin(radius / distance) < cutoff:
            return True
    return False


def _cutoff_angle(props: Any) -> float:
    """Return the half angle of a spot's cone, in degrees."""
    return float(props["cutoff_angle"]) if "cutoff_angle" in props else DEFAULT_CUTOFF_DEG
