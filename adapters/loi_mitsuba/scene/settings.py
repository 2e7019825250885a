"""The settings of Mitsuba that a plan decides, and the integrators that they make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import mitsuba as mi

from loi_core.effects import EffectPlan
from loi_core.errors import OptionError

__all__ = [
    "OWN",
    "PARTS",
    "PROJECTIVE",
    "Settings",
    "as_mapping",
    "bordered",
    "integrator_of",
    "leaves_edges_out",
    "settings_of",
]

OWN: Final = "scene"  # the scene's own integrator, which the rules do not know
PROJECTIVE: Final = ("direct_projective", "prb_projective")
PARTS: Final = ("sppc", "sppp", "sppi")  # samples of continuous shading, primary and indirect visibility


@dataclass(frozen=True)
class Settings:
    """What Mitsuba is told.

    Attributes
    ----------
    integrator : str
        Its plugin, or "scene" for the scene's own.
    max_depth : int
        Longest paths; 2 is direct light.
    sppc, sppp, sppi : int
        Samples per pixel of the gradient's three parts. 0 turns a part off; integrators that have no edges know the
        first only.
    guiding : str
        How samples of indirect edges are placed: "none", for all alike. Mitsuba's others are slow on a processor, and
        never sample where no seed has been.
    hide_emitters : bool
        As the scene's own integrator has it.
    sample_border : bool
        Whether the film has to sample beyond its border, for what crosses it.
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
        """Whether the gradient has parts that can be drawn one by one."""
        return self.integrator in PROJECTIVE

    def only(self, part: str, samples: int | None = None) -> Settings:
        """The same with one part of the gradient and no other."""
        kept = getattr(self, part) if samples is None else samples
        return self.sampled({name: kept if name == part else 0 for name in PARTS})

    def sampled(self, counts: Mapping[str, int]) -> Settings:
        """The same with other samples of some parts."""
        all_counts = {name: counts.get(name, getattr(self, name)) for name in PARTS}
        return replace(self, sppc=all_counts["sppc"], sppp=all_counts["sppp"], sppi=all_counts["sppi"])

    def load(self) -> Any:
        """The integrator, for every kind but the scene's own."""
        described: dict[str, Any] = {"type": self.integrator, "hide_emitters": self.hide_emitters}
        if self.integrator != "direct_projective":
            described["max_depth"] = self.max_depth
        if self.projective:
            described |= {name: getattr(self, name) for name in PARTS} | {"guiding": self.guiding}
        made = mi.load_dict(described)
        if self.projective:
            made.sample_border_warning = False  # each new integrator gives it once, and a plan says what is called for
        return made


def settings_of(plan: EffectPlan) -> Settings:
    """The settings that a plan of this adapter holds.

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


def integrator_of(settings: Settings, scene: Any) -> tuple[Any, int]:
    """The integrator of a plan's settings, and the samples to ask it for: 0 for its own counts."""
    if settings.integrator == OWN:
        return scene.integrator(), settings.sppc
    return settings.load(), 0 if settings.projective else settings.sppc


def leaves_edges_out(plan: EffectPlan) -> bool:
    """Whether a pilot has measured that the motion of outlines and shadows carries next to nothing."""
    return plan.measured and settings_of(plan).integrator == "prb"


def as_mapping(settings: Settings) -> dict[str, Any]:
    """For :attr:`loi_core.effects.EffectPlan.settings`."""
    return asdict(settings)


def bordered(scene: Any, integrator: Any) -> Any:
    """`scene`, its films sampling beyond their borders if it is a dict and `integrator` a plan that asks for it.

    A film cannot be changed once it is made.
    """
    if not isinstance(scene, dict) or not isinstance(integrator, EffectPlan):
        return scene
    if not settings_of(integrator).sample_border:
        return scene
    return {key: _with_border(value) for key, value in scene.items()}


def _with_border(entry: Any) -> Any:
    if not isinstance(entry, dict):
        return entry
    return {
        key: {"sample_border": True, **value} if isinstance(value, dict) and "film" in str(value.get("type")) else value
        for key, value in entry.items()
    }
