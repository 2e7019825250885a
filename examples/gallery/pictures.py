"""Pictures of the gallery: a fit's start, target and result side by side, and its steps as a film."""

from __future__ import annotations

import base64
import html
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

__all__ = ["Clip", "Film"]

MAX_FRAMES = 30
FRAME_MS, LAST_FRAME_MS = 100, 1500
WIDTH_PX = 300  # of an image in a film
GAP_PX = 6


class Film:
    """The images of a fit: call `keep` after each step, or give the film to `fit` as its callback.

    Parameters
    ----------
    target : array, shape (H, W, C) or (views, H, W, C)
        An array of any library. Views are drawn side by side.
    linear : bool
        Whether the values are linear light, as from a path tracer, and need encoding for a display.
    """

    def __init__(self, target: Any, *, linear: bool = False) -> None:
        self._linear = linear
        self.target = self._as_bytes(target)
        self.frames: list[Any] = []

    def keep(self, image: Any) -> None:
        """Add the image of a step."""
        self.frames.append(self._as_bytes(image))

    def __call__(self, _step: Any, _params: Any, image: Any) -> None:
        """Add the image of a step of `fit`."""
        self.keep(image)

    def show(self, **extra_images: Any) -> None:
        """Draw the first image, the target, `extra_images` by their names, and the last image."""
        pictures = {"start": self.frames[0], "photograph": self.target}
        pictures |= {name.replace("_", " "): self._as_bytes(image) for name, image in extra_images.items()}
        pictures["result"] = self.frames[-1]
        height, width = self.target.shape[:2]
        if width > 2 * height:
            figure, axes = plt.subplots(len(pictures), 1, figsize=(6.0, 6.4 * len(pictures) * height / width))
        else:
            figure, axes = plt.subplots(1, len(pictures), figsize=(9.0, 9.0 / len(pictures) * height / width + 0.35))
        figure.set_layout_engine("constrained")
        for axis, (title, picture) in zip(axes, pictures.items(), strict=True):
            axis.imshow(picture, interpolation="nearest")
            axis.set(xticks=[], yticks=[], title=title)
        if plt.get_backend().lower() != "agg":  # a backend without windows
            plt.show()

    def play(self) -> Clip:
        """Return an animation of the steps beside the target."""
        chosen = np.unique(np.linspace(0, len(self.frames) - 1, MAX_FRAMES).astype(int))
        height, width = self.target.shape[:2]
        size = (WIDTH_PX, round(WIDTH_PX * height / width))
        pages = []
        for index in chosen:
            page = Image.new("RGB", (2 * WIDTH_PX + GAP_PX, size[1]), "white")
            for left, picture in ((0, self.frames[index]), (WIDTH_PX + GAP_PX, self.target)):
                page.paste(Image.fromarray(picture).resize(size, Image.Resampling.BICUBIC), (left, 0))
            pages.append(page)
        times = [FRAME_MS] * (len(pages) - 1) + [LAST_FRAME_MS]
        stream, last = io.BytesIO(), io.BytesIO()
        pages[0].save(stream, "WEBP", save_all=True, append_images=pages[1:], duration=times, loop=0, quality=75)
        pages[-1].save(last, "WEBP", quality=75)
        return Clip(stream.getvalue(), last.getvalue(), pages[0].size)

    def _as_bytes(self, image: Any) -> Any:
        values = np.asarray(image.detach() if hasattr(image, "detach") else image, dtype=np.float64)
        if values.ndim == 4:
            values = np.concatenate(list(values), axis=1)
        values = np.clip(values, 0.0, 1.0)
        return np.rint(255.0 * (values ** (1.0 / 2.2) if self._linear else values)).astype(np.uint8)


@dataclass(frozen=True)
class Clip:
    """An animated WebP, its last frame, and its size in pixels, for notebooks and the gallery."""

    moving: bytes
    still: bytes
    size: tuple[int, int]

    def save(self, path: Path | str) -> None:
        """Write the animation, a WebP."""
        Path(path).write_bytes(self.moving)

    def _repr_html_(self) -> str:
        # A browser with reduced motion shows the last frame; the reader can fold the animation away.
        moving, still = (
            f"data:image/webp;base64,{base64.b64encode(data).decode()}" for data in (self.moving, self.still)
        )
        caption = html.escape("Left, the image of each step; right, the photograph.")
        return (
            f"<details open><summary>The fit, step by step</summary><picture>"
            f'<source media="(prefers-reduced-motion: reduce)" srcset="{still}">'
            f'<img src="{moving}" alt="{caption}" width="{self.size[0]}" height="{self.size[1]}" '
            f'style="max-width: 100%; height: auto"></picture></details>'
        )
