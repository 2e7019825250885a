"""What Mitsuba's projective integrators draw of a gradient: outlines in view, and those of shadows and reflections.

Mitsuba puts each sample on the film, and differentiates through that. So it makes an image that nobody looks at, in the
time of the gradient itself; and to find how the image changes it traces all rays again for each pixel that a sample
reaches, of 25 with a Gaussian filter. Samples are taken here before they reach the film.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final, Literal

import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = ["Silhouettes", "tangents_on"]

SEEDS: Final = {"sppp": 0xFFFFFFFF, "sppi": 0xAA00AA00}  # by part, those of samples; as in Mitsuba
GUIDE: Final = 0xAFAFAFAF  # that of what says where indirect silhouettes are looked for


@dataclass(frozen=True)
class Silhouettes:
    """One part of the gradient of a projective integrator.

    Attributes
    ----------
    sensor : mi.Sensor
    part : str
        "sppp", outlines in view, or "sppi", those of what is seen in mirrors, or hides light.
    """

    sensor: Any
    part: Literal["sppp", "sppi"]

    def jumps(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any] | None:
        """At points of silhouettes, 0 with how it changes: the jump times how far they move; and places. None without.

        The seed and `samples`, of each pixel, are those of Mitsuba's `render_backward`.
        """
        if not scene.silhouette_shapes():
            return None
        with dr.suspend_grad():
            if self.part == "sppp":
                integrator.proj_detail.init_primarily_visible_silhouette(scene, self.sensor)
                draw = integrator.render_primarily_visible_silhouette
            else:
                integrator.proj_detail.init_indirect_silhouette(scene, self.sensor, GUIDE ^ seed)
                draw = integrator.render_indirect_silhouette
            sampler, number = integrator.prepare(self.sensor, SEEDS[self.part] ^ seed, samples, integrator.aov_names())
        with _taken() as taken:
            draw(scene, self.sensor, sampler, 1)  # by whose number it is divided below, or each would be compiled anew
        if not taken:
            return None
        (sample,) = taken
        film = self.sensor.film()
        size = np.array(film.crop_size(), dtype=np.float64)
        border = 2.0 * film.rfilter().border_size() if film.sample_border() else 0.0
        each = number * float(np.prod((size + border) / size))  # for each pixel of the film without its border
        value = sample["value"]
        if mi.is_spectral:
            value = mi.spectrum_to_srgb(value, sample["wavelengths"], sample["active"])
        elif mi.is_monochromatic:
            value = mi.Color3f(value.x)
        value = dr.select(sample["active"], value, 0.0) * dr.opaque(mi.Float, 1.0 / each)
        return value, dr.detach(sample["pos"]) / mi.Point2f(size.tolist())


@contextmanager
def _taken() -> Iterator[list[dict[str, Any]]]:
    """The samples that Mitsuba would put on films meanwhile, by the names of their parts."""
    taken: list[dict[str, Any]] = []
    put = mi.ImageBlock.put
    mi.ImageBlock.put = lambda block, **sample: taken.append(sample)  # noqa: ARG005
    try:
        yield taken
    finally:
        mi.ImageBlock.put = put


@contextmanager
def tangents_on(film: Any) -> Iterator[None]:
    """Shading that Mitsuba puts on the film meanwhile is by how much it changes, and has no gradient any more."""
    weight = 4 if mi.has_flag(film.flags(), mi.FilmFlags.Alpha) else 3  # the channel that nothing changes
    put = mi.ImageBlock.put

    def put_tangents(block: Any, pos: Any, values: list[Any]) -> None:
        changes = dr.detach(dr.forward_to(values)) if dr.grad_enabled(values) else [dr.zeros(mi.Float)] * len(values)
        put(block, pos, [*changes[:weight], values[weight], *changes[weight + 1 :]])

    mi.ImageBlock.put = put_tangents
    try:
        yield
    finally:
        mi.ImageBlock.put = put
