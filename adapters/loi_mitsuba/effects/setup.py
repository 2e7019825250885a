"""Prepare the renderer that a plan is made for: load the scene, find unsupported parameters, build the proxy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import mitsuba as mi

from loi_core.errors import ParameterError
from loi_core.renderers.blurred import names_to_blur
from loi_mitsuba.effects.attached_gradient import AttachedParameters
from loi_mitsuba.effects.rules import plan_by_rules
from loi_mitsuba.effects.traits import Traits, traits_of
from loi_mitsuba.effects.unsupported import unsupported_parameters
from loi_mitsuba.proxy_renderer import ProxyGradientRenderer, light_targets, proxy_targets
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.binding import ParameterBinding
from loi_mitsuba.scene.load import (
    LoadedScene,
    ParameterTarget,
    checked_samples,
    checked_targets,
    find_sensor,
    max_samples,
    parsed_scene,
    use_variant,
)
from loi_mitsuba.scene.parameters import SceneIndex, ancestors, index_scene
from loi_mitsuba.scene.settings import with_sampled_border
from mitsuba_boundaries.geometry.mesh import is_flat_shaded
from mitsuba_boundaries.geometry.mesh_checks import is_sharp_edged, is_unwelded
from mitsuba_boundaries.geometry.stepped_textures import has_stepped_texture, is_stepped_texture
from mitsuba_boundaries.proxy.light_size import LightContext, delta_lights
from mitsuba_boundaries.proxy.scene import MovingShapes, ProxyScene, ProxySettings, build_proxy_scene
from mitsuba_boundaries.sensing.frustum import Frustum

__all__ = ["PlanSetup", "prepare_renderer"]


@dataclass(frozen=True)
class PlanSetup:
    """The renderer of a scene by the rules, with its proxy where moving shapes need one.

    Attributes
    ----------
    renderer : MitsubaRenderer
    substitutions : dict of str
        Reason for each object that the proxy replaces.
    has_delta_bsdf : bool
        Whether the proxy still has perfectly smooth surfaces.
    unsupported : dict of str
        Reason for each parameter without a gradient.
    attached : AttachedParameters
    """

    renderer: MitsubaRenderer
    substitutions: Mapping[str, str]
    has_delta_bsdf: bool
    unsupported: Mapping[str, str]
    attached: AttachedParameters


def prepare_renderer(
    scene: Any,
    parameters: Any,
    sensor: int,
    spp: Any,
    proxy: ProxySettings,
    blur: Mapping[str, Any] | None,
    *,
    attached_lights: bool,
    attached_glass: bool,
) -> PlanSetup:
    """Prepare the renderer of a plan; arguments as for :class:`loi_mitsuba.PlannedRenderer`.

    The plan by the rules is made first, so that warnings about missing gradients refer to its integrator, and the film
    samples its border if the plan needs it.
    """
    use_variant()
    targets = checked_targets(parameters)
    index = index_scene(scene, targets)
    camera = find_sensor(index.scene, sensor)
    samples = checked_samples("spp", spp, max_samples(camera.film()))
    unsupported = _parameters_to_blur(index, targets, camera, blur)
    requested = {} if blur is None or blur.get("names") is None else unsupported
    attachable = {name: target for name, target in targets.items() if name not in requested}

    def analyse(index: SceneIndex) -> tuple[AttachedParameters, tuple[str, ...], Traits]:
        camera = find_sensor(index.scene, sensor)
        attached = AttachedParameters.of(index, attachable, camera, lights=attached_lights, glass=attached_glass)
        without_gradient = {*unsupported, *attached.without_gradient}
        differentiable = {name: target for name, target in targets.items() if name not in without_gradient}
        images_only = tuple(name for name in targets if name in without_gradient)
        return attached, images_only, traits_of(index, differentiable, camera)

    attached, images_only, traits = analyse(index)
    plan = plan_by_rules(traits, samples)
    bordered = with_sampled_border(scene, plan)
    if bordered is not scene:
        index = index_scene(bordered, targets)  # its objects are new
        attached, images_only, traits = analyse(index)
    options: dict[str, Any] = {"integrator": plan, "spp": spp, "sensor": sensor, "without_gradient": images_only}
    renderer, proxy_scene = _renderer_with_proxy(bordered, index, targets, traits, proxy, options)
    if proxy_scene is None:
        return PlanSetup(renderer, {}, has_delta_bsdf=True, unsupported=unsupported, attached=attached)
    substitutions = {replaced.original: replaced.reason for replaced in proxy_scene.substitutions}
    return PlanSetup(renderer, substitutions, proxy_scene.has_delta_bsdf, unsupported, attached)


def _parameters_to_blur(
    index: SceneIndex, targets: Mapping[str, ParameterTarget], sensor: Any, blur: Mapping[str, Any] | None
) -> dict[str, str]:
    """Return the requested parameters, or without a request the unsupported ones, each with the reason."""
    if blur is None:
        return {}
    unsupported = unsupported_parameters(index, targets, sensor)
    if blur.get("names") is None:
        return unsupported
    return {name: unsupported.get(name, "`blur` names it") for name in names_to_blur(blur["names"], targets)}


def _renderer_with_proxy(
    scene: Any,
    index: SceneIndex,
    targets: Mapping[str, ParameterTarget],
    traits: Traits,
    proxy: ProxySettings,
    options: Mapping[str, Any],
) -> tuple[MitsubaRenderer, ProxyScene | None]:
    """Return the renderer of a scene, and its proxy scene if moving shapes need one."""
    moving = _moving_shapes(index, targets, traits.moving, proxy)
    delta = traits.has_delta_lights or traits.delta_reflection or traits.delta_transmission
    if traits.moving and not traits.has_medium and (delta or moving.unwelded or moving.stepped):
        # A parameter of a smooth surface may not exist in the rough one that replaces it.
        for settings in (proxy, replace(proxy, mirrors=0.0)):
            try:
                built = _proxy_renderer(scene, index, targets, traits, moving, settings, options)
            except ParameterError:
                continue
            if built is None:
                break
            return built
    return MitsubaRenderer(index.loaded, targets, **options), None


def _moving_shapes(
    index: SceneIndex, targets: Mapping[str, ParameterTarget], moving: Mapping[str, Any], settings: ProxySettings
) -> MovingShapes:
    shapes = list(index.scene.shapes())
    return MovingShapes(
        frozenset(shapes.index(shape) for shape in moving.values() if shape in shapes),
        _unwelded_meshes(shapes, targets, moving) if settings.seams else {},
        _stepped_shapes(index, shapes, targets, moving) if settings.textures else {},
    )


def _unwelded_meshes(
    shapes: list[Any], targets: Mapping[str, ParameterTarget], moving: Mapping[str, Any]
) -> dict[int, Any]:
    """Return by index the meshes with split vertices that move as a whole.

    A mesh with both smooth shading and sharp edges is left out, because welding would make it smooth throughout.
    """
    rigid = [shape for name, shape in moving.items() if not isinstance(targets[name], str)]
    deformed = [shape for name, shape in moving.items() if isinstance(targets[name], str)]
    unwelded = [shape for shape in rigid if shape in shapes and shape not in deformed and is_unwelded(shape)]
    return {shapes.index(shape): shape for shape in unwelded if is_flat_shaded(shape) or not is_sharp_edged(shape)}


def _stepped_shapes(
    index: SceneIndex, shapes: list[Any], targets: Mapping[str, ParameterTarget], moving: Mapping[str, Any]
) -> dict[int, Any]:
    """Return by index the moving shapes with stepped textures; none if a parameter belongs to such a texture."""
    params = mi.traverse(index.scene)
    parameters = (index.get(target) for target in targets.values() if isinstance(target, str))
    nodes = [
        node for parameter in parameters if parameter for node in ancestors(params, params.properties[parameter.key][2])
    ]
    if any(is_stepped_texture(node) for node in nodes):
        return {}
    return {shapes.index(shape): shape for shape in moving.values() if shape in shapes and has_stepped_texture(shape)}


def _proxy_renderer(
    scene: Any,
    index: SceneIndex,
    targets: Mapping[str, ParameterTarget],
    traits: Traits,
    moving: MovingShapes,
    settings: ProxySettings,
    options: Mapping[str, Any],
) -> tuple[ProxyGradientRenderer, ProxyScene] | None:
    """Return a renderer with a proxy, and the proxy; None if nothing is replaced."""
    loaded, images_only = index.loaded, options["without_gradient"]
    lights = light_targets(index, targets)
    classes = [light.class_name() for light in delta_lights(loaded.scene)]
    unchanged = [light.light for light in lights.values() if not light.has_proxy(classes[light.light])]
    proxy = build_proxy_scene(
        scene,
        settings,
        LightContext.of(loaded.scene, traits.moving.values(), unchanged),
        Frustum(find_sensor(loaded.scene, options["sensor"])).overlaps,
        moving,
        parse=partial(parsed_scene, float_textures=loaded.float_textures),
        unlit=traits.unlit_mirrors,
    )
    if proxy is None:
        return None
    start = ParameterBinding(index, targets, images_only).start
    # The gradient of a moving light comes from the proxy; all other lights have theirs in the scene itself.
    lights_at_rest = all(light.is_intensity for name, light in lights.items() if name not in images_only)
    renderer = ProxyGradientRenderer(
        loaded,
        targets,
        proxy=LoadedScene(proxy.scene, not isinstance(scene, mi.Scene), loaded.float_textures),
        moving=traits.moving,
        replaced_targets=proxy_targets(lights, proxy, index, start),
        only_shadows=lights_at_rest and all(substitution.only_shadows for substitution in proxy.substitutions),
        **options,
    )
    return renderer, proxy
