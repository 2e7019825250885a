"""Anti-aliased disks, painted in order: the benchmark scene of the paper's Table 1."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from loi_core.errors import ParameterError
from loi_core.messages import shown
from loi_core.renderers.checks import FloatArray, check_dtype, check_parameters, check_size, floats
from loi_core.renderers.coverage import disk_coverage

__all__ = ["Disks"]

LEAST_RADIUS = 0.1
GOLDEN_ANGLE = 2.399963
SEPARATION_ROUNDS = 10  # sweeps that push overlapping disks apart; chains of touching disks need a few


@dataclass(frozen=True)
class _Stamp:
    """One disk on the pixels that it can touch; every array is (h, w)."""

    rows: slice
    columns: slice
    coverage: FloatArray  # in [0, 1]
    by_x: FloatArray  # derivative of the coverage by the centre's x
    by_y: FloatArray
    by_radius: FloatArray


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
    Only pixels near a disk are touched, so the cost grows with the area covered.
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
        centres = floats("positions", positions, (None, 2))
        count = centres.shape[0]
        spread = np.full(count, radii) if np.ndim(radii) == 0 else radii
        self._scene = {
            "positions": centres,
            "radii": floats("radii", spread, (count,)),
            "colours": floats("colours", colours, (count, 3)),
        }
        self.background = floats("background", background, (3,))
        self._dtype = check_dtype(dtype)
        if not isinstance(confine, bool):
            msg = f"`confine` must be true or false, got {shown(confine)}"
            raise ParameterError(msg)
        if np.any(self._scene["radii"] < 0.0):
            msg = f"`radii` must be 0 or more, got {self._scene['radii'].min():g}"
            raise ParameterError(msg)
        self._confine = confine

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
        scene = check_parameters(params, self._scene)
        image = np.broadcast_to(self.background, (*self.size, 3)).copy()
        stamps: list[_Stamp | None] = []
        beneath: list[FloatArray | None] = []
        for centre, radius, colour in zip(scene["positions"], scene["radii"], scene["colours"], strict=True):
            stamp = self._stamp(centre, float(radius))
            stamps.append(stamp)
            if stamp is None:
                beneath.append(None)
                continue
            under = image[stamp.rows, stamp.columns].copy()
            beneath.append(under)
            image[stamp.rows, stamp.columns] = under + stamp.coverage[..., None] * (colour - under)
        colours = scene["colours"]

        def pullback(cotangent: FloatArray) -> dict[str, FloatArray]:
            flowing = np.array(cotangent, dtype=np.float64)
            result = {name: np.zeros_like(value) for name, value in scene.items()}
            for index in reversed(range(len(stamps))):
                stamp, under = stamps[index], beneath[index]
                if stamp is None or under is None:
                    continue
                arriving = flowing[stamp.rows, stamp.columns]
                by_coverage = np.sum(arriving * (colours[index] - under), axis=-1)
                result["radii"][index] = np.sum(by_coverage * stamp.by_radius)
                result["positions"][index] = np.sum(by_coverage * stamp.by_x), np.sum(by_coverage * stamp.by_y)
                result["colours"][index] = np.einsum("hwc,hw->c", arriving, stamp.coverage)
                flowing[stamp.rows, stamp.columns] = arriving * (1.0 - stamp.coverage[..., None])
            return {name: value.astype(self._dtype) for name, value in result.items()}

        return image.astype(self._dtype), pullback

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """`params` with radii of a tenth of a pixel or more, and the disks confined if the scene asks for it.

        A disk without area would have no gradient, and could never come back.
        """
        scene = check_parameters(params, self._scene)
        scene["radii"] = np.maximum(scene["radii"], LEAST_RADIUS)
        if self._confine:
            scene["positions"] = _confined(scene["positions"], scene["radii"], self.size)
        return {name: value.astype(self._dtype) for name, value in scene.items()}

    def _stamp(self, centre: FloatArray, radius: float) -> _Stamp | None:
        height, width = self.size
        columns = _touched(float(centre[0]), radius, width)
        rows = _touched(float(centre[1]), radius, height)
        if radius <= 0.0 or columns.start >= columns.stop or rows.start >= rows.stop:
            return None
        x = np.arange(columns.start, columns.stop + 1) - float(centre[0])
        y = np.arange(rows.start, rows.stop + 1) - float(centre[1])
        # A radius whose square is beyond float64 gives an image that is not finite, as every user of images checks.
        with np.errstate(over="ignore", invalid="ignore"):
            return _Stamp(rows, columns, *disk_coverage(x[None, :], y[:, None], np.full((1, 1), radius)))


def _touched(centre: float, radius: float, size: int) -> slice:
    """The pixels of an axis that [centre - radius, centre + radius] meets."""
    start, stop = (min(max(edge, 0.0), float(size)) for edge in (centre - radius, centre + radius))
    return slice(int(np.floor(start)), int(np.ceil(stop)))


def _confined(positions: FloatArray, radii: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Centres moved by little that brings every disk into the frame and parts each overlapping pair."""
    count = positions.shape[0]
    frame = np.array(size[::-1], dtype=np.float64)
    margin = np.minimum(radii[:, None], 0.5 * frame)
    positions = np.clip(positions, margin, frame - margin)
    # Two disks in exactly the same place have no direction to part in: each pair gets one of its own.
    angles = GOLDEN_ANGLE * np.arange(count)
    spare = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    spare = spare[:, None, :] - spare[None, :, :]
    spare /= np.maximum(np.linalg.norm(spare, axis=-1, keepdims=True), 1e-12)
    wanted = radii[:, None] + radii[None, :]
    np.fill_diagonal(wanted, 0.0)
    for _ in range(SEPARATION_ROUNDS):
        apart = positions[:, None, :] - positions[None, :, :]
        distance = np.linalg.norm(apart, axis=-1)
        overlap = np.maximum(wanted - distance, 0.0)
        if not np.any(overlap > 0.0):
            break
        near = distance[..., None] < 1e-9
        direction = np.where(near, spare, apart / np.maximum(distance, 1e-9)[..., None])
        pushed = positions + 0.5 * np.sum(overlap[..., None] * direction, axis=1)
        positions = np.clip(pushed, margin, frame - margin)
    return positions
