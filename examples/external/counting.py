"""Renderer that counts its images, and remembers when the parameters were first within the tolerance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from loi_core import Parameters, Renderer, RendererCapabilities
from loi_core.renderers.contract import LossPullback, Pullback, capabilities_of
from loi_core.support.arrays import Array

__all__ = ["CountedRenderer", "Tally"]


@dataclass
class Tally:
    """Number of images so far, and its value when the parameters first reached the goal."""

    reaches: Callable[[Parameters], bool]
    renders: int = 0
    reached: int | None = None

    def count(self, params: Parameters) -> None:
        """Count one image."""
        self.renders += 1
        if self.reached is None and self.reaches(params):
            self.reached = self.renders


class CountedRenderer:
    """A renderer whose images a :class:`Tally` counts.

    Parameters
    ----------
    renderer : Renderer
    tally : Tally
    """

    def __init__(self, renderer: Renderer, tally: Tally) -> None:
        self._renderer, self._tally = renderer, tally

    @property
    def capabilities(self) -> RendererCapabilities:
        """The capabilities of the counted renderer."""
        capabilities = capabilities_of(self._renderer)
        with_loss = capabilities.render_loss_vjp

        def render_loss_vjp(params: Any, /, *, seed: int = 0) -> tuple[Any, LossPullback]:
            assert with_loss is not None
            self._tally.count(params)
            return with_loss(params, seed=seed)

        def counted(hook: Callable[..., Renderer] | None) -> Callable[..., Renderer] | None:
            if hook is None:
                return None
            return lambda *arguments, **options: CountedRenderer(hook(*arguments, **options), self._tally)

        return replace(
            capabilities,
            render_loss_vjp=None if with_loss is None else render_loss_vjp,
            start=counted(capabilities.start),
            revisit=counted(capabilities.revisit),
            unabridged=counted(capabilities.unabridged),
        )

    def parameters(self) -> Parameters:
        """Return the parameters of the counted renderer."""
        return self._renderer.parameters()

    def render(self, params: Parameters, *, seed: int = 0) -> Array:
        """Return the image, and count it."""
        self._tally.count(params)
        return self._renderer.render(params, seed=seed)

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, Pullback]:
        """Return the image and its pullback, and count the image."""
        self._tally.count(params)
        return self._renderer.render_vjp(params, seed=seed)
