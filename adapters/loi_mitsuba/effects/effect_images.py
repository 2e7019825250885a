"""How each effect changes the image, so that one sees what a plan has dropped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from loi_core.effects import EffectPlan
from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.effects.rules import EFFECTS
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.settings import PROJECTIVE, as_mapping, settings_of

__all__ = ["effect_images"]

DRAWN_FORWARD: Final = (*PROJECTIVE, "prb")


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
    """Images of the effects of a plan by rules; see :meth:`loi_mitsuba.PlannedRenderer.effect_images`."""
    full = settings_of(rules)
    if not rules.understood or full.integrator not in DRAWN_FORWARD:
        return {}
    pulled = renderer.with_integrator(rules, wrt=names).vjp(params, cotangent, seed=seed)
    tangent = {}
    for name in names:
        size = float(np.linalg.norm(pulled[name]))
        tangent[name] = -pulled[name] / np.float32(size if size > 0.0 else 1.0)
    if not any(np.any(one) for one in tangent.values()):
        return {}
    images = {}
    for part, effect in EFFECTS.items():
        if getattr(full, part) > 0:
            only = replace(rules, settings=as_mapping(full.only(part, samples)))
            images[str(effect)] = renderer.with_integrator(only, wrt=names).jvp(params, tangent, seed=seed)
    return images
