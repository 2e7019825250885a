"""The contract between a renderer and its callers: named parameters to an image, with a pullback."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

from loi_core.effects import EffectPlanner
from loi_core.errors import RendererError
from loi_core.pixels.encoding import Encoding
from loi_core.support.arrays import Array
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import shown

__all__ = [
    "Loss",
    "LossPullback",
    "Parameters",
    "Pullback",
    "Renderer",
    "RendererCapabilities",
    "capabilities_of",
    "render_loss_vjp",
]

Parameters: TypeAlias = dict[str, Array]
"""Parameters of a scene by name; floating-point arrays of any shape, 0-d included."""

Pullback: TypeAlias = Callable[[Array], Parameters]
"""Maps the cotangent of the image, shape (H, W, C), to a cotangent of every parameter."""

Loss: TypeAlias = Callable[[Array], Any]
"""Returns the scalar loss of an image, shape (H, W, C)."""

LossPullback: TypeAlias = Callable[[Loss | None, Array], Parameters]
"""Returns the gradient of a loss from the loss itself, or None if it is unknown, and its cotangent at the image."""


@runtime_checkable
class Renderer(Protocol):
    """A function from named parameters to an image, with a pullback.

    Every automatic differentiation system can provide it. Arrays may come from any array library, the same for
    parameters and image. Neither method may change the parameters it is given, and the same parameters and seed
    must give the same image and the same pullback, whatever was called before. A renderer that offers more lists it in
    an attribute ``capabilities``, see :class:`RendererCapabilities`.
    """

    def parameters(self) -> Parameters:
        """Return all parameters with the scene's current values, as a new dict of new arrays."""

    def render(self, params: Parameters, *, seed: int = 0) -> Array:
        """Return the image, shape (H, W, C), of the scene with these parameters."""

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, Pullback]:
        """Return the image and its pullback, linear in the cotangent; cotangents have the parameters' shapes."""


class _Project(Protocol):
    def __call__(self, params: Any, /) -> Parameters: ...


class _Start(Protocol):
    def __call__(self, params: Any, cotangent: Any, /, *, optimise: Iterable[str], seed: int = 0) -> Renderer: ...


class _Revisit(Protocol):
    def __call__(
        self, step: int, steps: int, value: float | None, params: Any, cotangent: Any, /, *, seed: int = 0
    ) -> Renderer: ...


class _RenderLossVjp(Protocol):
    def __call__(self, params: Any, /, *, seed: int = 0) -> tuple[Any, LossPullback]: ...


@suggest_keywords
@dataclass(frozen=True)
class RendererCapabilities:
    """Optional capabilities of a renderer beyond :class:`Renderer`; None for a missing capability.

    A renderer returns the record from an attribute or property ``capabilities``. A wrapper forwards the record of the
    wrapped renderer with ``dataclasses.replace``, and wraps the renderers that `start` and `revisit` return.

    Attributes
    ----------
    project : callable, optional
        ``project(params)`` returns the legal parameters nearest to `params`, which it does not change. A fit calls it
        after every step.
    start : callable, optional
        ``start(params, cotangent, *, optimise, seed)`` returns a renderer of the same scene that is prepared for a fit
        of the parameters named in `optimise`, which starts at `params`, where the loss has the gradient `cotangent`
        with respect to the image. A fit calls it once.
    revisit : callable, optional
        ``revisit(step, steps, value, params, cotangent, *, seed)`` returns the renderer of `step`, counted from 0, of
        `steps`. The other arguments belong to the previous step: its loss, None before the first step and where a fit
        restarts elsewhere; and its parameters, cotangent and seed, None if this renderer was not part of that step. A
        fit calls it before every step.
    render_loss_vjp : callable, optional
        ``render_loss_vjp(params, *, seed)`` returns the image and a ``LossPullback``, which may evaluate the loss
        at other images. A fit calls it instead of ``render_vjp``.
    unabridged : callable, optional
        ``unabridged()`` returns a renderer of the same scene and parameters without the approximations that save time.
        A fit judges its result with it.
    encoding : {"linear", "sRGB"}, optional
        Encoding of the images: "linear" for radiance, "sRGB" for display values. Targets of scene files are converted
        to it.
    planner : EffectPlanner, optional
        The plan of the simulated effects of light transport, which ``loi fit --explain`` prints.
    """

    project: _Project | None = None
    start: _Start | None = None
    revisit: _Revisit | None = None
    render_loss_vjp: _RenderLossVjp | None = None
    unabridged: Callable[[], Renderer] | None = None
    encoding: Encoding | None = None
    planner: EffectPlanner | None = None


def capabilities_of(renderer: object) -> RendererCapabilities:
    """Return the capabilities of a renderer; an empty record if it lists none.

    Raises
    ------
    RendererError
        If its attribute ``capabilities`` is not a :class:`RendererCapabilities`.
    """
    capabilities = getattr(renderer, "capabilities", None)
    if capabilities is None:
        return RendererCapabilities()
    if not isinstance(capabilities, RendererCapabilities):
        msg = f"`capabilities` of {type(renderer).__name__} must be a RendererCapabilities, got {shown(capabilities)}"
        raise RendererError(msg)
    return capabilities


def render_loss_vjp(renderer: Renderer, params: Parameters, *, seed: int = 0) -> tuple[Array, LossPullback]:
    """Return the image and its ``LossPullback``; it ignores the loss if the renderer needs the cotangent only."""
    capability = capabilities_of(renderer).render_loss_vjp
    if capability is not None:
        return capability(params, seed=seed)
    image, pullback = renderer.render_vjp(params, seed=seed)
    return image, lambda _, cotangent: pullback(cotangent)
