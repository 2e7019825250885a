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
from loi_core.support.wording import shown

__all__ = ["Disks"]

LEAST_RADIUS = 0.1


class Disks:
    """`n` disks over a plain background, the later ones on top.

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
        Of parameters and images; the arithmetic inside is float64.
    confine : bool
        Whether :meth:`project` keeps every disk whole in the frame and apart from the others. Under another disk,
        or outside the frame, a disk has no gradient, so it cannot get away by itself.

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
    A pixel's coverage is the exact area of the disk in it, and its derivative is exact too. An approximation,
    such as a ramp over the distance to the edge, makes the disk's total area change a little with its position
    between pixels. Far from the target, where the pull of any loss is faint, that alone decides the direction.
    Only pixels that a disk meets are touched, so the cost grows with the area covered, and areas are computed only
    where an edge passes.
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
        spread = np.full(count, radii) if np.ndim(radii) == 0 else radii
        self._scene = {
            "positions": centres,
            "radii": check_floats("radii", spread, (count,)),
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
        """``positions`` (n, 2), ``radii`` (n,) and ``colours`` (n, 3), of the scene's dtype."""
        return {name: value.astype(self._dtype) for name, value in self._scene.items()}

    def render(self, params: dict[str, FloatArray], *, seed: int = 0) -> FloatArray:
        """The image, shape (height, width, 3); `seed` is not needed, nothing is random."""
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(
        self, params: dict[str, FloatArray], *, seed: int = 0
    ) -> tuple[FloatArray, Callable[[FloatArray], dict[str, FloatArray]]]:
        """The image and its pullback; see :class:`loi_core.Renderer`."""
        scene = self.checked(params)
        positions, radii = scene["positions"], scene["radii"]
        # Beyond 1e154 coordinates have no squares; where that matters the image is not finite, which its users check.
        with np.errstate(over="ignore", invalid="ignore"):
            fragments = rasterize_disks(positions, radii, self.size)
            owner, pixels = fragments.owner, fragments.rows * self.size[1] + fragments.columns
            coverage = np.ones(len(owner))
            edge = np.flatnonzero(fragments.on_edge)
            corners = np.arange(2.0)
            x = fragments.columns[edge, None] + corners - positions[owner[edge], :1]
            y = fragments.rows[edge, None] + corners - positions[owner[edge], 1:]
            parts = disk_coverage(x[:, None, :], y[:, :, None], radii[owner[edge], None, None])
        coverage[edge], *slopes = (part[:, 0, 0] for part in parts)
        share, colours = coverage[:, None], scene["colours"][owner]
        image = np.broadcast_to(self.background, (self.size[0] * self.size[1], 3)).copy()
        beneath = np.empty_like(colours)
        for layer in fragments.layers:
            beneath[layer] = image[pixels[layer]]
            image[pixels[layer]] = beneath[layer] + share[layer] * (colours[layer] - beneath[layer])

        def pullback(cotangent: FloatArray) -> dict[str, FloatArray]:
            flowing = np.array(cotangent, dtype=np.float64).reshape(-1, 3)
            arriving = np.empty_like(colours)
            for layer in reversed(fragments.layers):
                arriving[layer] = flowing[pixels[layer]]
                flowing[pixels[layer]] = arriving[layer] * (1.0 - share[layer])
            by_coverage = np.sum(arriving * (colours - beneath), axis=-1)[edge]

            def total(weights: FloatArray, owner: IndexArray) -> FloatArray:
                return np.bincount(owner, weights, minlength=len(radii)).astype(np.float64, copy=False)

            by_x, by_y, by_radius = (total(by_coverage * slope, owner[edge]) for slope in slopes)
            by_colour = [total(arriving[:, channel] * coverage, owner) for channel in range(3)]
            result = {
                "positions": np.stack([by_x, by_y], axis=-1),
                "radii": by_radius,
                "colours": np.stack(by_colour, axis=-1),
            }
            return {name: value.astype(self._dtype) for name, value in result.items()}

        return image.reshape(*self.size, 3).astype(self._dtype), pullback

    def checked(self, params: Mapping[str, object]) -> dict[str, FloatArray]:
        """`params` as float64 arrays, once they are known to have the scene's names and shapes."""
        return check_parameters(params, self._scene)

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """`params` with radii of a tenth of a pixel or more, and the disks separated if the scene asks for it.

        A disk without area would have no gradient, and could never come back.
        """
        scene = self.checked(params)
        scene["radii"] = np.maximum(scene["radii"], LEAST_RADIUS)
        if self._confine:
            scene["positions"] = separate_disks(scene["positions"], scene["radii"], self.size)
        return {name: value.astype(self._dtype) for name, value in scene.items()}
