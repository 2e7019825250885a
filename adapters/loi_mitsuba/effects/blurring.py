"""Which parameters of a planned scene are better blurred, and the images that are blurred over them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np

from loi_core.effects import Draws, Holding
from loi_core.errors import OptionError
from loi_core.renderers.blurred import BlurredRenderer
from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.effects.gradient_draws import APART, Probe
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.poses import Scale

__all__ = ["Blurring"]

PAIRS: Final = 4  # of images of a blurred gradient; one ended fits of a glass ball elsewhere
DRAWS: Final = 16  # that say whether a blurred gradient is noise as well; of 8 a highlight's was at 48 pixels
MOST: Final = 16  # numbers that are tried together: of n alike, that many images show one at 8 / sqrt(n + 1) errors
LEAST: Final = 1e-3  # of what scales a shape


class _Planned(Protocol):
    """What is needed of a planned renderer."""

    @property
    def targets(self) -> Mapping[str, ParameterTarget]: ...

    def parameters(self) -> dict[str, Float32Array]: ...

    def render(self, params: Mapping[str, Any], *, seed: int = 0) -> Float32Array: ...

    def render_vjp(
        self, params: Mapping[str, Any], *, seed: int = 0
    ) -> tuple[Float32Array, Callable[[Any], dict[str, Float32Array]]]: ...


@dataclass(frozen=True)
class Blurring:
    """How the parameters of a planned renderer are blurred.

    Attributes
    ----------
    planned : PlannedRenderer
        Its images, whatever its plan is by then.
    options : mapping, or None
        Of :class:`loi_core.renderers.BlurredRenderer`; None blurs nothing.
    missing : iterable of str
        Parameters that have no gradient in the scene, whose ``sigma`` may stand in the options.
    """

    planned: _Planned
    options: Mapping[str, Any] | None
    missing: Iterable[str]

    def over(self, names: Iterable[str]) -> BlurredRenderer:
        """The images blurred over these parameters."""
        options = {"pairs": PAIRS, **(self.options or {}), "names": tuple(names)}
        for key in ("sigma", "final_sigma"):
            if isinstance(options.get(key), Mapping):
                others = set(self.missing) - set(options["names"])  # what is not known at all is refused
                options[key] = {name: one for name, one in options[key].items() if name not in others}
        return BlurredRenderer(_Images(self.planned), **options)

    def better(self, probe: Probe, holding: Holding) -> dict[str, str]:
        """Of what is held, the parameters whose gradient can be told from noise once they are blurred, and why."""
        names = tuple(holding.reasons)
        if not names or self.options is None or self.options.get("names") is not None:
            return {}
        if sum(np.size(probe.params[name]) for name in names) > MOST:
            return {}
        place, seed = dict(probe.params), APART + probe.seed
        try:
            blurred = self.over(names)
            first = blurred.vjp(place, probe.cotangent, seed=seed)
            if not any(np.any(value) for value in first.values()):
                return {}  # nothing is seen of it within reach of the blur
            others = [blurred.vjp(place, probe.cotangent, seed=seed + k) for k in range(1, DRAWS)]
        except OptionError:  # what leaves no trace in the image has no pixels to measure its blur by
            return {}
        held = Holding.begun(Draws.of([first, *others]), holding.groups).reasons
        return {
            name: f"{reason}; that of images blurred over it is significant in {DRAWS}"
            for name, reason in holding.reasons.items()
            if name not in held
        }


@dataclass(frozen=True)
class _Images:
    """What a blur looks at."""

    planned: _Planned

    def parameters(self) -> dict[str, Float32Array]:
        return self.planned.parameters()

    def render(self, params: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        return self.planned.render(self._legal(params), seed=seed)

    def render_vjp(
        self, params: Mapping[str, Any], *, seed: int = 0
    ) -> tuple[Float32Array, Callable[[Any], dict[str, Float32Array]]]:
        return self.planned.render_vjp(params, seed=seed)

    def _legal(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Values that can be set: what scales a shape is more than 0."""
        targets = self.planned.targets
        return {
            name: np.maximum(value, np.float32(LEAST)) if isinstance(targets[name], Scale) else value
            for name, value in params.items()
        }
