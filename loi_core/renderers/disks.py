"""Anti-aliased disks, painted in order: the benchmark scene of the paper's Table 1."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np

from loi_core.errors import ParameterError
from loi_core.renderers.contract import RendererCapabilities
from loi_core.renderers.coverage import disk_coverage
from loi_core.renderers.packing import separate_disks
from loi_core.renderers.rasterization import IndexArray, rasterize_disks
from loi_core.renderers.validation import FloatArray, check_dtype, check_floats, check_parameters, check_size
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import shown

__all__ = ["Disks"]

MIN_RADIUS_PX = 0.1


@suggest_keywords
class Disks:
    """Renderer of `n` disks over a plain background, later disks on top.

    Parameters
    ----------
    height, width : int
        Size of the image in pixels. Pixel (0, 0) covers the unit square at the origin.
    positions : array, shape (n, 2)
        Centres (x, y) in pixels, y down.
    radii : float or array, shape (n,)
        In pixels.
    colours : array, shape (n, 3)
        Linear RGB.
    background : array, shape (3,)
        Linear RGB.
    dtype : {"float64", "float32"}
        Dtype of parameters and images; internal arithmetic is float64.
    confine : bool
        Whether :meth:`project` moves every disk into the frame and separates overlapping disks. A disk that is hidden
        by another disk, or outside the frame, has no gradient and cannot escape by itself.

    Attributes
    ----------
    size : tuple of int
        Height and width of the image in pixels.
    background : array, shape (3,), float64
        Linear RGB.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or is not finite.

    Notes
    -----
    The coverage of a pixel is the exact area of the disk in it, and its derivative is exact too. With an approximation,
    such as a ramp over the distance to the edge, the total area of a disk varies slightly with its subpixel position.
    Far from the target, where the gradient of any loss is small, this variation alone would decide the direction. Only
    covered pixels are visited, and areas are computed only on edges, so the cost grows with the covered area.
    """

    backend: ClassVar[str] = "numpy"

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
        self.size = check_size("height", height), check_size("width", width)
        centres = check_floats("positions", positions, (None, 2))
        count = centres.shape[0]
        radii = np.full(count, radii) if np.ndim(radii) == 0 else radii
        self._scene = {
            "positions": centres,
            "radii": check_floats("radii", radii, (count,)),
            "colours": check_floats("colours", colours, (count, 3)),
        }
        self.background = check_floats("background", background, (3,))
        self._dtype = check_dtype(dtype)
        if not isinstance(confine, bool):
            msg = f"`confine` must be true or false, got {shown(confine)}"
            raise ParameterError(msg)
        if np.any(self._scene["radii"] < 0.0):
            msg = f"`radii` must be 0 or more, got {self._scene['radii'].min():g}"
            raise ParameterError(msg)
        self._confine = confine

    @property
    def capabilities(self) -> RendererCapabilities:
        """A fit calls :meth:`project` after every step."""
        return RendererCapabilities(project=self.project)

    def parameters(self) -> dict[str, FloatArray]:
        """Return ``positions`` (n, 2), ``radii`` (n,) and ``colours`` (n, 3), in the dtype of the renderer."""
        return {name: value.astype(self._dtype) for name, value in self._scene.items()}

    def render(self, params: dict[str, FloatArray], *, seed: int = 0) -> FloatArray:
        """Return the image, shape (height, width, 3); `seed` is ignored, since nothing is random."""
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(
        self, params: dict[str, FloatArray], *, seed: int = 0
    ) -> tuple[FloatArray, Callable[[FloatArray], dict[str, FloatArray]]]:
        """Return the image and its pullback; see :class:`loi_core.Renderer`."""
        scene = self.checked(params)
        positions, radii = scene["positions"], scene["radii"]
        # Squares of coordinates beyond 1e154 overflow; the image is then not finite, which callers check.
        with np.errstate(over="ignore", invalid="ignore"):
            fragments = rasterize_disks(positions, radii, self.size)
            owner, pixels = fragments.owner, fragments.rows * self.size[1] + fragments.columns
            coverage = np.ones(len(owner))
            edge = np.flatnonzero(fragments.on_edge)
            corners = np.arange(2.0)
            x = fragments.columns[edge, None] + corners - positions[owner[edge], :1]
            y = fragments.rows[edge, None] + corners - positions[owner[edge], 1:]
            edge_coverage, *derivatives = disk_coverage(x[:, None, :], y[:, :, None], radii[owner[edge], None, None])
        coverage[edge] = edge_coverage[:, 0, 0]
        alpha, colours = coverage[:, None], scene["colours"][owner]
        image = np.broadcast_to(self.background, (self.size[0] * self.size[1], 3)).copy()
        beneath = np.empty_like(colours)
        for layer in fragments.layers:
            beneath[layer] = image[pixels[layer]]
            image[pixels[layer]] = beneath[layer] + alpha[layer] * (colours[layer] - beneath[layer])

        def pullback(cotangent: FloatArray) -> dict[str, FloatArray]:
            cotangents = np.array(cotangent, dtype=np.float64).reshape(-1, 3)
            fragment_cotangents = np.empty_like(colours)
            for layer in reversed(fragments.layers):
                fragment_cotangents[layer] = cotangents[pixels[layer]]
                cotangents[pixels[layer]] = fragment_cotangents[layer] * (1.0 - alpha[layer])
            by_coverage = np.sum(fragment_cotangents * (colours - beneath), axis=-1)[edge]

            def total(weights: FloatArray, owner: IndexArray) -> FloatArray:
                return np.bincount(owner, weights, minlength=len(radii)).astype(np.float64, copy=False)

            by_x, by_y, by_radius = (
                total(by_coverage * derivative[:, 0, 0], owner[edge]) for derivative in derivatives
            )
            by_colour = [total(fragment_cotangents[:, channel] * coverage, owner) for channel in range(3)]
            result = {
                "positions": np.stack([by_x, by_y], axis=-1),
                "radii": by_radius,
                "colours": np.stack(by_colour, axis=-1),
            }
            return {name: value.astype(self._dtype) for name, value in result.items()}

        return image.reshape(*self.size, 3).astype(self._dtype), pullback

    def checked(self, params: Mapping[str, object]) -> dict[str, FloatArray]:
        """Return `params` as float64 arrays; raise :class:`ParameterError` for wrong names or shapes."""
        return check_parameters(params, self._scene)

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return `params` with radii of at least 0.1 pixels, and with the disks separated if `confine` is set.

        A disk without area has no gradient, and its radius could never grow again.
        """
        scene = self.checked(params)
        scene["radii"] = np.maximum(scene["radii"], MIN_RADIUS_PX)
        if self._confine:
            scene["positions"] = separate_disks(scene["positions"], scene["radii"], self.size)
        return {name: value.astype(self._dtype) for name, value in scene.items()}
