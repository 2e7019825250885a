"""Radiance samples of Mitsuba's integrators before they reach the film.

Mitsuba differentiates through its film: the backward pass renders a primal image that is then discarded, and the
forward pass traces all rays again for each pixel in the filter's footprint, 25 for a Gaussian.
"""

from __future__ import annotations

from typing import Any, Final

import drjit as dr
import mitsuba as mi

from mitsuba_boundaries.drjit.arrays import Float32Array
from mitsuba_boundaries.sensing.film import Film

__all__ = ["backpropagate", "radiance_samples", "to_rgb"]

UNUSED_ARGUMENTS: Final = {"δL": None, "state_in": None, "project": False, "si_shade": None}  # of `Integrator.sample`


def radiance_samples(integrator: Any, scene: Any, sensor: Any, samples: int, seed: int, mode: Any) -> tuple[Any, Any]:
    """Return the radiance samples of an image, with their gradient, and their film positions.

    Mitsuba's `render_backward` takes the same samples, for integrators whose `sample` is differentiated automatically.

    Parameters
    ----------
    integrator : mi.ad.common.ADIntegrator
    scene : mi.Scene
    sensor : mi.Sensor
    samples : int
        Per pixel.
    seed : int
    mode : dr.ADMode

    Returns
    -------
    value : mi.Color3f
    uv : mi.Point2f
        Fractions of the image, 0 to 1.
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
            **UNUSED_ARGUMENTS,
        )
        is_corner = film.rfilter().is_box_filter()  # Mitsuba then returns the corner of the pixel
        offset, size = (mi.Point2f(*map(float, pair)) for pair in (film.crop_offset(), film.crop_size()))
        uv = (mi.Point2f(pos) + (0.5 if is_corner else 0.0) - offset) / size
    return to_rgb(value * weight, ray.wavelengths), uv


def to_rgb(value: Any, wavelengths: Any = None, *, active: Any = True) -> Any:
    """Convert a spectrum of Mitsuba's variant to linear RGB, mi.Color3f; spectral variants need `wavelengths`."""
    if mi.is_spectral:
        return mi.spectrum_to_srgb(value, wavelengths, active)
    return mi.Color3f(value.x) if mi.is_monochromatic else value


def backpropagate(value: Any, uv: Any, film: Film, cotangent: Float32Array) -> None:
    """Propagate a cotangent of the image, shape (H, W, C), to its samples, and through them to the scene."""
    if dr.grad_enabled(value):
        weight = film.gather(film.normalised_cotangent(cotangent, uv), uv)
        dr.backward(value * weight, dr.ADFlag.ClearInterior)
