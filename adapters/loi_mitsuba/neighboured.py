"""A scene that is rendered as it is, with the gradient by what moves taken from its neighbour."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import copy
from typing import Any

import mitsuba as mi
import numpy as np

from loi_mitsuba.entries import Names, ancestors
from loi_mitsuba.handles import Host
from loi_mitsuba.loading import Loaded, Target
from loi_mitsuba.neighbour import LAMP, LIGHT, Found, lights_of
from loi_mitsuba.renderer import MitsubaRenderer

__all__ = ["NeighbouredRenderer", "exchanged_targets", "targets_of_lights"]


def targets_of_lights(called: Names, targets: Mapping[str, Target]) -> dict[str, tuple[int, str]]:
    """Parameters that are entries of lights without a size: the light's number, and the entry's name within it."""
    params = mi.traverse(called.scene)
    lights = lights_of(called.scene)
    found = {}
    for name, target in targets.items():
        if isinstance(target, str):
            key = called.find(target).key
            chain = ancestors(params, params.properties[key][2])
            number = next((lights.index(node) for node in chain if node in lights), None)
            if number is not None:
                found[name] = number, key.split(".", 1)[1]
    return found


def exchanged_targets(
    lights: Mapping[str, tuple[int, str]], near: Found, called: Names
) -> dict[str, tuple[str, float]]:
    """What parameters of lights stand for in the neighbour; see :class:`NeighbouredRenderer`."""
    factors = {one.light: one.factor for one in near.exchanges if one.light is not None}
    ids = [one.id() for one in lights_of(called.scene)]
    return {
        name: (f"{LAMP}{number}.emitter.radiance.value", factors[number])
        if number in factors
        else (f"{ids[number] or f'{LIGHT}{number}'}.{entry}", 1.0)
        for name, (number, entry) in lights.items()
    }


class NeighbouredRenderer(MitsubaRenderer):
    """A :class:`MitsubaRenderer` whose pullback goes, for what moves, through a neighbouring scene.

    Parameters
    ----------
    scene, parameters, integrator, spp, spp_grad, sensor
        As those of :class:`MitsubaRenderer`.
    neighbour : Loaded
        The neighbouring scene, which has all of the parameters.
    moving : names
        Parameters whose gradient is the neighbour's.
    exchanged : dict of (target, factor)
        By parameter that stands for something else there, for what, and how many times its value that has: a light
        without a size has an intensity, and the lamp that stands for it a radiance.
    """

    def __init__(
        self,
        scene: Any,
        parameters: Mapping[str, Target],
        *,
        neighbour: Loaded,
        moving: Iterable[str],
        exchanged: Mapping[str, tuple[str, float]],
        integrator: Any = None,
        spp: int = 16,
        spp_grad: int | None = None,
        sensor: int = 0,
    ) -> None:
        self._moving = frozenset(moving)
        self._factors = {name: np.float32(factor) for name, (_, factor) in exchanged.items()}
        targets = {**parameters, **{name: target for name, (target, _) in exchanged.items()}}
        self._near = MitsubaRenderer(
            neighbour, targets, integrator=integrator, spp=spp, spp_grad=spp_grad, sensor=sensor
        ).with_integrator(integrator, spp=spp, spp_grad=spp_grad, follow=self._moving)
        self._near_shapes = {name: value.shape for name, value in self._near.parameters().items()}
        super().__init__(scene, parameters, integrator=integrator, spp=spp, spp_grad=spp_grad, sensor=sensor)
        self._followed = tuple(name for name in parameters if name not in self._moving)

    @property
    def neighbour(self) -> Any:
        """The neighbouring scene, an ``mi.Scene``."""
        return self._near.scene

    def with_integrator(
        self,
        integrator: Any,
        *,
        spp: int | None = None,
        spp_grad: int | None = None,
        follow: Iterable[str] | None = None,
    ) -> NeighbouredRenderer:
        """As that of :class:`MitsubaRenderer`, of both scenes."""
        names = set(self._named.targets if follow is None else follow)
        other = copy(self)
        other._use(integrator, self._spp if spp is None else spp, spp_grad)
        other._followed = tuple(name for name in self._named.targets if name in names - self._moving)
        other._near = self._near.with_integrator(integrator, spp=spp, spp_grad=spp_grad, follow=names & self._moving)
        return other

    def pull(self, params: Mapping[str, Any], cotangent: Any, *, seed: int = 0) -> dict[str, Host]:
        """As that of :class:`MitsubaRenderer`, each parameter's from the scene that has it."""
        self._leaves(params)  # which checks them
        pulled = {name: np.zeros_like(start) for name, start in self._named.start.items()}
        if self._followed:
            pulled |= super().pull(params, cotangent, seed=seed)
        if self._near.follows:
            near = self._near.pull(self._nearly(params), cotangent, seed=seed)
            pulled |= {name: near[name] for name in self._moving}
        return pulled

    def push(self, params: Mapping[str, Any], tangent: Mapping[str, Any], *, seed: int = 0) -> Host:
        """As that of :class:`MitsubaRenderer`, the sum of both scenes'."""
        parts = []
        if self._followed:
            parts.append(super().push(params, tangent, seed=seed))
        if self._near.follows:
            parts.append(self._near.push(self._nearly(params), self._nearly(tangent), seed=seed))
        total: Host = np.sum(parts, axis=0, dtype=np.float32)
        return total

    def _nearly(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Values for the neighbour, where a light of one grey has three colours."""
        near = {}
        for name, value in params.items():
            scaled = np.asarray(value, dtype=np.float32) * self._factors.get(name, np.float32(1.0))
            near[name] = np.broadcast_to(scaled, self._near_shapes[name]) if name in self._factors else scaled
        return near

    def _check_moving(self, *, told: bool) -> None:
        """The neighbour has told what is missing there, which is all that counts."""
