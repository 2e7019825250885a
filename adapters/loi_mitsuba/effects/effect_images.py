"""Images of the change that each effect contributes along a step of descent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from loi_core.effects import EffectPlan
from loi_mitsuba.effects.rules import EFFECTS
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.settings import PROJECTIVE, settings_of
from mitsuba_boundaries.drjit.arrays import Float32Array

__all__ = ["effect_images"]

FORWARD_INTEGRATORS: Final = (*PROJECTIVE, "prb")  # with a derivative of images in Mitsuba


def effect_images(
    renderer: MitsubaRenderer,
    rules: EffectPlan,
    names: Sequence[str],
    samples: int,
    params: Mapping[str, Any],
    cotangent: Any,
    *,
    seed: int,
) -> dict[str, Float32Array]:
    """Return an image for each effect of a plan by the rules; see :meth:`loi_mitsuba.PlannedRenderer.effect_images`."""
    settings = settings_of(rules)
    if not rules.understood or settings.integrator not in FORWARD_INTEGRATORS:
        return {}
    gradient = renderer.with_integrator(rules, wrt=names).vjp(params, cotangent, seed=seed)
    tangent = {}
    for name in names:
        norm = float(np.linalg.norm(gradient[name]))
        tangent[name] = -gradient[name] / np.float32(norm if norm > 0.0 else 1.0)
    if not any(np.any(direction) for direction in tangent.values()):
        return {}
    images = {}
    for term, effect in EFFECTS.items():
        if getattr(settings, term) > 0:
            only = replace(rules, settings=settings.only(term, samples).to_mapping())
            images[str(effect)] = renderer.with_integrator(only, wrt=names).jvp(params, tangent, seed=seed)
    return images
