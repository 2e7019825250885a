"""The traits of a scene and its optimised parameters that decide which effects are needed."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import mitsuba as mi
import numpy as np

from loi_mitsuba.scene.parameters import SceneIndex
from loi_mitsuba.scene.poses import PoseParameter, Translate
from mitsuba_boundaries.diagnostics import has_medium
from mitsuba_boundaries.geometry.bounds import bounding_box
from mitsuba_boundaries.parameter_names import ancestors

__all__ = ["VOLUME_INTEGRATORS", "Traits", "group_by_shape", "group_by_unit", "is_known", "kind_of", "traits_of"]

CONVEX_SHAPES: Final = ("Sphere", "Rectangle", "Disk", "Cube")
KNOWN_SHAPES: Final = (*CONVEX_SHAPES, "Cylinder", "BSplineCurve", "LinearCurve")  # and all meshes
SURFACE_INTEGRATORS: Final = {  # with their depth, or None if it is a setting
    "PathIntegrator": None,
    "DirectIntegrator": 2,
    "PRBIntegrator": None,
    "BasicPRBIntegrator": None,
    "DirectProjectiveIntegrator": 2,
    "PathProjectiveIntegrator": None,
}
VOLUME_INTEGRATORS: Final = ("VolumetricSimplePathIntegrator", "VolumetricMisPathIntegrator", "PRBVolpathIntegrator")
RADIANCE_ENTRIES: Final = ("value", "data", "scale")
UNLIMITED_DEPTH: Final = 8  # for a scene without a limit
MAX_DEPTH: Final = 2**31


@dataclass(frozen=True)
class Traits:
    """The traits of a scene and its optimised parameters.

    Attributes
    ----------
    moving : dict of mi.Shape
        The shape that each parameter moves.
    appearance, emission, volumes : tuple of str
        Parameters that change materials, emitters, and media.
    unknown : tuple of str
        Descriptions of everything that the rules do not know.
    is_single_convex_shape : bool
        Whether the scene is one opaque convex shape, not around the camera: it neither shadows nor lights itself.
    delta_reflection, delta_transmission, glossy : bool
        Whether a BSDF has lobes of that kind.
    has_delta_lights, has_medium : bool
    integrator : str
        Kind of the scene's own integrator.
    depth : int
        Path depth of the scene.
    is_depth_limited : bool
        Whether the scene sets that depth.
    hide_emitters : bool
        Whether the scene's integrator hides emitters from the camera.
    reaches_border, samples_border : bool
        Whether the film's filter reaches over the border of the image, and whether the film samples beyond it.
    substitutions : dict of str
        Objects that the proxy scene replaces, with reasons.
    has_delta_bsdf : bool
        Whether the proxy scene still has perfectly smooth surfaces.
    attached, blurred : dict of str
        Parameters with attached and with blurred gradients, with reasons. The other fields ignore them.
    """

    moving: Mapping[str, Any]
    appearance: tuple[str, ...]
    emission: tuple[str, ...]
    volumes: tuple[str, ...]
    unknown: tuple[str, ...]
    is_single_convex_shape: bool
    delta_reflection: bool
    delta_transmission: bool
    glossy: bool
    has_delta_lights: bool
    has_medium: bool
    integrator: str
    depth: int
    is_depth_limited: bool
    hide_emitters: bool
    reaches_border: bool
    samples_border: bool
    substitutions: Mapping[str, str] = field(default_factory=dict)
    has_delta_bsdf: bool = True
    attached: Mapping[str, str] = field(default_factory=dict)
    blurred: Mapping[str, str] = field(default_factory=dict)

    @property
    def unlit_mirrors(self) -> bool:
        """Whether the scene has both delta lights and perfectly smooth surfaces, which do not show them."""
        return self.has_delta_lights and (self.delta_reflection or self.delta_transmission)


def traits_of(index: SceneIndex, targets: Mapping[str, str | PoseParameter], sensor: Any) -> Traits:
    """Return the traits of a scene whose optimised parameters have these targets."""
    unknown: list[str] = []
    moving: dict[str, Any] = {}
    changed: dict[str, list[str]] = {"appearance": [], "emission": [], "volumes": []}
    scene = index.scene
    params = mi.traverse(scene)
    for name, target in targets.items():
        if not isinstance(target, str):
            moving[name] = index.find_shape(target.shape)[1]
            continue
        key = index.find(target).key
        category, node = _category(params, key)
        if category == "moving":
            moving[name] = node
        elif category:
            changed[category].append(name)
        else:
            unknown.append(f"parameter {name!r}, of a {node.class_name()}")
    shapes = scene.shapes()
    classes = dict.fromkeys(shape.class_name() for shape in shapes if not isinstance(shape, mi.Mesh))
    unknown += [f"a shape of kind {class_name}" for class_name in classes if class_name not in KNOWN_SHAPES]
    integrator = scene.integrator()
    integrator_kind = kind_of(integrator)
    if not is_known(integrator_kind):
        unknown.append(f"the scene's own integrator, a {integrator.class_name()}")
    flags = [int(shape.bsdf().flags()) for shape in shapes if shape.bsdf() is not None]
    medium = has_medium(scene)
    fixed_depth = SURFACE_INTEGRATORS.get(integrator_kind)
    limit = fixed_depth if fixed_depth is not None else _depth_limit(integrator)
    transmits = any(flag & int(mi.BSDFFlags.Transmission) for flag in flags)
    film = sensor.film()
    return Traits(
        moving=moving,
        appearance=tuple(changed["appearance"]),
        emission=tuple(changed["emission"]),
        volumes=tuple(changed["volumes"]),
        unknown=tuple(unknown),
        is_single_convex_shape=_is_single_convex_shape(shapes, sensor) and not transmits and not medium,
        delta_reflection=any(flag & int(mi.BSDFFlags.DeltaReflection) for flag in flags),
        delta_transmission=any(flag & int(mi.BSDFFlags.DeltaTransmission) for flag in flags),
        glossy=any(flag & int(mi.BSDFFlags.Glossy) for flag in flags),
        has_delta_lights=any(mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta) for emitter in scene.emitters()),
        has_medium=medium,
        integrator=integrator_kind,
        depth=UNLIMITED_DEPTH if limit is None else limit,
        is_depth_limited=limit is not None,
        hide_emitters=bool(getattr(integrator, "hide_emitters", False)),
        reaches_border=film.rfilter().border_size() > 0,
        samples_border=bool(film.sample_border()),
    )


def kind_of(integrator: Any) -> str:
    """Return the kind of an integrator from its description; the class name of a Python integrator is its base's."""
    return "PathIntegrator" if integrator is None else str(integrator).partition("[")[0].strip()


def is_known(integrator: str) -> bool:
    """Return whether the rules know an integrator of this kind, and Mitsuba's equivalent that has gradients."""
    return integrator in SURFACE_INTEGRATORS or integrator in VOLUME_INTEGRATORS


def group_by_unit(targets: Mapping[str, str | PoseParameter]) -> tuple[tuple[str, ...], ...]:
    """Group parameters whose gradients have the same unit: all translations, and each other parameter by itself."""
    translations = tuple(name for name, target in targets.items() if isinstance(target, Translate))
    singles = tuple((name,) for name in targets if name not in translations)
    return ((translations,) if translations else ()) + singles


def group_by_shape(names: Iterable[str], moving: Mapping[str, Any]) -> tuple[tuple[str, ...], ...]:
    """Group parameters that move the same shape; a parameter that moves none is alone.

    Parameters
    ----------
    names : iterable of str
    moving : dict of mi.Shape
        The shape that each parameter moves.
    """
    groups: dict[object, list[str]] = {}
    for name in names:
        groups.setdefault(moving.get(name, name), []).append(name)
    return tuple(map(tuple, groups.values()))


def _category(params: Any, key: str) -> tuple[str, Any]:
    """Return the trait that lists a parameter, or an empty string, and the object that the parameter belongs to."""
    node = params.properties[key][2]
    if isinstance(node, mi.Shape) and params.flags(key) & mi.ParamFlags.Discontinuous:
        return "moving", node
    for ancestor in reversed(ancestors(params, node)):
        for category, cls in (("emission", mi.Emitter), ("appearance", mi.BSDF), ("volumes", mi.Medium)):
            if isinstance(ancestor, cls):
                # Other entries of an emitter, such as the cone angle of a spot, may move the edges of lit regions.
                is_smooth = category != "emission" or key.rpartition(".")[2] in RADIANCE_ENTRIES
                return category if is_smooth else "", node
        if isinstance(ancestor, mi.Mesh):  # normals, texture coordinates and attributes of its vertices
            return "appearance", node
    return "", node


def _is_single_convex_shape(shapes: list[Any], sensor: Any) -> bool:
    if len(shapes) != 1 or shapes[0].class_name() not in CONVEX_SHAPES:
        return False
    camera = np.array(sensor.world_transform().translation(), dtype=np.float64).reshape(3)
    lower, upper = bounding_box(shapes[0])
    return not bool(np.all((lower <= camera) & (camera <= upper)))


def _depth_limit(integrator: Any) -> int | None:
    """Return the maximum depth of an integrator, or None without a limit."""
    depth = None if integrator is None else getattr(integrator, "max_depth", None)
    if depth is None:  # integrators in C++ show it only in their description
        match = re.search(r"max_depth = (-?\d+)", str(integrator))
        depth = int(match.group(1)) if match else -1
    return int(depth) if 0 <= int(depth) < MAX_DEPTH else None
