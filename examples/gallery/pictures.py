"""What the gallery shows: a fit's start, target and result side by side, and its steps as a film. No part of `loi`."""

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

FRAMES = 30
TIME, PAUSE = 100, 1500  # milliseconds of a frame, and of the last
WIDTH = 300  # of an image in a film, in pixels
GAP = 6


class Film:
    """The images of a fit: call `keep` after each step, or give the film to `fit` as its callback.

    Parameters
    ----------
    target : array, shape (H, W, C) or (views, H, W, C)
        Of any library. Views are put side by side.
    linear : bool
        Whether the values are linear light, as those of path tracers, and need encoding for a display.
    """

    def __init__(self, target: Any, *, linear: bool = False) -> None:
        self._linear = linear
        self.target = self._shown(target)
        self.frames: list[Any] = []

    def keep(self, image: Any) -> None:
        """One more step."""
        self.frames.append(self._shown(image))

    def __call__(self, _step: Any, _params: Any, image: Any) -> None:
        """What `fit` calls."""
        self.keep(image)

    def show(self, **more: Any) -> None:
        """A figure of the first image, the target and the last image; and of `more`, by its name, before the last."""
        pictures = {"start": self.frames[0], "photograph": self.target}
        pictures |= {name.replace("_", " "): self._shown(image) for name, image in more.items()}
        pictures["found"] = self.frames[-1]
        height, width = self.target.shape[:2]
        if width > 2 * height:
            figure, axes = plt.subplots(len(pictures), 1, figsize=(6.0, 6.4 * len(pictures) * height / width))
        else:
            figure, axes = plt.subplots(1, len(pictures), figsize=(9.0, 9.0 / len(pictures) * height / width + 0.35))
        figure.set_layout_engine("constrained")
        for axis, (title, picture) in zip(axes, pictures.items(), strict=True):
            axis.imshow(picture, interpolation="nearest")
            axis.set(xticks=[], yticks=[], title=title)
        if plt.get_backend().lower() != "agg":  # which has no windows
            plt.show()

    def play(self) -> Clip:
        """The steps, beside the target."""
        chosen = np.unique(np.linspace(0, len(self.frames) - 1, FRAMES).astype(int))
        height, width = self.target.shape[:2]
        size = (WIDTH, round(WIDTH * height / width))
        pages = []
        for index in chosen:
            page = Image.new("RGB", (2 * WIDTH + GAP, size[1]), "white")
            for left, picture in ((0, self.frames[index]), (WIDTH + GAP, self.target)):
                page.paste(Image.fromarray(picture).resize(size, Image.Resampling.BICUBIC), (left, 0))
            pages.append(page)
        times = [TIME] * (len(pages) - 1) + [PAUSE]
        stream, last = io.BytesIO(), io.BytesIO()
        pages[0].save(stream, "WEBP", save_all=True, append_images=pages[1:], duration=times, loop=0, quality=75)
        pages[-1].save(last, "WEBP", quality=75)
        return Clip(stream.getvalue(), last.getvalue(), pages[0].size)

    def _shown(self, image: Any) -> Any:
        values = np.asarray(image.detach() if hasattr(image, "detach") else image, dtype=np.float64)
        if values.ndim == 4:
            values = np.concatenate(list(values), axis=1)
        values = np.clip(values, 0.0, 1.0)
        return np.rint(255.0 * (values ** (1.0 / 2.2) if self._linear else values)).astype(np.uint8)


@dataclass(frozen=True)
class Clip:
    """An animated WebP, its last frame, and its size in pixels. Notebooks and the gallery show it."""

    moving: bytes
    still: bytes
    size: tuple[int, int]

    def save(self, path: Path | str) -> None:
        """Write the animation, a WebP."""
        Path(path).write_bytes(self.moving)

    def _repr_html_(self) -> str:
        # Who has asked for less motion sees the last frame; anybody can stop it by folding it away.
        moving, still = (
            f"data:image/webp;base64,{base64.b64encode(one).decode()}" for one in (self.moving, self.still)
        )
        says = html.escape("Left, the image of each step; right, the photograph.")
        return (
            f"<details open><summary>The fit, step by step</summary><picture>"
            f'<source media="(prefers-reduced-motion: reduce)" srcset="{still}">'
            f'<img src="{moving}" alt="{says}" width="{self.size[0]}" height="{self.size[1]}" '
            f'style="max-width: 100%; height: auto"></picture></details>'
        )
