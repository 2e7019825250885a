"""Disks as some remedies see them: with noise, or with a gradient for what is hidden."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from examples.paper.table1.problem import FloatArray, Image
from loi_core.renderers import Disks
from loi_core.renderers.contract import RendererCapabilities

__all__ = ["BothOrders", "DisksWrapper", "Noisy"]

Pullback: TypeAlias = Callable[[FloatArray], dict[str, FloatArray]]


class DisksWrapper:
    """Base of renderers that change one method of :class:`Disks`, and delegate the others."""

    backend = "numpy"

    def __init__(self, disks: Disks) -> None:
        self.disks = disks

    @property
    def capabilities(self) -> RendererCapabilities:
        """Declare that a fit calls :meth:`project` after every step."""
        return RendererCapabilities(project=self.project)

    def parameters(self) -> dict[str, FloatArray]:
        """Return the start of a fit; see :class:`Disks`."""
        return self.disks.parameters()

    def render(self, params: dict[str, FloatArray], *, seed: int = 0) -> Image:
        """Return the image; see :class:`Disks`."""
        return self.disks.render(params, seed=seed)

    def render_vjp(self, params: dict[str, FloatArray], *, seed: int = 0) -> tuple[Image, Pullback]:
        """Return the image and its pullback; see :class:`Disks`."""
        return self.disks.render_vjp(params, seed=seed)

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return the parameters that a fit continues with; see :class:`Disks`."""
        return self.disks.project(params)


class Noisy(DisksWrapper):
    """`disks` with Gaussian noise of this standard deviation, other noise for every seed."""

    def __init__(self, disks: Disks, noise: float) -> None:
        super().__init__(disks)
        self._noise = noise

    def render(self, params: dict[str, FloatArray], *, seed: int = 0) -> Image:
        """The image with noise."""
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(self, params: dict[str, FloatArray], *, seed: int = 0) -> tuple[Image, Pullback]:
        """The image with noise, which does not depend on the parameters."""
        image, pullback = self.disks.render_vjp(params, seed=seed)
        noise = self._noise * np.random.default_rng(seed).standard_normal(image.shape)
        return (image + noise).astype(image.dtype), pullback


class BothOrders(DisksWrapper):
    """`disks`, with the mean of the gradients of both orders of painting: in one of them what is hidden lies on top.

    Where no two disks overlap that is the exact gradient; elsewhere it is that of no image.
    """

    def render_vjp(self, params: dict[str, FloatArray], *, seed: int = 0) -> tuple[Image, Pullback]:
        """The image in its own order, and the pullback of both."""
        image, own = self.disks.render_vjp(params, seed=seed)
        opposite = self.disks.render_vjp({name: value[::-1] for name, value in params.items()}, seed=seed)[1]

        def pullback(cotangent: FloatArray) -> dict[str, FloatArray]:
            turned = opposite(cotangent)
            return {name: 0.5 * (value + turned[name][::-1]) for name, value in own(cotangent).items()}

        return image, pullback
