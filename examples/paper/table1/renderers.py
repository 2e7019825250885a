"""Disks for some remedies: with noise, or with a gradient for hidden disks."""

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
    """Disks with Gaussian noise of standard deviation `noise`, drawn anew for every seed."""

    def __init__(self, disks: Disks, noise: float) -> None:
        super().__init__(disks)
        self._noise = noise

    def render(self, params: dict[str, FloatArray], *, seed: int = 0) -> Image:
        """Return the image with noise."""
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(self, params: dict[str, FloatArray], *, seed: int = 0) -> tuple[Image, Pullback]:
        """Return the image with noise, and the pullback of the image: the noise is constant in the parameters."""
        image, pullback = self.disks.render_vjp(params, seed=seed)
        noise = self._noise * np.random.default_rng(seed).standard_normal(image.shape)
        return (image + noise).astype(image.dtype), pullback


class BothOrders(DisksWrapper):
    """Disks with the mean gradient of both painting orders: a disk that one order hides is on top in the other.

    The mean is exact where no two disks overlap; elsewhere it is the gradient of no image.
    """

    def render_vjp(self, params: dict[str, FloatArray], *, seed: int = 0) -> tuple[Image, Pullback]:
        """Return the image in the order of the disks, and the mean of both pullbacks."""
        image, forward_pullback = self.disks.render_vjp(params, seed=seed)
        reversed_params = {name: value[::-1] for name, value in params.items()}
        reversed_pullback = self.disks.render_vjp(reversed_params, seed=seed)[1]

        def pullback(cotangent: FloatArray) -> dict[str, FloatArray]:
            reversed_gradients = reversed_pullback(cotangent)
            gradients = forward_pullback(cotangent)
            return {name: 0.5 * (value + reversed_gradients[name][::-1]) for name, value in gradients.items()}

        return image, pullback
