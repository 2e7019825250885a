"""Prepare the renderer that a plan is made for: load the scene, find unsupported parameters, build the proxy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi

from loi_core.errors import ParameterError
from loi_core.renderers.blurred import names_to_blur
from loi_mitsuba.effects.attached_gradient import AttachedParameters
from loi_mitsuba.effects.rules import plan_by_rules
from loi_mitsuba.effects.traits import Traits, traits_of
from loi_mitsuba.effects.unsupported import unsupported_parameters
from loi_mitsuba.proxy_renderer import ProxyGradientRenderer, light_targets, lights_without_proxy, proxy_targets
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.binding import ParameterBinding
from loi_mitsuba.scene.load import (
    LoadedScene,
    ParameterTarget,
    checked_samples,
    checked_targets,
    find_sensor,
    use_variant,
)
from loi_mitsuba.scene.parameters import SceneIndex, index_scene
from loi_mitsuba.scene.settings import with_sampled_border
from mitsuba_boundaries.parameter_names import ancestors
from mitsuba_boundaries.proxy.scene import ProxySettings, build_proxy_scene, has_delta_bsdf
from mitsuba_boundaries.proxy.substitutions import Substitution
from mitsuba_boundaries.sensing.film import max_samples

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
    planned = _renderer_with_proxy(bordered, index, targets, traits, proxy, options)
    return PlanSetup(*planned, unsupported, attached)


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
) -> tuple[MitsubaRenderer, Mapping[str, str], bool]:
    """Return the first three fields of :class:`PlanSetup`."""
    if traits.moving and not traits.has_medium:
        # A parameter of a smooth surface may not exist in the rough one that replaces it.
        for settings in (proxy, replace(proxy, mirrors=0.0)):
            try:
                built = _proxy_renderer(scene, index, targets, traits, settings, options)
            except ParameterError:
                continue
            if built is None:
                break
            renderer, substitutions = built
            reasons = {replaced.original: replaced.reason for replaced in substitutions}
            return renderer, reasons, has_delta_bsdf(renderer.proxy_scene)
    return MitsubaRenderer(index.loaded, targets, **options), {}, True


def _proxy_renderer(
    scene: Any,
    index: SceneIndex,
    targets: Mapping[str, ParameterTarget],
    traits: Traits,
    settings: ProxySettings,
    options: Mapping[str, Any],
) -> tuple[ProxyGradientRenderer, Sequence[Substitution]] | None:
    """Return a renderer with a proxy, and its substitutions; None if nothing is replaced."""
    loaded, images_only = index.loaded, options["without_gradient"]
    lights = light_targets(index, targets)
    proxy = build_proxy_scene(
        scene,
        loaded.scene,
        list(dict.fromkeys(traits.moving.values())),
        sensor=find_sensor(loaded.scene, options["sensor"]),
        keep=[*_fitted_textures(index, targets), *lights_without_proxy(index, lights)],
        deforming=[shape for name, shape in traits.moving.items() if isinstance(targets[name], str)],
        settings=settings,
        float_textures=loaded.float_textures,
    )
    if proxy is None:
        return None
    proxy_scene, substitutions = proxy
    start = ParameterBinding(index, targets, images_only).start
    # The gradient of a moving light comes from the proxy; all other lights have theirs in the scene itself.
    lights_at_rest = all(light.is_intensity for name, light in lights.items() if name not in images_only)
    renderer = ProxyGradientRenderer(
        loaded,
        targets,
        proxy=LoadedScene(proxy_scene, not isinstance(scene, mi.Scene), loaded.float_textures),
        moving=traits.moving,
        replaced_targets=proxy_targets(lights, substitutions, index, start),
        only_shadows=lights_at_rest and all(substitution.only_shadows for substitution in substitutions),
        **options,
    )
    return renderer, substitutions


def _fitted_textures(index: SceneIndex, targets: Mapping[str, ParameterTarget]) -> list[Any]:
    """Return the textures that a parameter belongs to."""
    params = mi.traverse(index.scene)
    parameters = (index.get(target) for target in targets.values() if isinstance(target, str))
    nodes = [
        node for parameter in parameters if parameter for node in ancestors(params, params.properties[parameter.key][2])
    ]
    return [node for node in nodes if isinstance(node, mi.Texture)]
