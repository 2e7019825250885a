"""What a neighbouring scene has instead of what Mitsuba has no gradient of."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import mitsuba as mi
import numpy as np

from loi_mitsuba.geometry.mesh_checks import has_creases
from loi_mitsuba.geometry.stepped_textures import RAMP, ramp_texture
from loi_mitsuba.plugins.proxy_bsdf import register_proxy_bsdf
from loi_mitsuba.plugins.proxy_emitter import register_proxy_emitter
from loi_mitsuba.proxy.light_size import LightContext
from loi_mitsuba.scene.queries import parts_of

__all__ = [
    "LAMP",
    "LIGHT",
    "MOVING",
    "ROUGH",
    "Substitution",
    "interpolate_textures",
    "substitute_light",
    "substitute_surface",
    "welding_of",
]

ROUGH: Final = {"conductor": "roughconductor", "dielectric": "roughdielectric", "plastic": "roughplastic"}
LAMP: Final = "loi_lamp_"  # and a number: what stands for a light is called so
LIGHT: Final = "loi_light_"  # and a number: a light without a name is called so
MOVING: Final = 6.0  # times as rough as a mirror that stands still is one that moves
WIDEST: Final = 2.0  # times what casts a shadow: its umbra then reaches as far behind it as the lamp is before it
FAR: Final = 100.0  # how many times the scene's radius away the disk is that stands for a directional light


@dataclass(frozen=True)
class Substitution:
    """One thing that the neighbour has instead of another: what, and in a line why and how large.

    Also whether nothing but shadows is any better for it, and of a light, which of the scene's lights without a size it
    is, from 0, and how many times its intensity the radiance is of what stands for it.
    """

    what: str
    reason: str
    only_shadows: bool = False
    light: int | None = None
    factor: float = 1.0


def substitute_surface(
    state: Any, index: int, size: float, exchanges: list[Substitution], *, moves: bool, unlit: bool
) -> None:
    """Make a perfectly smooth surface slightly rough, that of what moves rougher.

    It is `unlit` where it shall not reflect light that comes straight from a lamp that is sampled.
    """
    props = state.nodes[index].props
    kind = props.plugin_name()
    moves = moves and kind != "dielectric"  # through which nothing would be seen
    alpha = min(MOVING * size, 1.0) if moves else size
    props.set_plugin_name(ROUGH[kind])
    props["alpha"] = alpha
    named = f" {props.id()!r}" if props.id() else ""
    why = "edges seen in what is perfectly smooth have no gradient"
    also = ", and that of what moves has the less noise, the rougher it is" if moves else ""
    exchanges.append(Substitution(f"{kind}{named}", f"a {ROUGH[kind]} of roughness {alpha:g}, for {why}{also}"))
    if unlit:
        rough = mi.parser.SceneNode()
        rough.props, rough.type = mi.Properties(ROUGH[kind]), mi.ObjectType.BSDF
        for key in list(props.keys()):
            rough.props[key] = props[key]
            del props[key]
        props.set_plugin_name(register_proxy_bsdf())
        props["rough"] = mi.Properties.ResolvedReference(len(state.nodes))
        state.nodes.append(rough)  # which moves all nodes: what was referred to before is gone


def interpolate_textures(state: Any, number: int, shape: Any, exchanges: list[Substitution]) -> None:
    """Interpolate the textures of a shape that have steps."""
    for part in parts_of(state, number, mi.ObjectType.Texture):
        node = state.nodes[part]
        kind = node.props.plugin_name()
        if ramp_texture(node.props):
            named = f" of {shape.id()!r}" if shape.id() else ""
            exchanges.append(Substitution(f"{kind}{named}", f"an interpolated bitmap {RAMP}"))


def welding_of(shape: Any) -> Substitution:
    """Of a mesh whose vertices are shared: what is told of it."""
    named = f" {shape.id()!r}" if shape.id() else ""
    reason = "with the vertices at one place shared, for an edge that is stored twice has its gradient twice"
    # A box whose corners are shared has another texture. Its outlines are drawn in the scene itself, and so is that.
    return Substitution(f"mesh{named}", reason, only_shadows=has_creases(shape))


def substitute_light(
    state: Any,
    index: int,
    number: int,
    size: float,
    power: Any,
    around: LightContext,
    exchanges: list[Substitution],
    *,
    unseen: bool,
) -> None:
    """Put a lamp with a size, called by the light's number, where a light without one is.

    It is `unseen` where rays that hit it by chance shall not find its light.
    """
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
        if kind == "spot":  # whose cone turns with it
            turned = np.eye(4)
            turned[:3, :3] = place[:3, :3] / np.linalg.norm(place[:3, :3], axis=0)
            pose = pose @ mi.ScalarTransform4f(turned)
        factor = 1.0 / (math.pi * radius**2)
        of = f"{size:g} of its distance from what moves" if share <= most else f"{WIDEST:g} times that of what moves"
        of = f"{of}, less to stay within what is around it" if radius < widest else of
        how = f"a sphere of radius {radius:.3g}, {of}, for"
    lamp = mi.Properties(register_proxy_emitter() if unseen or kind == "spot" else "area")
    surface = mi.Properties("diffuse")
    if kind == "spot":
        lamp["cutoff_angle"] = cutoff = _cutoff(props)
        lamp["beam_width"] = float(props["beam_width"]) if "beam_width" in props else 0.75 * cutoff
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
    # All but shadows is the scene's own, with less noise; but by what moves, Mitsuba has no gradient of a spot's cone.
    only_shadows = kind != "spot"
    reason = f"{how} a shadow of light from a point has no gradient"
    exchanges.append(
        Substitution(f"{kind} light{named}", reason, only_shadows=only_shadows, light=number, factor=factor)
    )


def _lights(props: Any, place: Any, origin: Any, around: LightContext) -> bool:
    """Whether anything that moves reaches into the cone of a spot, as spheres around the boxes tell."""
    along = place[:3, 2] / np.linalg.norm(place[:3, 2])
    cutoff = math.radians(_cutoff(props))
    for low, high in around.boxes:
        towards = 0.5 * (low + high) - origin
        away, radius = float(np.linalg.norm(towards)), 0.5 * float(np.linalg.norm(high - low))
        if away <= radius:
            return True
        angle = math.acos(min(max(float(along @ towards) / away, -1.0), 1.0))
        if angle - math.asin(radius / away) < cutoff:
            return True
    return False


def _cutoff(props: Any) -> float:
    """The half-angle of a spot's cone, in degrees."""
    return float(props["cutoff_angle"]) if "cutoff_angle" in props else 20.0
