"""A scene that is rendered as it is, with the gradient by what moves taken from its neighbour."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np

from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.proxy.light_size import KINDS, delta_lights
from loi_mitsuba.proxy.scene import ProxyScene
from loi_mitsuba.proxy.substitutions import LAMP, LIGHT
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.load import LoadedScene, ParameterTarget
from loi_mitsuba.scene.parameters import SceneIndex, ancestors
from loi_mitsuba.scene.poses import Translate

__all__ = ["LightTarget", "ProxyGradientRenderer", "ProxyTarget", "light_targets", "proxy_targets"]


@dataclass(frozen=True)
class ProxyTarget:
    """What a parameter of a light stands for in the proxy: for what, and the value less `origin`, times `factor`.

    A light without a size has an intensity, and the lamp that stands for it a radiance; and where that light has a
    position, the lamp is moved from where it is.
    """

    target: ParameterTarget
    factor: float = 1.0
    origin: Float32Array | None = None


@dataclass(frozen=True)
class LightTarget:
    """A parameter of a light without a size: its number, and the name of the entry, or the handle on it."""

    light: int
    target: ParameterTarget

    @property
    def is_power(self) -> bool:
        """Whether it sets how bright the light is."""
        return self.target in ("intensity.value", "irradiance.value")

    def can_follow(self, kind: str) -> bool:
        """Whether what stands for a light of that kind can do as it does."""
        moves = isinstance(self.target, Translate) or self.target == "position"
        return self.is_power or (moves and KINDS[kind] != "directional")


def light_targets(called: SceneIndex, targets: Mapping[str, ParameterTarget]) -> dict[str, LightTarget]:
    """Parameters that are of lights without a size."""
    params = mi.traverse(called.scene)
    lights = delta_lights(called.scene)
    found = {}
    for name, target in targets.items():
        if isinstance(target, str):
            entry = called.known(target)
            node, rest = (None, target) if entry is None else (params.properties[entry.key][2], entry.key)
        else:
            node, rest = called.find_movable(target.shape)[1], ""
        number = next((lights.index(one) for one in ancestors(params, node) if one in lights), None)
        if number is not None:
            found[name] = LightTarget(number, rest.split(".", 1)[1] if isinstance(target, str) else target)
    return found


def proxy_targets(
    lights: Mapping[str, LightTarget], near: ProxyScene, called: SceneIndex, start: Mapping[str, Float32Array]
) -> dict[str, ProxyTarget]:
    """What parameters of lights stand for in the neighbour, by their values at the start."""
    factors = {one.light: one.factor for one in near.exchanges if one.light is not None}
    ids = [one.id() for one in delta_lights(called.scene)]
    found = {}
    for name, one in lights.items():
        lamp, own = f"{LAMP}{one.light}", ids[one.light] or f"{LIGHT}{one.light}"
        if one.light in factors and one.is_power:
            found[name] = ProxyTarget(f"{lamp}.emitter.radiance.value", factors[one.light])
        elif one.light in factors and isinstance(one.target, str):
            found[name] = ProxyTarget(Translate(lamp), origin=start[name])
        elif isinstance(one.target, str):
            found[name] = ProxyTarget(f"{own}.{one.target}")
        else:
            found[name] = ProxyTarget(replace(one.target, shape=lamp if one.light in factors else own))
    return found


class ProxyGradientRenderer(MitsubaRenderer):
    """A :class:`MitsubaRenderer` whose pullback goes, for what moves, through a neighbouring scene.

    Parameters
    ----------
    scene, parameters, integrator, spp, spp_grad, sensor, without_gradient
        As those of :class:`MitsubaRenderer`.
    proxy : LoadedScene
        The neighbouring scene, which has all of the parameters.
    moving : names
        Parameters whose gradient is the neighbour's.
    exchanged : dict of ProxyTarget
        By parameter that stands for something else there, for what.
    only_shadows : bool
        Whether the neighbour has only the gradient of what is hidden behind what, off the camera's rays; all else is
        the scene's own.
    """

    def __init__(
        self,
        scene: Any,
        parameters: Mapping[str, ParameterTarget],
        *,
        proxy: LoadedScene,
        moving: Iterable[str],
        exchanged: Mapping[str, ProxyTarget],
        only_shadows: bool = False,
        integrator: Any = None,
        spp: int = 16,
        spp_grad: int | None = None,
        sensor: int = 0,
        without_gradient: Iterable[str] = (),
    ) -> None:
        self._moving = frozenset(moving)
        self._apart = frozenset() if only_shadows else self._moving  # whose gradient is the neighbour's alone
        self._exchanged = dict(exchanged)
        images = tuple(without_gradient)
        targets = {**parameters, **{name: one.target for name, one in exchanged.items()}}
        options: dict[str, Any] = {"spp": spp, "spp_grad": spp_grad, "sensor": sensor, "without_gradient": images}
        self._near = MitsubaRenderer(proxy, targets, integrator=integrator, **options).with_integrator(
            integrator, spp=spp, spp_grad=spp_grad, wrt=self._moving
        )
        self._near_shapes = {name: value.shape for name, value in self._near.parameters().items()}
        super().__init__(scene, parameters, integrator=integrator, **options)
        if only_shadows:
            self._near._set_terms(self._near.wrt, frozenset({"sppc", "sppp"}))
        excluded = frozenset({"sppi"}) if only_shadows else frozenset()
        self._set_terms(frozenset(self._differentiable) - self._apart, excluded)

    @property
    def proxy_scene(self) -> Any:
        """The neighbouring scene, an ``mi.Scene``."""
        return self._near.scene

    def with_integrator(
        self,
        integrator: Any,
        *,
        spp: int | None = None,
        spp_grad: int | None = None,
        wrt: Iterable[str] | None = None,
    ) -> ProxyGradientRenderer:
        """As that of :class:`MitsubaRenderer`, of both scenes."""
        names = set(self._binding.targets if wrt is None else wrt)
        other = copy(self)
        other._set_integrator(integrator, self._spp if spp is None else spp, spp_grad)
        other._set_terms(names - self._apart)
        other._near = self._near.with_integrator(integrator, spp=spp, spp_grad=spp_grad, wrt=names & self._moving)
        return other

    def vjp(self, params: Mapping[str, Any], cotangent: Any, *, seed: int = 0) -> dict[str, Float32Array]:
        """As that of :class:`MitsubaRenderer`, each parameter's from the scene that has it."""
        self._leaves(params)  # which checks them
        pulled = {name: np.zeros_like(start) for name, start in self._binding.start.items()}
        if self._wrt:
            pulled |= super().vjp(params, cotangent, seed=seed)
        if self._near.wrt:
            near = self._near.vjp(self._nearly(params), cotangent, seed=seed)
            pulled |= {name: pulled[name] + near[name] for name in self._moving}
        return pulled

    def jvp(self, params: Mapping[str, Any], tangent: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        """As that of :class:`MitsubaRenderer`, the sum of both scenes'."""
        parts = []
        if self._wrt:
            parts.append(super().jvp(params, tangent, seed=seed))
        if self._near.wrt:
            parts.append(self._near.jvp(self._nearly(params), self._nearly(tangent), seed=seed))
        return np.asarray(sum(parts), dtype=np.float32)  # one may have nothing to add, and is a single 0

    def _nearly(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Values for the neighbour, where a light of one grey has three colours."""
        near = {}
        for name, value in params.items():
            near[name] = np.asarray(value, dtype=np.float32)
            stand_in = self._exchanged.get(name)
            if stand_in is not None:
                moved = near[name] if stand_in.origin is None else near[name] - stand_in.origin
                near[name] = np.broadcast_to(moved * np.float32(stand_in.factor), self._near_shapes[name])
        return near

    def _check_gradients(self, *, is_planned: bool, edged: list[Any]) -> None:
        """The neighbour has told what is missing there, which is all that counts."""
