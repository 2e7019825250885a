"""Mitsuba's support for each effect of light transport."""

from __future__ import annotations

from typing import Final

from loi_core.effects import Capability, Effect

__all__ = ["CAPABILITIES"]

CAPABILITIES: Final = (
    Capability(Effect.CONTINUOUS, "sppc", "one path a sample, with its adjoint"),
    Capability(Effect.PRIMARY, "sppp", "two paths a sample, on silhouettes in view; perspective cameras only"),
    Capability(Effect.INDIRECT, "sppi", "three paths a sample, one to the camera and two onwards; many miss"),
    Capability(Effect.BOUNCES, "max_depth", "each bounce is a ray, a shadow ray and their adjoint a sample"),
    Capability(Effect.SPECULAR, "max_depth", "two bounces for each pane of glass; not the motion of its edges"),
    Capability(Effect.MEDIA, "integrator", "prbvolpath: steps through the medium; no edges at all"),
    Capability(Effect.EMITTERS, "sppc", "a part of continuous shading"),
    Capability(Effect.CAMERA, "", "no gradient for sensors; move the scene instead", simulated=False),
    Capability(Effect.APPEARANCE, "sppc", "a part of continuous shading"),
)
"""For each effect: the setting that turns it off, and its cost."""
