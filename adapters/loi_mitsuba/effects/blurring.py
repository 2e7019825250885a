"""Gradients of images blurred over parameters, and a test of their significance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from loi_core.effects import Draws, Frozen
from loi_core.errors import OptionError
from loi_core.renderers.blurred import BlurredRenderer
from loi_core.renderers.contract import Renderer
from loi_mitsuba.effects.gradient_draws import PILOT_SEED_OFFSET, GradientProbe
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.poses import Scale
from mitsuba_boundaries.drjit.arrays import Float32Array

__all__ = ["Blurring", "PlannedImages"]

PAIRS: Final = 4  # of images for a blurred gradient; with a single pair, fits of a glass ball diverged
DRAWS: Final = 16  # of a blurred gradient, to test its significance; with 8, a highlight's was noise at 48 pixels
MAX_SCALARS: Final = 16  # to blur jointly: with n alike, the draws show each at 8 / sqrt(n + 1) standard errors
MIN_SCALE: Final = 1e-3  # of a shape in a blurred image


@dataclass(frozen=True)
class Blurring:
    """Builds and tests blurred gradients.

    Attributes
    ----------
    images : Renderer
        Renders under the current plan.
    options : mapping or None
        Options of :class:`loi_core.renderers.BlurredRenderer`; None blurs nothing.
    unsupported : iterable of str
        Parameters without a gradient in the scene; the options may have a ``sigma`` for them.
    """

    images: Renderer
    options: Mapping[str, Any] | None
    unsupported: Iterable[str]

    def over(self, names: Iterable[str]) -> BlurredRenderer:
        """Blur the images over these parameters."""
        options = {"pairs": PAIRS, **(self.options or {}), "names": tuple(names)}
        for key in ("sigma", "final_sigma"):
            if isinstance(options.get(key), Mapping):
                ignored = set(self.unsupported) - set(options["names"])  # BlurredRenderer refuses all other names
                options[key] = {name: sigma for name, sigma in options[key].items() if name not in ignored}
        return BlurredRenderer(self.images, **options)

    def significant(self, probe: GradientProbe, frozen: Frozen) -> dict[str, str]:
        """Return the frozen parameters whose blurred gradient is significant, with the reason."""
        names = tuple(frozen.reasons)
        if not names or self.options is None or self.options.get("names") is not None:
            return {}
        if sum(np.size(probe.params[name]) for name in names) > MAX_SCALARS:
            return {}
        params, seed = dict(probe.params), PILOT_SEED_OFFSET + probe.seed
        try:
            blurred = self.over(names)
            first = blurred.vjp(params, probe.cotangent, seed=seed)
            if not any(np.any(value) for value in first.values()):
                return {}  # the parameters change nothing in the image within reach of the blur
            draws = [first, *(blurred.vjp(params, probe.cotangent, seed=seed + k) for k in range(1, DRAWS))]
        except OptionError:  # the parameters change no pixel, so that a blur in pixels has no size
            return {}
        insignificant = Frozen.of(Draws.of(draws), frozen.groups).reasons
        return {
            name: f"{reason}; the blurred gradient is significant in {DRAWS} draws"
            for name, reason in frozen.reasons.items()
            if name not in insignificant
        }


@dataclass(frozen=True)
class PlannedImages:
    """The images under a plan, for blurred gradients.

    Attributes
    ----------
    renderer : MitsubaRenderer
        The scene under the plan.
    """

    renderer: MitsubaRenderer

    def parameters(self) -> dict[str, Float32Array]:
        """Return the parameters of the scene."""
        return self.renderer.parameters()

    def render(self, params: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        """Render the image at the legal values that are nearest to `params`."""
        return self.renderer.render(_legal_values(params, self.renderer.targets), seed=seed)

    def render_vjp(
        self, params: Mapping[str, Any], *, seed: int = 0
    ) -> tuple[Float32Array, Callable[[Any], dict[str, Float32Array]]]:
        """Render the image and return it with its pullback."""
        return self.renderer.render_vjp(params, seed=seed)


def _legal_values(params: Mapping[str, Any], targets: Mapping[str, ParameterTarget]) -> dict[str, Any]:
    """Return values that can be set: the scale of a shape is positive."""
    return {
        name: np.maximum(value, np.float32(MIN_SCALE)) if isinstance(targets[name], Scale) else value
        for name, value in params.items()
    }
