"""Samples of integrators of Mitsuba, before they reach the film.

Mitsuba differentiates through its film. To find the gradient it makes an image first, that nobody looks at; and to find
how the image changes it traces all rays again for each pixel that a sample reaches, of 25 with a Gaussian filter.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import drjit as dr
import mitsuba as mi

from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.sensing.film import Film

__all__ = ["backpropagate", "capture_splats", "radiance_samples", "to_rgb"]

NOTHING: Final = {"δL": None, "state_in": None, "project": False, "si_shade": None}  # what integrators ask for besides


def radiance_samples(integrator: Any, scene: Any, sensor: Any, samples: int, seed: int, mode: Any) -> tuple[Any, Any]:
    """Red, green and blue of the samples of an image, with their gradient, and places of the film, 0 to 1 both ways.

    They are those of Mitsuba's `render_backward`, for integrators that differentiate what they sample.
    """
    film = sensor.film()
    with dr.suspend_grad():
        sampler, _ = integrator.prepare(sensor, seed, samples, integrator.aov_names())
        ray, weight, pos = integrator.sample_rays(scene, sensor, sampler)
        value, *_ = integrator.sample(
            mode=mode,
            scene=scene,
            sampler=sampler,
            ray=ray,
            depth=mi.UInt32(0),
            active=dr.ones(mi.Bool),
            **NOTHING,
        )
        corner = film.rfilter().is_box_filter()  # of its pixel: all that Mitsuba tells of a place then
        offset, size = (mi.Point2f(*map(float, one)) for one in (film.crop_offset(), film.crop_size()))
        place = (mi.Point2f(pos) + (0.5 if corner else 0.0) - offset) / size
    return to_rgb(value * weight, ray.wavelengths), place


def to_rgb(value: Any, wavelengths: Any = None, *, active: Any = True) -> Any:
    """Red, green and blue of a spectrum of Mitsuba's variant, which has wavelengths if it is a spectral one."""
    if mi.is_spectral:
        return mi.spectrum_to_srgb(value, wavelengths, active)
    return mi.Color3f(value.x) if mi.is_monochromatic else value


def backpropagate(value: Any, place: Any, film: Film, cotangent: Float32Array) -> None:
    """Carry a cotangent of the image, shape (H, W, C), back to its samples, and on to what they depend on."""
    if dr.grad_enabled(value):
        weight = film.gather(film.shared(cotangent, place), place)
        dr.backward(value * weight, dr.ADFlag.ClearInterior)


@contextmanager
def capture_splats() -> Iterator[list[dict[str, Any]]]:
    """What Mitsuba would put on films meanwhile, which stay empty: arguments of `mi.ImageBlock.put`, by their names."""
    taken: list[dict[str, Any]] = []
    put = mi.ImageBlock.put
    mi.ImageBlock.put = lambda block, **sample: taken.append(sample)  # noqa: ARG005 - no block gets it
    try:
        yield taken
    finally:
        mi.ImageBlock.put = put
