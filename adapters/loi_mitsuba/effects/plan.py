"""Plan the effects of a scene without fitting it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from loi_core.effects import EffectPlan
from loi_core.objectives.base import Objective
from loi_core.support.keywords import suggest_keywords
from loi_mitsuba.effects.renderer import FRACTION, PlannedRenderer
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import Scene
from mitsuba_boundaries.proxy.scene import ProxySettings

__all__ = ["plan_effects"]


@suggest_keywords
def plan_effects(
    scene: dict[str, Any] | str | Path | Scene,
    optimised: Mapping[str, ParameterTarget | Mapping[str, Any]],
    *,
    objective: Objective | None = None,
    params: Mapping[str, Any] | None = None,
    spp: int = 16,
    fraction: float = FRACTION,
    sensor: int = 0,
    seed: int = 0,
    proxy: ProxySettings | Mapping[str, float] | None = ProxySettings(),  # noqa: B008 - frozen
    blur: Mapping[str, Any] | None = MappingProxyType({}),
    attached_lights: bool = True,
    attached_glass: bool = True,
) -> EffectPlan:
    """Return the effects that a scene needs when these parameters are optimised.

    Parameters
    ----------
    scene, optimised, sensor
        As `scene`, `parameters` and `sensor` of :class:`MitsubaRenderer`.
    objective : Objective, optional
        The loss. Without a loss there is no pilot, and the plan follows the rules.
    params : dict of arrays, optional
        Where the pilot measures; the scene's own values by default.
    spp, fraction, proxy, blur, attached_lights, attached_glass
        As for :class:`PlannedRenderer`.
    seed : int
        Seed of the pilot.

    Returns
    -------
    EffectPlan
        ``print`` shows it; :class:`MitsubaRenderer` accepts it as its integrator.

    Raises
    ------
    SceneLoadError, ParameterError, OptionError
        As :class:`MitsubaRenderer`.
    """
    renderer = PlannedRenderer(
        scene,
        optimised,
        spp=spp,
        fraction=fraction,
        sensor=sensor,
        proxy=proxy,
        blur=blur,
        attached_lights=attached_lights,
        attached_glass=attached_glass,
    )
    if objective is not None:
        values = renderer.parameters() if params is None else dict(params)
        cotangent = objective.value_and_grad(renderer.render(values, seed=seed))[1]
        renderer = renderer.start(values, cotangent, seed=seed)
    return renderer.plan
