"""Renderer of a picture over a background, with translation, rotation, scale and exposure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np

from loi_core.errors import ParameterError
from loi_core.renderers.contract import RendererCapabilities
from loi_core.renderers.validation import FloatArray, check_dtype, check_floats, check_image, check_parameters
from loi_core.support.keywords import suggest_keywords

__all__ = ["Warp"]

MIN_SCALE = 0.01


@suggest_keywords
class Warp:
    """Renderer of a picture over a background, translated, rotated and scaled about its centre.

    Parameters
    ----------
    picture : array, shape (h, w, 3) or (h, w, 4)
        Linear RGB, optionally with opacity in [0, 1] as fourth channel. Transparent outside.
    background : array, shape (H, W, 3)
        Linear RGB; determines the size of the image.
    translation : array, shape (2,)
        Offset from the centre of the background to the centre of the picture, (x, y) in pixels, y down.
    rotation : float
        In degrees, clockwise on the screen.
    scale : float
        Pixels of the background per pixel of the picture; more than 0.
    exposure : float
        In stops: the image is multiplied by ``2 ** exposure``.
    dtype : {"float64", "float32"}
        Dtype of parameters and images; internal arithmetic is float64.

    Attributes
    ----------
    layers : array, shape (h, w, 4), float64
        The picture: linear RGB times opacity, and opacity.
    background : array, shape (H, W, 3), float64
        Linear RGB.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or is not finite, or the scale is not positive.

    Notes
    -----
    The picture is sampled bilinearly with premultiplied opacity and without a prefilter, so it aliases below a scale of
    about one half.
    """

    backend: ClassVar[str] = "numpy"

    def __init__(
        self,
        picture: FloatArray,
        background: FloatArray,
        translation: tuple[float, float] | FloatArray = (0.0, 0.0),
        rotation: float | FloatArray = 0.0,
        scale: float | FloatArray = 1.0,
        exposure: float | FloatArray = 0.0,
        *,
        dtype: str = "float64",
    ) -> None:
        picture = check_image("picture", picture, (3, 4))
        self.background = check_image("background", background, (3,))
        self._dtype = check_dtype(dtype)
        opacity = picture[..., 3:] if picture.shape[2] == 4 else np.ones((*picture.shape[:2], 1))
        self.layers = np.concatenate([picture[..., :3] * opacity, opacity], axis=-1)
        self._picture = np.pad(
            self.layers, ((1, 1), (1, 1), (0, 0))
        )  # a transparent border for samples on the edge of the picture
        self._scene = {
            "translation": check_floats("translation", translation, (2,)),
            "rotation": check_floats("rotation", rotation, ()),
            "scale": check_floats("scale", scale, ()),
            "exposure": check_floats("exposure", exposure, ()),
        }

    @property
    def capabilities(self) -> RendererCapabilities:
        """A fit calls :meth:`project` after every step."""
        return RendererCapabilities(project=self.project)

    def parameters(self) -> dict[str, FloatArray]:
        """Return ``translation`` (2,), ``rotation`` (), ``scale`` () and ``exposure`` (), in the scene's dtype."""
        return {name: value.astype(self._dtype) for name, value in self._scene.items()}

    def render(self, params: dict[str, FloatArray], *, seed: int = 0) -> FloatArray:
        """Return the image, shape (H, W, 3); `seed` is ignored, since nothing is random."""
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(
        self, params: dict[str, FloatArray], *, seed: int = 0
    ) -> tuple[FloatArray, Callable[[FloatArray], dict[str, FloatArray]]]:
        """Return the image and its pullback; see :class:`loi_core.Renderer`."""
        pose = self.checked(params)
        scale = float(pose["scale"])
        angle = np.deg2rad(float(pose["rotation"]))
        cos, sin = float(np.cos(angle)), float(np.sin(angle))
        height, width = self.background.shape[:2]
        rows, columns = self._window(pose["translation"], scale, cos, sin)
        x = np.arange(columns.start, columns.stop) + 0.5 - 0.5 * width - pose["translation"][0]
        y = np.arange(rows.start, rows.stop) + 0.5 - 0.5 * height - pose["translation"][1]
        x, y = np.broadcast_arrays(x[None, :], y[:, None])
        u = (cos * x + sin * y) / scale  # relative to the centre of the picture, in its pixels
        v = (cos * y - sin * x) / scale
        colour, by_u, by_v = self._sample(u, v)
        backdrop = self.background[rows, columns]
        gain = float(np.exp2(pose["exposure"]))
        image = gain * self.background
        image[rows, columns] = gain * (colour[..., :3] + (1.0 - colour[..., 3:]) * backdrop)

        def pullback(cotangent: FloatArray) -> dict[str, FloatArray]:
            cotangent = np.asarray(cotangent, dtype=np.float64)
            incoming = gain * cotangent[rows, columns]
            layer_cotangent = np.concatenate([incoming, -np.sum(incoming * backdrop, axis=-1, keepdims=True)], axis=-1)
            to_u = np.sum(layer_cotangent * by_u, axis=-1)
            to_v = np.sum(layer_cotangent * by_v, axis=-1)
            result = {
                "translation": np.array(
                    [np.sum(sin * to_v - cos * to_u) / scale, -np.sum(sin * to_u + cos * to_v) / scale]
                ),
                "rotation": np.asarray(np.deg2rad(1.0) * np.sum(to_u * v - to_v * u)),
                "scale": np.asarray(-np.sum(to_u * u + to_v * v) / scale),
                "exposure": np.asarray(np.log(2.0) * np.sum(cotangent * image)),
            }
            return {name: value.astype(self._dtype) for name, value in result.items()}

        return image.astype(self._dtype), pullback

    def checked(self, params: Mapping[str, object]) -> dict[str, FloatArray]:
        """Return `params` as float64 arrays; raise :class:`ParameterError` for wrong names, shapes or scales."""
        pose = check_parameters(params, self._scene)
        if pose["scale"] <= 0.0:
            msg = f"`scale` must be more than 0, got {float(pose['scale'])}"
            raise ParameterError(msg)
        return pose

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return `params` with a scale of at least 0.01, since a picture without area has no gradient."""
        pose = check_parameters(params, self._scene)
        pose["scale"] = np.maximum(pose["scale"], MIN_SCALE)
        return {name: np.asarray(value, dtype=self._dtype) for name, value in pose.items()}

    def _window(self, translation: FloatArray, scale: float, cos: float, sin: float) -> tuple[slice, slice]:
        """Return the rows and columns of the background that the picture with its border can cover."""
        height, width = self.background.shape[:2]
        half_h, half_w = (0.5 * size for size in self._picture.shape[:2])
        reach_x = scale * (half_w * abs(cos) + half_h * abs(sin))
        reach_y = scale * (half_w * abs(sin) + half_h * abs(cos))
        slices = []
        for size, centre, reach in ((height, translation[1], reach_y), (width, translation[0], reach_x)):
            start = int(np.clip(np.floor(0.5 * size + centre - reach), 0, size))
            stop = int(np.clip(np.ceil(0.5 * size + centre + reach), start, size))
            slices.append(slice(start, stop))
        return slices[0], slices[1]

    def _sample(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return premultiplied RGB and opacity at points of the picture, with derivatives with respect to u and v."""
        height, width = self._picture.shape[:2]
        x = u + 0.5 * width - 0.5
        y = v + 0.5 * height - 0.5
        left = np.floor(x).astype(np.intp)
        top = np.floor(y).astype(np.intp)
        outside = ((left < 0) | (left > width - 2) | (top < 0) | (top > height - 2))[..., None]
        column, row = np.clip(left, 0, width - 2), np.clip(top, 0, height - 2)
        fx, fy = (x - left)[..., None], (y - top)[..., None]
        nw, ne = self._picture[row, column], self._picture[row, column + 1]
        sw, se = self._picture[row + 1, column], self._picture[row + 1, column + 1]
        upper, lower = nw + fx * (ne - nw), sw + fx * (se - sw)
        colour = upper + fy * (lower - upper)
        by_u = (ne - nw) + fy * ((se - sw) - (ne - nw))
        by_v = lower - upper
        return (
            np.where(outside, 0.0, colour),
            np.where(outside, 0.0, by_u),
            np.where(outside, 0.0, by_v),
        )
