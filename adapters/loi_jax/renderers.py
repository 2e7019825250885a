"""Disks on JAX, equal to `loi_core.renderers.Disks`, compiled for any of JAX's devices."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from loi_core import renderers as core
from loi_core.errors import ParameterError
from loi_core.renderers.contract import RendererCapabilities
from loi_core.renderers.coverage import canvas_coverage
from loi_core.renderers.validation import FloatArray, check_parameters
from loi_core.support.arrays import to_numpy
from loi_core.support.keywords import suggest_keywords

__all__ = ["Disks"]

Arrays: TypeAlias = dict[str, jax.Array]


@suggest_keywords
class Disks:
    """`n` disks over a plain background, the later ones on top: :class:`loi_core.renderers.Disks` on JAX.

    Parameters
    ----------
    height, width, positions, radii, colours, background, dtype, confine
        See :class:`loi_core.renderers.Disks`; the parameters and the image are the same, as JAX arrays. A dtype of
        float64 needs JAX's ``jax_enable_x64``; the arithmetic inside is float64 either way.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or is not finite, or JAX does not allow the dtype.

    Notes
    -----
    `render` compiles once for each image size, number of disks and dtype. Every disk is painted on the whole canvas,
    so memory grows with n times the number of pixels. `render` checks values, so it cannot be traced.
    """

    backend: ClassVar[str] = "jax"

    def __init__(
        self,
        height: int,
        width: int,
        positions: Sequence[Sequence[float]] | FloatArray,
        radii: float | Sequence[float] | FloatArray,
        colours: Sequence[Sequence[float]] | FloatArray,
        background: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
        *,
        dtype: str = "float64",
        confine: bool = False,
    ) -> None:
        self._core = core.Disks(height, width, positions, radii, colours, background, dtype=dtype, confine=confine)
        if jnp.zeros((), dtype=float).dtype.itemsize < np.dtype(dtype).itemsize:
            msg = "`dtype` 'float64' needs JAX's 64-bit mode; set JAX_ENABLE_X64=1, or give dtype='float32'"
            raise ParameterError(msg)
        self._dtype = dtype

    @property
    def capabilities(self) -> RendererCapabilities:
        """A fit calls :meth:`project` after every step."""
        return RendererCapabilities(project=self.project)

    def parameters(self) -> Arrays:
        """Return ``positions`` (n, 2), ``radii`` (n,) and ``colours`` (n, 3) in the scene's dtype."""
        return self._as_jax(self._core.parameters())

    def render(self, params: Arrays, *, seed: int = 0) -> jax.Array:
        """Return the image, shape (height, width, 3); `seed` is unused, because nothing is random."""
        scene = self._checked(params)
        with jax.enable_x64():
            image: jax.Array = _render(scene, self._core.background, self._core.size, self._dtype)
        return image

    def render_vjp(self, params: Arrays, *, seed: int = 0) -> tuple[jax.Array, Callable[[jax.Array], Arrays]]:
        """Return the image and its pullback; see :class:`loi_core.Renderer`."""
        scene = self._checked(params)
        with jax.enable_x64():
            image, residuals = _render_vjp(scene, self._core.background, self._core.size, self._dtype)

        def pullback(cotangent: jax.Array) -> Arrays:
            with jax.enable_x64():
                slopes: Arrays = _pull_back(residuals, cotangent, self._dtype)
            return slopes

        return image, pullback

    def project(self, params: Arrays) -> Arrays:
        """Return the legal parameters nearest to `params`; see :meth:`loi_core.renderers.Disks.project`."""
        return self._as_jax(self._core.project(_host(params)))

    def _checked(self, params: Arrays) -> dict[str, FloatArray]:
        return check_parameters(_host(params), self._core.parameters())

    def _as_jax(self, values: Mapping[str, FloatArray]) -> Arrays:
        return {name: jnp.asarray(value, dtype=self._dtype) for name, value in values.items()}


@partial(jax.custom_vjp, nondiff_argnums=(2,))
def _coverage(positions: jax.Array, radii: jax.Array, size: tuple[int, int]) -> jax.Array:
    """Return the core's areas, shape (n, height, width), with the core's derivatives.

    JAX's derivatives of square roots are NaN at 0.
    """
    return _forward(positions, radii, size)[0]


def _forward(positions: jax.Array, radii: jax.Array, size: tuple[int, int]) -> tuple[jax.Array, tuple[jax.Array, ...]]:
    rows, columns = (jnp.arange(length + 1, dtype=positions.dtype) for length in size)
    coverage, *slopes = canvas_coverage(positions, radii, columns, rows)
    return coverage, tuple(slopes)


def _backward(_: tuple[int, int], slopes: tuple[jax.Array, ...], upstream: jax.Array) -> tuple[jax.Array, jax.Array]:
    by_x, by_y, by_radius = (jnp.sum(upstream * slope, axis=(-2, -1)) for slope in slopes)
    return jnp.stack([by_x, by_y], axis=-1), by_radius


_coverage.defvjp(_forward, _backward)


def _paint(background: jax.Array, size: tuple[int, int], scene: Arrays) -> jax.Array:
    def over(image: jax.Array, disk: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        cover, colour = disk
        return image + cover[..., None] * (colour - image), None

    coverage = _coverage(scene["positions"], scene["radii"], size)
    canvas = jnp.broadcast_to(background, (*size, 3))
    image: jax.Array = jax.lax.scan(over, canvas, (coverage, scene["colours"]))[0]
    return image


@partial(jax.jit, static_argnums=(2, 3))
def _render(scene: Arrays, background: jax.Array, size: tuple[int, int], dtype: str) -> jax.Array:
    return _paint(background, size, scene).astype(dtype)


@partial(jax.jit, static_argnums=(2, 3))
def _render_vjp(
    scene: Arrays, background: jax.Array, size: tuple[int, int], dtype: str
) -> tuple[jax.Array, Callable[[jax.Array], tuple[Arrays]]]:
    image, vjp = jax.vjp(partial(_paint, background, size), scene)
    return image.astype(dtype), vjp  # its residuals are a tree of arrays, so it may leave the compiled code


@partial(jax.jit, static_argnums=2)
def _pull_back(vjp: Callable[[jax.Array], tuple[Arrays]], cotangent: jax.Array, dtype: str) -> Arrays:
    (slopes,) = vjp(cotangent.astype(jnp.float64))
    return {name: slope.astype(dtype) for name, slope in slopes.items()}


def _host(params: Mapping[str, Any]) -> dict[str, np.ndarray[Any, Any]]:
    return {name: to_numpy(value) for name, value in params.items()}
