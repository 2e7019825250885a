"""Warnings about gradients that Mitsuba gets wrong without an error."""

from __future__ import annotations

import warnings
from collections.abc import Container, Mapping
from typing import Any, Final

from loi_mitsuba.scene.parameters import SceneIndex
from mitsuba_boundaries.diagnostics import diagnoses_of_moving_shapes, is_delta_input

__all__ = ["GradientWarning", "unsupported_parameter", "warn_about_entries", "warn_about_moving_shapes"]

HINTS: Final = {
    "": "",
    "differentiable_scene": ", or PlannedRenderer, which replaces it in a proxy scene where it can",
    "images": ", or use PlannedRenderer, which blurs",
}


class GradientWarning(UserWarning):
    """Part of the requested gradient is missing or wrong."""


def warn_about_moving_shapes(
    scene: Any, sensor: Any, integrator: Any, shapes: list[Any], edged: Container[Any]
) -> None:
    """Warn about moving shapes; see :func:`mitsuba_boundaries.diagnostics.diagnoses_of_moving_shapes`."""
    for cause, remedy, source in diagnoses_of_moving_shapes(scene, sensor, integrator, shapes, edged):
        warnings.warn(f"{cause}; {remedy}{HINTS[source]}", GradientWarning, stacklevel=4)


def warn_about_entries(index: SceneIndex, targets: Mapping[str, Any]) -> None:
    """Warn about targets that are material entries without a correct gradient in Mitsuba."""
    for name, target in targets.items():
        reason = unsupported_parameter(index, target) if isinstance(target, str) else ""
        if reason:
            warnings.warn(f"{name!r}: {reason}; use PlannedRenderer, which blurs", GradientWarning, stacklevel=4)


def unsupported_parameter(index: SceneIndex, target: str) -> str:
    """Return why Mitsuba's gradient for an entry of a material is missing or wrong; an empty string if it is right."""
    entry = index.get(target)
    material, attribute = (None, "") if entry is None else index.material_input(entry)
    if material is None or not is_delta_input(material, attribute):
        return ""
    return f"it is the {attribute} of a material with a delta lobe, for which Mitsuba has no gradient"
