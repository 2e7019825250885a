"""The contract between a renderer and everything else: named parameters to an image, and a pullback."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias, runtime_checkable

from loi_core.pixels.encoding import Encoding
from loi_core.support.arrays import Array

__all__ = [
    "AbridgedRenderer",
    "EncodedRenderer",
    "Loss",
    "LossPullback",
    "Parameters",
    "ProjectingRenderer",
    "Pullback",
    "Renderer",
    "SteppedRenderer",
]

Parameters: TypeAlias = dict[str, Array]
"""Parameters of a scene by name; floating-point arrays of any shape, 0-d included."""

Pullback: TypeAlias = Callable[[Array], Parameters]
"""Carries a cotangent of the image, shape (H, W, C), to a cotangent of every parameter."""

Loss: TypeAlias = Callable[[Array], Any]
"""The number that an objective makes of an image, shape (H, W, C)."""


@runtime_checkable
class LossPullback(Protocol):
    """A pullback that looks at the loss itself, where it is known, and not only at its slope at one image."""

    def __call__(self, cotangent: Array) -> Parameters:
        """As any :data:`Pullback`."""

    def of_loss(self, loss: Loss, cotangent: Array) -> Parameters:
        """The gradient of a loss, whose own gradient at the image is `cotangent`; a fit asks for this one."""


@runtime_checkable
class Renderer(Protocol):
    """A function from named parameters to an image, with a pullback.

    Every automatic differentiation system can provide it. Arrays may be of any array library, the same for
    parameters and image. Neither method may change the parameters it is given, and the same parameters and seed
    must give the same image.
    """

    def parameters(self) -> Parameters:
        """All parameters with the values that the scene has now; a new dict of new arrays on each call."""

    def render(self, params: Parameters, *, seed: int = 0) -> Array:
        """The image, shape (H, W, C), of the scene with these parameters."""

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, Pullback]:
        """The image and its pullback, linear in the cotangent; cotangents have the parameters' shapes."""


@runtime_checkable
class ProjectingRenderer(Renderer, Protocol):
    """A renderer that knows which parameters are legal; a fit calls `project` after every step."""

    def project(self, params: Parameters) -> Parameters:
        """The legal parameters next to these; the argument is left as it is."""


@runtime_checkable
class AbridgedRenderer(Renderer, Protocol):
    """A renderer that leaves out what matters little for a gradient; what came of a fit is judged with all of it."""

    @property
    def unabridged(self) -> Renderer:
        """The same scene and parameters, rendered whole."""


@runtime_checkable
class EncodedRenderer(Renderer, Protocol):
    """A renderer that says what its values are; targets of scene files are made into the same."""

    @property
    def encoding(self) -> Encoding:
        """Of its images: "linear" for radiance, "sRGB" for values as displays want them."""


@runtime_checkable
class SteppedRenderer(Renderer, Protocol):
    """A renderer whose gradient depends on how far a fit has come; a fit calls `at_step` before every step."""

    def at_step(self, step: int, steps: int, value: float | None) -> None:
        """The next gradients are of this step, counted from 0, of so many.

        `value` is the loss of the step before; None before the first, also where a fit begins anew from elsewhere.
        """
