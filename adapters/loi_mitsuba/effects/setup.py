"""The scene that a plan is made for: what it lacks gradients of, and its neighbour that has some of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi

from loi_core.errors import ParameterError
from loi_core.renderers.blurred import names_to_blur
from loi_mitsuba.attached.gradient import AttachedParameters
from loi_mitsuba.effects.rules import plan_by_rules
from loi_mitsuba.effects.traits import Traits, traits_of
from loi_mitsuba.effects.unsupported import unsupported_parameters
from loi_mitsuba.geometry.mesh import is_flat_shaded
from loi_mitsuba.geometry.mesh_checks import is_sharp_edged, is_unwelded
from loi_mitsuba.geometry.stepped_textures import has_stepped_texture, is_stepped_texture
from loi_mitsuba.proxy.light_size import LightContext, delta_lights
from loi_mitsuba.proxy.scene import MovingShapes, ProxyScene, ProxySettings, build_proxy_scene
from loi_mitsuba.proxy_renderer import ProxyGradientRenderer, light_targets, proxy_targets
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.binding import ParameterBinding
from loi_mitsuba.scene.load import (
    ParameterTarget,
    checked_samples,
    checked_targets,
    find_sensor,
    max_samples,
    use_variant,
)
from loi_mitsuba.scene.parameters import SceneIndex, ancestors, index_scene
from loi_mitsuba.scene.settings import bordered
from loi_mitsuba.sensing.frustum import Frustum

__all__ = ["Base", "prepare_renderer"]


@dataclass(frozen=True)
class Base:
    """A scene by the rules' plan, with its neighbour where what moves calls for one.

    Also what that has exchanged, whether surfaces are left that are perfectly smooth, why which parameters have no
    gradient, and what can be followed.
    """

    renderer: MitsubaRenderer
    exchanged: Mapping[str, str]
    smooth: bool
    missing: Mapping[str, str]
    followed: AttachedParameters


def prepare_renderer(
    scene: Any,
    parameters: Any,
    sensor: int,
    spp: Any,
    near: ProxySettings,
    blur: Mapping[str, Any] | None,
    *,
    attached_lights: bool,
    attached_glass: bool,
) -> Base:
    """What a plan is made for.

    The film samples its border if need be. The plan comes first, so that warnings of missing gradients are about its
    integrator.
    """
    use_variant()
    targets = checked_targets(parameters)
    names = index_scene(scene, targets)
    found = find_sensor(names.scene, sensor)
    samples = checked_samples("spp", spp, max_samples(found.film()))
    missing = _missing(names, targets, found, blur)
    asked = {} if blur is None or blur.get("names") is None else missing
    free = {name: target for name, target in targets.items() if name not in asked}
    followed = AttachedParameters.of(names, free, found, lights=attached_lights, glass=attached_glass)
    images = tuple(name for name in targets if name in missing or name in followed.without_gradient)
    traits = traits_of(names, {name: target for name, target in targets.items() if name not in images}, found)
    plan = plan_by_rules(traits, samples)
    ready = bordered(scene, plan)
    if ready is not scene:
        names = index_scene(ready, targets)  # whose objects are others
        found = find_sensor(names.scene, sensor)
        followed = AttachedParameters.of(names, free, found, lights=attached_lights, glass=attached_glass)
        traits = traits_of(names, {name: target for name, target in targets.items() if name not in images}, found)
    options: dict[str, Any] = {"integrator": plan, "spp": spp, "sensor": sensor, "without_gradient": images}
    own = list(names.scene.shapes())
    moved = MovingShapes(
        frozenset(own.index(shape) for shape in traits.moving.values() if shape in own),
        _split_meshes(names, targets, traits.moving) if near.seams else {},
        _stepped_shapes(names, targets, traits.moving) if near.textures else {},
    )
    delta = traits.lights or traits.delta_reflection or traits.delta_transmission
    if traits.moving and not traits.media and (delta or moved.split or moved.stepped):
        for size in (near, replace(near, mirrors=0.0)):  # rough surfaces may lack what a parameter stands for
            try:
                pair = _neighboured(ready, names, targets, traits, moved, size, options)
            except ParameterError:
                continue
            if pair is None:
                break
            base, near_scene = pair
            exchanged = {one.what: one.reason for one in near_scene.exchanges}
            return Base(base, exchanged, near_scene.smooth, missing, followed)
    renderer = MitsubaRenderer(names.loaded, targets, **options)
    return Base(renderer, {}, smooth=True, missing=missing, followed=followed)


def _missing(
    names: SceneIndex, targets: Mapping[str, ParameterTarget], sensor: Any, blur: Mapping[str, Any] | None
) -> dict[str, str]:
    """The parameters to blur, each with the reason; those that are asked for, or that have no gradient."""
    if blur is None:
        return {}
    found = unsupported_parameters(names, targets, sensor)
    if blur.get("names") is None:
        return found
    return {name: found.get(name, "it was asked for") for name in names_to_blur(blur["names"], targets)}


def _split_meshes(
    called: SceneIndex, targets: Mapping[str, ParameterTarget], moving: Mapping[str, Any]
) -> dict[int, Any]:
    """By their numbers, meshes that are moved as a whole and store vertices of an edge more than once.

    Not those that are smooth in part and have hard edges: shared vertices would have them smooth throughout.
    """
    own = list(called.scene.shapes())
    whole = [shape for name, shape in moving.items() if not isinstance(targets[name], str)]
    parts = [shape for name, shape in moving.items() if isinstance(targets[name], str)]
    split = [one for one in whole if one in own and one not in parts and is_unwelded(one)]
    return {own.index(one): one for one in split if is_flat_shaded(one) or not is_sharp_edged(one)}


def _stepped_shapes(
    called: SceneIndex, targets: Mapping[str, ParameterTarget], moving: Mapping[str, Any]
) -> dict[int, Any]:
    """By their numbers, shapes that move and have textures with steps, of which no parameter is an entry."""
    own = list(called.scene.shapes())
    params = mi.traverse(called.scene)
    entries = (called.known(target) for target in targets.values() if isinstance(target, str))
    nodes = [one for entry in entries if entry for one in ancestors(params, params.properties[entry.key][2])]
    if any(is_stepped_texture(node) for node in nodes):
        return {}
    return {own.index(one): one for one in moving.values() if one in own and has_stepped_texture(one)}


def _neighboured(
    scene: Any,
    called: SceneIndex,
    targets: Mapping[str, ParameterTarget],
    traits: Traits,
    moved: MovingShapes,
    near: ProxySettings,
    options: dict[str, Any],
) -> tuple[ProxyGradientRenderer, ProxyScene] | None:
    """A scene and its neighbour, if there is something to exchange."""
    loaded = called.loaded
    lights = light_targets(called, targets)
    kinds = [one.class_name() for one in delta_lights(loaded.scene)]
    stay = [one.light for one in lights.values() if not one.can_follow(kinds[one.light])]
    moving = traits.moving
    around = LightContext.of(loaded.scene, moving.values(), stay)
    sensor = find_sensor(loaded.scene, options["sensor"])
    found = build_proxy_scene(
        scene,
        near,
        around,
        Frustum(sensor).overlaps,
        moved,
        float_textures=loaded.float_textures,
        unlit=traits.unlit_mirrors,
    )
    if found is None:
        return None
    start = ParameterBinding(called, targets, options["without_gradient"]).start
    exchanged = proxy_targets(lights, found, called, start)
    still = all(one.is_power for name, one in lights.items() if name not in options["without_gradient"])
    only_shadows = still and all(one.only_shadows for one in found.exchanges)
    base = ProxyGradientRenderer(
        loaded,
        targets,
        proxy=found.loaded,
        moving=moving,
        exchanged=exchanged,
        only_shadows=only_shadows,
        **options,
    )
    return base, found
