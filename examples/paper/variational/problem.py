"""What is to be found in a scene: its images, its target, and where a fit may begin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.errors import RendererError
from loi_core.pixels.encoding import encode_srgb
from loi_core.renderers.contract import Parameters, Pullback, RendererCapabilities
from loi_core.renderers.poses import ParameterTarget
from loi_mitsuba import MitsubaRenderer

__all__ = ["AT_TRUTH", "FloatArray", "Group", "Images", "Problem", "as_arrays", "shown"]

FloatArray: TypeAlias = np.ndarray[Any, np.dtype[np.float32]]

AT_TRUTH: Final = 999  # the seed of a start that is the truth


class Images:
    """A Mitsuba scene's images as a display wants them, and no gradient: what is blurred needs none.

    Parameters
    ----------
    scene : dict
        For ``mi.load_dict``, with an integrator.
    parameters : dict of targets
    samples : int
        Per pixel.
    """

    def __init__(self, scene: dict[str, Any], parameters: Mapping[str, ParameterTarget], samples: int) -> None:
        self._mitsuba = MitsubaRenderer(
            scene, parameters, integrator="scene", spp=samples, without_gradient=tuple(parameters)
        )

    @property
    def capabilities(self) -> RendererCapabilities:
        """Values are encoded like those of an ordinary image file."""
        return RendererCapabilities(encoding="sRGB")

    def parameters(self) -> Parameters:
        """As the scene has them."""
        return dict(self._mitsuba.parameters())

    def render(self, params: Parameters, *, seed: int = 0) -> FloatArray:
        """The image, shape (H, W, 3), in [0, 1]."""
        return shown(self._mitsuba.render(params, seed=seed))

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[FloatArray, Pullback]:
        """The contract has it; a blurred renderer does not ask for it."""
        msg = f"there are images only, none with a gradient by {', '.join(params)} (seed {seed})"
        raise RendererError(msg)


def as_arrays(values: Mapping[str, float]) -> Parameters:
    """Numbers as 0-d arrays of float32."""
    return {name: np.float32(value) for name, value in values.items()}


def shown(radiance: FloatArray) -> FloatArray:
    """Radiance as an image file holds it: sRGB, in [0, 1]."""
    return np.asarray(encode_srgb(np.clip(radiance, 0.0, 1.0)), dtype=np.float32)


@dataclass(frozen=True)
class Group:
    """Parameters of a kind: what their error is counted in, and how much of it is allowed.

    Attributes
    ----------
    label : str
        With the unit in it.
    names : tuple of str
    unit : float
        In the parameters' own.
    allowed : float
        The largest error of what is found, in `unit`.
    """

    label: str
    names: tuple[str, ...]
    unit: float
    allowed: float


@dataclass(frozen=True)
class Problem:
    """A scene and what is unknown in it.

    Attributes
    ----------
    images : Images
        Of the scene as it is modelled; its parameters are 0-d.
    close : Images
        The same at many samples, for what came of a fit.
    target : array, shape (H, W, 3)
        In [0, 1], sRGB.
    truth, low, high : dict of float
        What is to be found, and within which range.
    groups : tuple of Group
    """

    images: Images
    close: Images
    target: FloatArray = field(repr=False)
    truth: Mapping[str, float]
    low: Mapping[str, float]
    high: Mapping[str, float]
    groups: tuple[Group, ...]

    def span(self, name: str) -> float:
        """The width of a parameter's range."""
        return self.high[name] - self.low[name]

    def at_truth(self) -> Parameters:
        """The truth, for a renderer."""
        return as_arrays(self.truth)

    def start(self, seed: int) -> dict[str, float]:
        """A start drawn from all of the range, or the truth."""
        if seed == AT_TRUTH:
            return dict(self.truth)
        rng = np.random.default_rng([seed, len(self.truth)])
        return {name: float(rng.uniform(self.low[name], self.high[name])) for name in self.truth}

    def errors(self, found: Mapping[str, float]) -> list[tuple[float, float]]:
        """Mean and largest absolute error of each group, in its unit."""
        off = [[abs(found[name] - self.truth[name]) / group.unit for name in group.names] for group in self.groups]
        return [(float(np.mean(one)), max(one)) for one in off]

    def is_found(self, found: Mapping[str, float]) -> bool:
        """Whether every number is as near to the truth as its group asks for."""
        return all(worst <= group.allowed for group, (_, worst) in zip(self.groups, self.errors(found), strict=True))
