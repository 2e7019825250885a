"""The settings of Mitsuba that a plan decides, and the integrators that they configure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import mitsuba as mi

from loi_core.effects import EffectPlan
from loi_core.errors import OptionError
from mitsuba_boundaries.loading import with_sampled_borders

__all__ = [
    "GRADIENT_TERMS",
    "PROJECTIVE",
    "SCENE_INTEGRATOR",
    "Settings",
    "omits_edges",
    "settings_of",
    "with_sampled_border",
]

SCENE_INTEGRATOR: Final = "scene"  # the scene's own integrator, of a type that the rules do not know
PROJECTIVE: Final = ("direct_projective", "prb_projective")
GRADIENT_TERMS: Final = ("sppc", "sppp", "sppi")  # samples of the interior, primary and indirect boundary terms


@dataclass(frozen=True)
class Settings:
    """Settings of an integrator.

    Attributes
    ----------
    integrator : str
        Name of its plugin, or "scene" for the scene's own.
    max_depth : int
        Length of the longest paths; 2 is direct light.
    sppc, sppp, sppi : int
        Samples per pixel of the gradient's three terms. 0 turns a term off; integrators without boundary terms use
        `sppc` only.
    guiding : str
        Guiding of indirect boundary samples, "none" for uniform. Mitsuba's guiding is slow on a CPU, and never samples
        where no seed was.
    hide_emitters : bool
        As in the scene's own integrator.
    sample_border : bool
        Whether the film samples beyond its border, for shapes that cross it.
    """

    integrator: str
    max_depth: int
    sppc: int
    sppp: int = 0
    sppi: int = 0
    guiding: str = "none"
    hide_emitters: bool = False
    sample_border: bool = False

    @property
    def projective(self) -> bool:
        """Whether the terms of the gradient can be sampled separately."""
        return self.integrator in PROJECTIVE

    def only(self, term: str, samples: int | None = None) -> Settings:
        """Return the settings with a single term, with its samples or another number."""
        count = getattr(self, term) if samples is None else samples
        return self.sampled({name: count if name == term else 0 for name in GRADIENT_TERMS})

    def sampled(self, counts: Mapping[str, int]) -> Settings:
        """Return the settings with other sample counts for some terms."""
        return replace(self, **counts)  # type: ignore[arg-type]  # counts of terms only

    def to_mapping(self) -> dict[str, Any]:
        """Return the value of :attr:`loi_core.effects.EffectPlan.settings`."""
        return asdict(self)

    def load(self) -> Any:
        """Load the integrator; not for "scene"."""
        description: dict[str, Any] = {"type": self.integrator, "hide_emitters": self.hide_emitters}
        if self.integrator != "direct_projective":
            description["max_depth"] = self.max_depth
        if self.projective:
            description |= {name: getattr(self, name) for name in GRADIENT_TERMS} | {"guiding": self.guiding}
        integrator = mi.load_dict(description)
        if self.projective:
            integrator.sample_border_warning = False  # each new integrator warns once; the plan reports the border
        return integrator


def settings_of(plan: EffectPlan) -> Settings:
    """Return the settings in a plan of this adapter.

    Raises
    ------
    OptionError
        If it is a plan for another renderer.
    """
    try:
        return Settings(**plan.settings)
    except TypeError:
        msg = f"the plan is not one for Mitsuba; its settings are {', '.join(plan.settings) or 'none'}"
        raise OptionError(msg) from None


def omits_edges(plan: EffectPlan) -> bool:
    """Return whether a pilot has measured that outlines and shadows carry a negligible part of the gradient."""
    return plan.measured and settings_of(plan).integrator == "prb"


def with_sampled_border(scene: Any, integrator: Any) -> Any:
    """Return a dict `scene` whose films sample their borders if the plan `integrator` needs it, or `scene` itself."""
    needed = isinstance(scene, dict) and isinstance(integrator, EffectPlan) and settings_of(integrator).sample_border
    return with_sampled_borders(scene) if needed else scene
