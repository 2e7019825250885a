"""What carries parts of the gradient of a scene between its image and its entries: Mitsuba, and jumps drawn here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.crossings import Crossings
from loi_mitsuba.edges import Edges
from loi_mitsuba.film import Film
from loi_mitsuba.handles import Host
from loi_mitsuba.integrators import PARTS
from loi_mitsuba.named import as_host

__all__ = ["ByJumps", "ByMitsuba", "parts_of"]


def parts_of(integrator: Any) -> dict[str, int | None]:
    """Samples per pixel of each part that an integrator has; None where it has not been told."""
    return {part: getattr(integrator, part) for part in PARTS if hasattr(integrator, part)}


@dataclass(frozen=True)
class ByMitsuba:
    """What an integrator of Mitsuba has of the gradient.

    Attributes
    ----------
    scene, sensor, integrator : mi.Scene, mi.Sensor, mi.Integrator
    entries : mi.SceneParameters
        What the scene can be set by, some of it with a gradient.
    samples : int
        Per pixel of each part that is not off; 0 leaves it to `counts`.
    counts : dict
        By part; see :func:`parts_of`.
    """

    scene: Any
    entries: Any
    sensor: Any
    integrator: Any
    samples: int
    counts: Mapping[str, int | None]

    def but(self, **counts: int) -> ByMitsuba:
        """The same with other samples of some parts."""
        return replace(self, counts={**self.counts, **counts})

    def pull(self, cotangent: Host, seed: int) -> None:
        """Carry a cotangent of the image, shape (H, W, C), back to the entries."""
        with self._told():
            image = mi.TensorXf(cotangent)
            try:
                self.integrator.render_backward(self.scene, self.entries, image, self.sensor, seed, self.samples)
            except RuntimeError as error:
                if "does not depend on the input" not in str(error):
                    raise  # an image in which none of the entries is to be found, as one of depths, has the gradient 0

    def push(self, seed: int, seed_grad: int) -> Host:
        """How the image changes with the entries: shape (H, W, C)."""
        with self._told():
            image = mi.render(
                self.scene,
                self.entries,
                self.sensor,
                self.integrator,
                seed=seed,
                seed_grad=seed_grad,
                spp_grad=self.samples,
            )
            return as_host(dr.forward_to(image), image.shape)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """The integrator knows the counts meanwhile."""
        before = parts_of(self.integrator)
        for part, count in self.counts.items():
            setattr(self.integrator, part, count)
        try:
            yield
        finally:
            for part, count in before.items():
                setattr(self.integrator, part, count)


@dataclass(frozen=True)
class ByJumps:
    """What jumps of brightness in view have of it: at edges of meshes with sides, or where shapes cross.

    Attributes
    ----------
    drawn : Edges or Crossings
    scene : mi.Scene
    film : Film
        Of the camera.
    radiance : mi.Integrator
        Says how bright it is where a ray goes.
    samples : int
        Per pixel of the image.
    """

    drawn: Edges | Crossings
    scene: Any
    film: Film
    radiance: Any
    samples: int

    def pull(self, cotangent: Host, seed: int) -> None:
        """Carry a cotangent of the image, shape (H, W, C), back to the shapes."""
        found = self.drawn.jumps(self.scene, self.radiance, self.samples, seed)
        if found is not None:
            value, place = found
            weight = self.film.looked_up(cotangent, place)
            dr.backward(dr.sum(value * weight, axis=None), dr.ADFlag.ClearInterior)

    def push(self, seed: int, seed_grad: int) -> Host:  # noqa: ARG002  # there is no image to draw
        """How the image changes with the shapes, which have a gradient: shape (H, W, C)."""
        found = self.drawn.jumps(self.scene, self.radiance, self.samples, seed_grad)
        if found is None:
            width, height = self.film.size
            return np.zeros((height, width, self.film.channels), dtype=np.float32)
        value, place = found
        change = mi.Color3f(dr.forward_to(value, flags=dr.ADFlag.ClearInterior))
        with dr.suspend_grad():
            return self.film.splat(change, place)
