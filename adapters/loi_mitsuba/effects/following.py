"""The gradient by what is followed: lights that move, and clear glass."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from loi_mitsuba.effects.glass import REASON, Glass
from loi_mitsuba.effects.lamps import Lamps, reason_of
from loi_mitsuba.handles import Host
from loi_mitsuba.renderer import MitsubaRenderer

__all__ = ["Following"]


class Following:
    """Whose samples move with what: the points of lamps, and of glass.

    Parameters
    ----------
    renderer : MitsubaRenderer
        Of the scene, whose values are those of the start.
    lights, glass : dict of objects
        By parameter, the light or the shape of clear glass that it moves.
    samples : int
        Per pixel.
    """

    def __init__(
        self, renderer: MitsubaRenderer, lights: Mapping[str, Any], glass: Mapping[str, Any], samples: int
    ) -> None:
        self._lights, self._shapes = dict(lights), dict(glass)
        self.lamps = Lamps(renderer, lights, samples)
        self._glass = Glass(renderer, glass, samples)

    def reason_of(self, name: str) -> str:
        """What a plan says of the gradient by a parameter."""
        return REASON if name in self._shapes else reason_of(self._lights[name])

    def pull(
        self, params: Mapping[str, Any], cotangent: Any, *, names: Iterable[str], seed: int = 0
    ) -> dict[str, Host]:
        """A cotangent of the image, shape (H, W, C), carried to the parameters `names`."""
        lamps, glass = self._sorted(names)
        pulled = self.lamps.pull(params, cotangent, names=lamps, seed=seed) if lamps else {}
        return pulled | (self._glass.pull(params, cotangent, names=glass, seed=seed) if glass else {})

    def seen(self, params: Mapping[str, Any], cotangent: Any, *, names: Sequence[str], seed: int = 0) -> frozenset[str]:
        """Of `names`, those whose gradient can be distinguished from noise, in a few draws."""
        lamps, glass = self._sorted(names)
        found = self.lamps.seen(params, cotangent, names=lamps, seed=seed)
        return found | self._glass.seen(params, cotangent, names=glass, seed=seed)

    def _sorted(self, names: Iterable[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        wanted = tuple(names)
        return tuple(n for n in wanted if n not in self._shapes), tuple(n for n in wanted if n in self._shapes)
