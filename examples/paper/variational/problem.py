"""Problem of a scene: its images, its target, and the range of its unknown parameters."""

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

__all__ = ["TRUTH_SEED", "FloatArray", "Group", "Images", "Problem", "as_arrays", "encoded"]

FloatArray: TypeAlias = np.ndarray[Any, np.dtype[np.float32]]

TRUTH_SEED: Final = 999  # seed of the start at the true parameters


class Images:
    """Display-referred images of a Mitsuba scene, without gradients: a blur over the parameters needs none.

    Parameters
    ----------
    scene : dict
        Scene for ``mi.load_dict``, with an integrator.
    parameters : dict of targets
    samples : int
        Samples per pixel.
    """

    def __init__(self, scene: dict[str, Any], parameters: Mapping[str, ParameterTarget], samples: int) -> None:
        self._mitsuba = MitsubaRenderer(
            scene, parameters, integrator="scene", spp=samples, without_gradient=tuple(parameters)
        )

    @property
    def capabilities(self) -> RendererCapabilities:
        """Images are encoded as sRGB."""
        return RendererCapabilities(encoding="sRGB")

    def parameters(self) -> Parameters:
        """Return the parameters of the scene."""
        return dict(self._mitsuba.parameters())

    def render(self, params: Parameters, *, seed: int = 0) -> FloatArray:
        """Return the image, shape (H, W, 3), in [0, 1]."""
        return encoded(self._mitsuba.render(params, seed=seed))

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[FloatArray, Pullback]:
        """Raise RendererError: the contract requires the method, but a blurred renderer never calls it."""
        msg = f"there are images only, none with a gradient by {', '.join(params)} (seed {seed})"
        raise RendererError(msg)


def as_arrays(values: Mapping[str, float]) -> Parameters:
    """Return numbers as 0-d arrays of float32."""
    return {name: np.float32(value) for name, value in values.items()}


def encoded(radiance: FloatArray) -> FloatArray:
    """Return radiance as sRGB values in [0, 1]."""
    return np.asarray(encode_srgb(np.clip(radiance, 0.0, 1.0)), dtype=np.float32)


@dataclass(frozen=True)
class Group:
    """Parameters of one kind, with the unit and the tolerance of their errors.

    Attributes
    ----------
    label : str
        Name of the group, with its unit.
    names : tuple of str
    unit : float
        Unit of the errors, in units of the parameters.
    tolerance : float
        Largest error of a successful fit, in `unit`.
    """

    label: str
    names: tuple[str, ...]
    unit: float
    tolerance: float


@dataclass(frozen=True)
class Problem:
    """A scene with its unknown parameters.

    Attributes
    ----------
    images : Images
        Images of the model of the scene; its parameters are 0-d.
    reference_images : Images
        The same at many samples, to measure the result of a fit.
    target : array, shape (H, W, 3)
        sRGB, in [0, 1].
    truth, lower, upper : dict of float
        True parameters and their bounds.
    groups : tuple of Group
    """

    images: Images
    reference_images: Images
    target: FloatArray = field(repr=False)
    truth: Mapping[str, float]
    lower: Mapping[str, float]
    upper: Mapping[str, float]
    groups: tuple[Group, ...]

    def span(self, name: str) -> float:
        """Return the width of a parameter's range."""
        return self.upper[name] - self.lower[name]

    def true_parameters(self) -> Parameters:
        """Return the true parameters for a renderer."""
        return as_arrays(self.truth)

    def start(self, seed: int) -> dict[str, float]:
        """Return a start drawn uniformly from the range; the truth for `TRUTH_SEED`."""
        if seed == TRUTH_SEED:
            return dict(self.truth)
        rng = np.random.default_rng([seed, len(self.truth)])
        return {name: float(rng.uniform(self.lower[name], self.upper[name])) for name in self.truth}

    def errors(self, params: Mapping[str, float]) -> list[tuple[float, float]]:
        """Return the mean and the largest absolute error of each group, in its unit."""
        errors = [[abs(params[name] - self.truth[name]) / group.unit for name in group.names] for group in self.groups]
        return [(float(np.mean(group_errors)), max(group_errors)) for group_errors in errors]

    def is_found(self, params: Mapping[str, float]) -> bool:
        """Return whether every parameter is within the tolerance of its group."""
        return all(worst <= group.tolerance for group, (_, worst) in zip(self.groups, self.errors(params), strict=True))
