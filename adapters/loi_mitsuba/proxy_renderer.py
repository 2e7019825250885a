"""A renderer whose image comes from the scene, and the gradients of moving shapes from its proxy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np

from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.load import LoadedScene, ParameterTarget
from loi_mitsuba.scene.parameters import SceneIndex
from loi_mitsuba.scene.poses import Translate
from mitsuba_boundaries.drjit.arrays import Float32Array
from mitsuba_boundaries.parameter_names import ancestors
from mitsuba_boundaries.proxy.light_size import DELTA_LIGHTS, delta_lights
from mitsuba_boundaries.proxy.substitutions import LIGHT_ID, Substitution

__all__ = [
    "LightTarget",
    "ProxyGradientRenderer",
    "ProxyTarget",
    "light_targets",
    "lights_without_proxy",
    "proxy_targets",
]


@dataclass(frozen=True)
class ProxyTarget:
    """The target of a light's parameter in the proxy scene, set to ``(value - origin) * factor``.

    A delta light has an intensity and its proxy a radiance. A proxy in place of a light with a position is moved from
    that position.
    """

    target: ParameterTarget
    factor: float = 1.0
    origin: Float32Array | None = None


@dataclass(frozen=True)
class LightTarget:
    """A parameter of a delta light: the light's number, and the name of the entry or the handle."""

    light: int
    target: ParameterTarget

    @property
    def is_intensity(self) -> bool:
        """Whether it sets the intensity or irradiance of the light."""
        return self.target in ("intensity.value", "irradiance.value")

    def has_proxy(self, light_class: str) -> bool:
        """Return whether the proxy of a light of that class has an equivalent parameter."""
        moves = isinstance(self.target, Translate) or self.target == "position"
        return self.is_intensity or (moves and DELTA_LIGHTS[light_class] != "directional")


def light_targets(index: SceneIndex, targets: Mapping[str, ParameterTarget]) -> dict[str, LightTarget]:
    """Return the parameters that belong to delta lights."""
    params = mi.traverse(index.scene)
    lights = delta_lights(index.scene)
    parameters_of_lights = {}
    for name, target in targets.items():
        node, entry = None, target
        if not isinstance(target, str):
            node = index.find_movable(target.shape)[1]
        elif parameter := index.get(target):
            node, entry = params.properties[parameter.key][2], parameter.key.partition(".")[2]
        number = next((lights.index(ancestor) for ancestor in ancestors(params, node) if ancestor in lights), None)
        if number is not None:
            parameters_of_lights[name] = LightTarget(number, entry)
    return parameters_of_lights


def lights_without_proxy(index: SceneIndex, lights: Mapping[str, LightTarget]) -> list[Any]:
    """Return the delta lights with a parameter that no proxy has."""
    emitters = delta_lights(index.scene)
    return [
        emitters[target.light]
        for target in lights.values()
        if not target.has_proxy(emitters[target.light].class_name())
    ]


def proxy_targets(
    lights: Mapping[str, LightTarget],
    substitutions: Iterable[Substitution],
    index: SceneIndex,
    start: Mapping[str, Float32Array],
) -> dict[str, ProxyTarget]:
    """Return the targets of light parameters in the proxy scene, for the initial values `start`."""
    factors = {substitution.light: substitution.factor for substitution in substitutions}
    ids = [light.id() or f"{LIGHT_ID}{number}" for number, light in enumerate(delta_lights(index.scene))]
    replaced = {}
    for name, parameter in lights.items():
        light, target = ids[parameter.light], parameter.target
        if not isinstance(target, str):
            replaced[name] = ProxyTarget(replace(target, shape=light))
        elif light not in factors:
            replaced[name] = ProxyTarget(f"{light}.{target}")
        elif parameter.is_intensity:
            replaced[name] = ProxyTarget(f"{light}.emitter.radiance.value", factors[light])
        else:
            replaced[name] = ProxyTarget(Translate(light), origin=start[name])
    return replaced


class ProxyGradientRenderer(MitsubaRenderer):
    """A :class:`MitsubaRenderer` that takes the gradients of moving shapes from a proxy scene.

    Parameters
    ----------
    scene, parameters, integrator, spp, spp_grad, sensor, without_gradient
        As for :class:`MitsubaRenderer`.
    proxy : LoadedScene
        The proxy scene, with all of the parameters.
    moving : names
        Parameters whose gradient comes from the proxy.
    replaced_targets : dict of ProxyTarget
        Parameters with other targets in the proxy.
    only_shadows : bool
        Whether the proxy contributes only the indirect boundary term, and the scene itself the others.
    """

    def __init__(
        self,
        scene: Any,
        parameters: Mapping[str, ParameterTarget],
        *,
        proxy: LoadedScene,
        moving: Iterable[str],
        replaced_targets: Mapping[str, ProxyTarget],
        only_shadows: bool = False,
        integrator: Any = None,
        spp: int = 16,
        spp_grad: int | None = None,
        sensor: int = 0,
        without_gradient: Iterable[str] = (),
    ) -> None:
        self._moving = frozenset(moving)
        self._proxy_only = frozenset() if only_shadows else self._moving  # no gradient from the scene itself
        self._replaced_targets = dict(replaced_targets)
        images = tuple(without_gradient)
        targets = {**parameters, **{name: replaced.target for name, replaced in replaced_targets.items()}}
        options: dict[str, Any] = {"spp": spp, "spp_grad": spp_grad, "sensor": sensor, "without_gradient": images}
        self._proxy = MitsubaRenderer(proxy, targets, integrator=integrator, **options).with_integrator(
            integrator, spp=spp, spp_grad=spp_grad, wrt=self._moving
        )
        self._proxy_shapes = {name: value.shape for name, value in self._proxy.parameters().items()}
        super().__init__(scene, parameters, integrator=integrator, **options)
        if only_shadows:
            self._proxy._set_wrt(self._proxy.wrt, frozenset({"sppc", "sppp"}))
        excluded = frozenset({"sppi"}) if only_shadows else frozenset()
        self._set_wrt(frozenset(self._differentiable) - self._proxy_only, excluded)

    @property
    def proxy_scene(self) -> Any:
        """The proxy scene, an ``mi.Scene``."""
        return self._proxy.scene

    def with_integrator(
        self,
        integrator: Any,
        *,
        spp: int | None = None,
        spp_grad: int | None = None,
        wrt: Iterable[str] | None = None,
    ) -> ProxyGradientRenderer:
        """Return a renderer with another integrator for both scenes; see :meth:`MitsubaRenderer.with_integrator`."""
        names = set(self._binding.targets if wrt is None else wrt)
        renderer = copy(self)
        renderer._set_integrator(integrator, self._spp if spp is None else spp, spp_grad)
        renderer._set_wrt(names - self._proxy_only)
        renderer._proxy = self._proxy.with_integrator(integrator, spp=spp, spp_grad=spp_grad, wrt=names & self._moving)
        return renderer

    def vjp(self, params: Mapping[str, Any], cotangent: Any, *, seed: int = 0) -> dict[str, Float32Array]:
        """Return the sum of both scenes' gradients; see :meth:`MitsubaRenderer.vjp`."""
        self._leaves(params)  # checks them
        gradient = {name: np.zeros_like(start) for name, start in self._binding.start.items()}
        if self._wrt:
            gradient |= super().vjp(params, cotangent, seed=seed)
        if self._proxy.wrt:
            from_proxy = self._proxy.vjp(self._to_proxy(params), cotangent, seed=seed)
            gradient |= {name: gradient[name] + from_proxy[name] for name in self._moving}
        return gradient

    def jvp(self, params: Mapping[str, Any], tangent: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        """Return the sum of both scenes' derivatives; see :meth:`MitsubaRenderer.jvp`."""
        derivatives = []
        if self._wrt:
            derivatives.append(super().jvp(params, tangent, seed=seed))
        if self._proxy.wrt:
            derivatives.append(self._proxy.jvp(self._to_proxy(params), self._to_proxy(tangent), seed=seed))
        return np.asarray(sum(derivatives), dtype=np.float32)  # a derivative without any term is a single 0

    def _to_proxy(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of the proxy's parameters, whose lights have three channels where one was grey."""
        values = {}
        for name, value in params.items():
            values[name] = np.asarray(value, dtype=np.float32)
            replaced = self._replaced_targets.get(name)
            if replaced is not None:
                offset = values[name] if replaced.origin is None else values[name] - replaced.origin
                values[name] = np.broadcast_to(offset * np.float32(replaced.factor), self._proxy_shapes[name])
        return values

    def _check_gradients(self, *, is_planned: bool) -> None:
        """Skip the warnings of the scene itself: the proxy has warned about the gradients that are used."""
