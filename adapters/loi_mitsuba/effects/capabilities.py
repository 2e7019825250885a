"""What Mitsuba can differentiate, what that costs, and which setting turns it off."""

from __future__ import annotations

from typing import Final

from loi_core.effects import Capability, Effect

__all__ = ["CAPABILITIES"]

CAPABILITIES: Final = (
    Capability(Effect.CONTINUOUS, "sppc", "one path a sample, with its adjoint"),
    Capability(Effect.PRIMARY, "sppp", "two paths a sample, on outlines that the camera sees; perspective only"),
    Capability(Effect.INDIRECT, "sppi", "a path to the camera and two onwards a sample, many of which miss"),
    Capability(Effect.BOUNCES, "max_depth", "each bounce is a ray, a shadow ray and their adjoint a sample"),
    Capability(Effect.SPECULAR, "max_depth", "two bounces for each pane of glass; not the motion of its edges"),
    Capability(Effect.MEDIA, "integrator", "prbvolpath: steps through the medium; no edges at all"),
    Capability(Effect.EMITTERS, "sppc", "a part of continuous shading"),
    Capability(Effect.CAMERA, "", "no gradient by sensors; move the scene instead", simulated=False),
    Capability(Effect.APPEARANCE, "sppc", "a part of continuous shading"),
)
"""How Mitsuba simulates each effect of light transport: the effect, the switch that does it, and what that takes."""
"""One for each effect."""
