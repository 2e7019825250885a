"""What a loaded scene has that decides which effects it calls for."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import mitsuba as mi
import numpy as np

from loi_mitsuba.geometry.bounds import bounding_box
from loi_mitsuba.scene.parameters import SceneIndex, ancestors
from loi_mitsuba.scene.poses import PoseParameter, Translate
from loi_mitsuba.scene.queries import has_medium

__all__ = ["VOLUME_INTEGRATORS", "Traits", "group_by_unit", "is_known", "kind_of", "traits_of"]

CONVEX: Final = ("Sphere", "Rectangle", "Disk", "Cube")
SHAPES: Final = (*CONVEX, "Cylinder", "BSplineCurve", "LinearCurve")  # and every mesh
SURFACE_INTEGRATORS: Final = {
    "PathIntegrator": None,
    "DirectIntegrator": 2,
    "PRBIntegrator": None,
    "BasicPRBIntegrator": None,
    "DirectProjectiveIntegrator": 2,
    "PathProjectiveIntegrator": None,
}
VOLUME_INTEGRATORS: Final = ("VolumetricSimplePathIntegrator", "VolumetricMisPathIntegrator", "PRBVolpathIntegrator")
RADIANCE: Final = ("value", "data", "scale")
UNLIMITED: Final = 8  # stands for all bounces of a scene that sets no limit
MOST_DEPTH: Final = 2**31


@dataclass(frozen=True)
class Traits:
    """What matters about a scene and what is optimised in it.

    Attributes
    ----------
    moving : dict of mi.Shape
        By parameter, the shape that it moves.
    appearance, emission, volumes : tuple of str
        Parameters that change materials, emitters, and media.
    unknown : tuple of str
        What the rules do not know, in words; empty if they know everything.
    alone : bool
        Whether there is one shape only, convex, opaque and not around the camera: it neither shadows nor lights itself.
    delta_reflection, delta_transmission, glossy : bool
        Whether a surface is a perfect mirror, is clear glass, or reflects or transmits in a lobe.
    lights : bool
        Whether a light is a point or comes from one direction, so that hardly any ray hits it.
    media : bool
        Whether there is a participating medium.
    own_integrator : str
        Kind of the scene's own integrator.
    depth : int
        The deepest paths that the scene asks for.
    limited : bool
        Whether that is the scene's own limit.
    hide_emitters : bool
        Whether the scene's own integrator hides emitters from the camera.
    reaches_border : bool
        Whether the film's filter reaches over the border of the image.
    samples_border : bool
        Whether the film samples there.
    exchanged : dict of str
        What a neighbouring scene, from which the gradient by what moves is taken, has otherwise, and why.
    smooth : bool
        Whether surfaces are left there that are perfectly smooth.
    followed : dict of str
        By parameter that moves a light, and is not among the others, what is to be said of its gradient.
    blurred : dict of str
        By parameter whose gradient is of images blurred over it, and which is not among the others, why.
    """

    moving: Mapping[str, Any]
    appearance: tuple[str, ...]
    emission: tuple[str, ...]
    volumes: tuple[str, ...]
    unknown: tuple[str, ...]
    alone: bool
    delta_reflection: bool
    delta_transmission: bool
    glossy: bool
    lights: bool
    media: bool
    own_integrator: str
    depth: int
    limited: bool
    hide_emitters: bool
    reaches_border: bool
    samples_border: bool
    exchanged: Mapping[str, str] = field(default_factory=dict)
    smooth: bool = True
    followed: Mapping[str, str] = field(default_factory=dict)
    blurred: Mapping[str, str] = field(default_factory=dict)

    @property
    def unlit_mirrors(self) -> bool:
        """Whether perfectly smooth surfaces are there, and lights without a size, which no path finds in them."""
        return self.lights and (self.delta_reflection or self.delta_transmission)


def traits_of(called: SceneIndex, targets: Mapping[str, str | PoseParameter], sensor: Any) -> Traits:
    """Traverse a scene and find out what `targets`, the optimised parameters by name, change in it."""
    unknown: list[str] = []
    moving: dict[str, Any] = {}
    changed: dict[str, list[str]] = {"appearance": [], "emission": [], "volumes": []}
    scene = called.scene
    params = mi.traverse(scene)
    for name, target in targets.items():
        if not isinstance(target, str):
            moving[name] = called.find_shape(target.shape)[1]
            continue
        key = called.find(target).key
        kind, node = _kind(params, key)
        if kind == "moving":
            moving[name] = node
        elif kind:
            changed[kind].append(name)
        else:
            unknown.append(f"parameter {name!r}, of a {node.class_name()}")
    shapes = scene.shapes()
    unknown += [
        f"a shape of kind {one.class_name()}"
        for one in _first_of_kind(shapes)
        if not isinstance(one, mi.Mesh) and one.class_name() not in SHAPES
    ]
    integrator = scene.integrator()
    kind = kind_of(integrator)
    if not is_known(kind):
        unknown.append(f"the scene's own integrator, a {integrator.class_name()}")
    flags = [int(shape.bsdf().flags()) for shape in shapes if shape.bsdf() is not None]
    media = has_medium(scene)
    fixed = SURFACE_INTEGRATORS.get(kind)
    limit = fixed if fixed is not None else _own_depth(integrator)
    transmits = any(one & int(mi.BSDFFlags.Transmission) for one in flags)
    film = sensor.film()
    return Traits(
        moving=moving,
        appearance=tuple(changed["appearance"]),
        emission=tuple(changed["emission"]),
        volumes=tuple(changed["volumes"]),
        unknown=tuple(unknown),
        alone=_alone(shapes, sensor) and not transmits and not media,
        delta_reflection=any(one & int(mi.BSDFFlags.DeltaReflection) for one in flags),
        delta_transmission=any(one & int(mi.BSDFFlags.DeltaTransmission) for one in flags),
        glossy=any(one & int(mi.BSDFFlags.Glossy) for one in flags),
        lights=any(mi.has_flag(one.flags(), mi.EmitterFlags.Delta) for one in scene.emitters()),
        media=media,
        own_integrator=kind,
        depth=UNLIMITED if limit is None else limit,
        limited=limit is not None,
        hide_emitters=bool(getattr(integrator, "hide_emitters", False)),
        reaches_border=film.rfilter().border_size() > 0,
        samples_border=bool(film.sample_border()),
    )


def kind_of(integrator: Any) -> str:
    """The kind of a scene's own integrator, by its words: the class name of those written in Python is their base's."""
    return "PathIntegrator" if integrator is None else str(integrator).partition("[")[0].strip()


def is_known(integrator: str) -> bool:
    """Whether the rules know this kind of integrator, and which of Mitsuba's stands for it."""
    return integrator in SURFACE_INTEGRATORS or integrator in VOLUME_INTEGRATORS


def group_by_unit(targets: Mapping[str, str | PoseParameter]) -> tuple[tuple[str, ...], ...]:
    """The parameters, those together whose gradients have one unit: all translations, and every other alone."""
    moves = tuple(name for name, target in targets.items() if isinstance(target, Translate))
    rest = tuple((name,) for name in targets if name not in moves)
    return ((moves,) if moves else ()) + rest


def _kind(params: Any, key: str) -> tuple[str, Any]:
    """Which of the lists an entry belongs to, empty for none, and the object that decides."""
    node = params.properties[key][2]
    if isinstance(node, mi.Shape) and params.flags(key) & mi.ParamFlags.Discontinuous:
        return "moving", node
    for one in reversed(ancestors(params, node)):  # from the entry's own object up to the scene
        for kind, cls in (("emission", mi.Emitter), ("appearance", mi.BSDF), ("volumes", mi.Medium)):
            if isinstance(one, cls):
                # An emitter's other entries, such as the angle of a spot, may move the edge of what it lights.
                known = kind != "emission" or key.rpartition(".")[2] in RADIANCE
                return kind if known else "", node
        if isinstance(one, mi.Mesh):  # normals, texture coordinates and attributes of its vertices
            return "appearance", node
    return "", node


def _alone(shapes: list[Any], sensor: Any) -> bool:
    if len(shapes) != 1 or shapes[0].class_name() not in CONVEX:
        return False
    eye = np.array(sensor.world_transform().translation(), dtype=np.float64).reshape(3)
    low, high = bounding_box(shapes[0])
    return not bool(np.all((low <= eye) & (eye <= high)))


def _first_of_kind(shapes: list[Any]) -> list[Any]:
    return list({shape.class_name(): shape for shape in shapes}.values())


def _own_depth(integrator: Any) -> int | None:
    """The limit of an integrator; None if it has none."""
    depth = None if integrator is None else getattr(integrator, "max_depth", None)
    if depth is None:  # those written in C++ show it only in words
        found = re.search(r"max_depth = (-?\d+)", str(integrator))
        depth = int(found.group(1)) if found else -1
    return int(depth) if 0 <= int(depth) < MOST_DEPTH else None
