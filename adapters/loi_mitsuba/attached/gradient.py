"""The gradient by what is followed: lights that move, and clear glass."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from loi_core.effects import Draws, Holding
from loi_core.effects.holding import CLEAR
from loi_mitsuba.attached.dielectrics import REASON, AttachedDielectrics, attachable_dielectrics
from loi_mitsuba.attached.emitters import AttachedEmitters, attachable_emitters, is_shape, reason_of
from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import SceneIndex
from loi_mitsuba.scene.queries import group_by_shape

__all__ = ["AttachedGradient", "AttachedParameters"]

DRAWS: Final = 4


@dataclass(frozen=True)
class AttachedParameters:
    """What can be followed in a scene: by parameter, the light or the shape of clear glass that it moves."""

    lights: Mapping[str, Any]
    glass: Mapping[str, Any]

    @classmethod
    def of(
        cls, called: SceneIndex, targets: Mapping[str, ParameterTarget], sensor: Any, *, lights: bool, glass: bool
    ) -> AttachedParameters:
        """Among `targets`, what can be followed of that which is asked for."""
        return cls(
            attachable_emitters(called, targets) if lights else {},
            attachable_dielectrics(called, targets, sensor) if glass else {},
        )

    @property
    def without_gradient(self) -> frozenset[str]:
        """The parameters by which Mitsuba has no gradient of use: those of points, and of glass."""
        points = (name for name, light in self.lights.items() if not is_shape(light))
        return frozenset((*points, *self.glass))


class AttachedGradient:
    """The gradient of samples that move with points of lamps, and of glass.

    Parameters
    ----------
    renderer : MitsubaRenderer
        Of the scene, whose values are those of the start.
    followed : AttachedParameters
        What of it.
    samples : int
        Per pixel.
    """

    def __init__(self, renderer: MitsubaRenderer, followed: AttachedParameters, samples: int) -> None:
        self._targets = renderer.targets
        self._followed = followed
        self._lamps = AttachedEmitters(renderer, followed.lights, samples)
        self._glass = AttachedDielectrics(renderer, samples)

    def reason_of(self, name: str) -> str:
        """What a plan says of the gradient by a parameter."""
        return REASON if name in self._followed.glass else reason_of(self._followed.lights[name])

    def vjp(
        self, params: Mapping[str, Any], cotangent: Any, *, names: Iterable[str], seed: int = 0
    ) -> dict[str, Float32Array]:
        """A cotangent of the image, shape (H, W, C), carried to the parameters `names`."""
        wanted = tuple(names)
        lamps = [name for name in wanted if name in self._followed.lights]
        glass = [name for name in wanted if name in self._followed.glass]
        pulled = self._lamps.vjp(params, cotangent, names=lamps, seed=seed) if lamps else {}
        return pulled | (self._glass.vjp(params, cotangent, names=glass, seed=seed) if glass else {})

    def silent(
        self, params: Mapping[str, Any], cotangent: Any, *, names: Sequence[str], seed: int = 0
    ) -> frozenset[str]:
        """Of `names`, those of lights and shapes by which the gradient is exactly 0, in a few draws."""
        if not names:
            return frozenset()
        draws = self._draws(params, cotangent, names, seed)
        return frozenset(name for group in self._objects(names) if all(map(draws.zero, group)) for name in group)

    def better(
        self, own: MitsubaRenderer, params: Mapping[str, Any], cotangent: Any, *, names: Sequence[str], seed: int = 0
    ) -> frozenset[str]:
        """Of `names`, those whose gradient is more than noise in a few draws, and of which Mitsuba knows nothing more.

        That is where its `own` gradient, which has all light, differs by no more than its noise.
        """
        draws = self._draws(params, cotangent, names, seed)
        seen = self._seen(draws, names)
        wanted = tuple(name for name in names if name in seen)
        if not wanted:
            return seen
        every = Draws.of([_of(own.vjp(params, cotangent, seed=seed + k), wanted) for k in range(DRAWS)])
        lacking = every.less(draws)
        more = {name for name in wanted if lacking.heard(name, CLEAR)}
        return frozenset(name for group in self._objects(wanted) for name in group if not more & set(group))

    def _draws(self, params: Mapping[str, Any], cotangent: Any, names: Sequence[str], seed: int) -> Draws:
        return Draws.of([self.vjp(params, cotangent, names=names, seed=seed + k) for k in range(DRAWS)])

    def _seen(self, draws: Draws, names: Sequence[str]) -> frozenset[str]:
        return frozenset(names) - Holding.begun(draws, self._objects(names)).reasons.keys()

    def _objects(self, names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
        """Names of one light, or of one shape, together."""
        every = {**self._followed.lights, **self._followed.glass}
        return group_by_shape({name: self._targets[name] for name in names}, {name: every[name] for name in names})


def _of(pulled: Mapping[str, Float32Array], names: Iterable[str]) -> dict[str, Float32Array]:
    return {name: pulled[name] for name in names}
