"""Effects of light transport, and the plan of the effects that a renderer simulates."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from loi_core.errors import OptionError
from loi_core.support.markdown import markdown
from loi_core.support.wording import MAX_LISTED, listed, shown

__all__ = ["Capability", "Choice", "Effect", "EffectPlan"]

HEADS: Final = ["effect", "", "samples", "fraction", "why"]


class Effect(enum.StrEnum):
    """Effects that carry a change of parameters to the image. Values are for display."""

    CONTINUOUS = "continuous shading"
    PRIMARY = "primary visibility"
    INDIRECT = "indirect visibility"
    BOUNCES = "bounce depth"
    SPECULAR = "specular chains"
    MEDIA = "participating media"
    EMITTERS = "emitters and environment"
    CAMERA = "camera motion"
    APPEARANCE = "texture and material"


@dataclass(frozen=True)
class Capability:
    """Capability of a renderer for one effect, declared by its adapter.

    Attributes
    ----------
    effect : Effect
    switch : str
        Name of the setting that enables it; empty if there is none.
    cost : str
        Description of its cost.
    simulated : bool
        Whether the renderer has a gradient for it.
    """

    effect: Effect
    switch: str
    cost: str
    simulated: bool = True


@dataclass(frozen=True)
class Choice:
    """Decision of a plan about one effect.

    Attributes
    ----------
    effect : Effect
    on : bool
        Whether it is simulated.
    reason : str
        Reason on one line.
    samples : int, optional
        Samples per pixel of its term of the gradient, if it has a term.
    fraction : float, optional
        Largest ratio, over the parameters, of the norm of its term to the norm of the gradient of the loss; None if it
        was not measured or is not significant.
    variance_seconds : float, optional
        Relative variance of its term times the seconds per draw, which a pilot minimises. None if not measured.
    """

    effect: Effect
    on: bool
    reason: str
    samples: int | None = None
    fraction: float | None = None
    variance_seconds: float | None = None

    def __post_init__(self) -> None:
        if not self.reason or "\n" in self.reason:
            msg = f"`reason` of {self.effect} must be one line that is not empty, got {shown(self.reason)}"
            raise OptionError(msg)


@dataclass(frozen=True, repr=False)
class EffectPlan:
    """The effects that a scene requires, and the renderer settings that follow.

    Attributes
    ----------
    choices : tuple of Choice
        One per effect, in the order of :class:`Effect`.
    settings : mapping
        Settings of the renderer; the keys are defined by its adapter.
    why : mapping of str
        Reasons by setting, for settings that belong to no effect.
    substitutions : mapping of str
        Objects that the proxy scene replaces, each with the replacement and the reason in one line.
    attached : mapping of str
        Parameters whose gradient is of attached samples, each with the reason in one line.
    blurred : mapping of str
        Parameters whose gradient is of images blurred over them, each with the reason in one line.
    frozen : mapping of str
        Parameters that a fit does not move at present, each with the reason in one line.
    notes : tuple of str
        Further information for the user: missing gradients of the renderer, or the reason why everything is on.
    understood : bool
        Whether the rules cover everything in the scene; if not, everything is on.
    measured : bool
        Whether a pilot has measured fractions.

    Raises
    ------
    OptionError
        If an effect is missing or duplicate.
    """

    choices: tuple[Choice, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    why: Mapping[str, str] = field(default_factory=dict)
    substitutions: Mapping[str, str] = field(default_factory=dict)
    attached: Mapping[str, str] = field(default_factory=dict)
    blurred: Mapping[str, str] = field(default_factory=dict)
    frozen: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    understood: bool = True
    measured: bool = False

    def __post_init__(self) -> None:
        effects = [choice.effect for choice in self.choices]
        if effects != list(Effect):
            msg = f"`choices` must have each effect once, in order, got {', '.join(effects)}"
            raise OptionError(msg)

    def __getitem__(self, effect: Effect) -> Choice:
        """Return the choice about one effect."""
        return self.choices[list(Effect).index(effect)]

    @property
    def on(self) -> frozenset[Effect]:
        """The effects that are simulated."""
        return frozenset(choice.effect for choice in self.choices if choice.on)

    def __repr__(self) -> str:
        on = ", ".join(choice.effect for choice in self.choices if choice.on)
        return f"<EffectPlan: {on or 'nothing'} on, {len(self.frozen)} parameters frozen>"

    def __str__(self) -> str:
        """Return a Markdown table of effects, substitutions, and attached, blurred and frozen parameters."""
        return "\n".join([*markdown(HEADS, self._rows), "", *self._settings, *self._notes])

    @property
    def _rows(self) -> list[list[str]]:
        rows = [
            [
                choice.effect,
                "on" if choice.on else "off",
                "" if choice.samples is None else str(choice.samples),
                "" if choice.fraction is None else f"{choice.fraction:.2%}",
                choice.reason,
            ]
            for choice in self.choices
        ]
        rows += [[original, "replaced", "", "", reason] for original, reason in self.substitutions.items()]
        for state, reasons in (("attached", self.attached), ("blurred", self.blurred), ("frozen", self.frozen)):
            rows += [[names, state, "", "", reason] for names, reason in _group_by_reason(reasons)]
        return rows

    @property
    def _settings(self) -> list[str]:
        shown = ", ".join(f"{name} {value}" for name, value in self.settings.items() if value is not None)
        reasons = [f"- {name} {self.settings[name]}: {reason}" for name, reason in self.why.items()]
        return [f"Settings: {shown or 'none'}", *reasons]

    @property
    def _notes(self) -> list[str]:
        return [f"Note: {note}" for note in self.notes]

    def changes_from(self, previous: EffectPlan) -> str:
        """Return the changes since a previous plan on one line; empty if there are none."""
        changes = [
            f"{new.effect} {'on' if new.on else 'off'} ({new.reason})"
            for new, old in zip(self.choices, previous.choices, strict=True)
            if new.on != old.on
        ]
        for state, current, earlier in (
            ("frozen", self.frozen, previous.frozen),
            ("blurred", self.blurred, previous.blurred),
        ):
            fresh = {name: reason for name, reason in current.items() if name not in earlier}
            changes += [f"{names} {state} ({reason})" for names, reason in _group_by_reason(fresh)]
        for state, earlier, current in (
            ("no longer attached", previous.attached, self.attached),
            ("no longer blurred", previous.blurred, self.blurred),
            ("released", previous.frozen, {**self.frozen, **self.blurred}),
        ):
            dropped = {name: "" for name in earlier if name not in current}
            changes += [f"{names} {state}" for names, _ in _group_by_reason(dropped)]
        for name in dict.fromkeys([*previous.settings, *self.settings]):
            old_value, new_value = previous.settings.get(name), self.settings.get(name)
            if old_value != new_value:
                changes.append(f"{name} {old_value} -> {new_value}")
        return "; ".join(changes)


def _group_by_reason(reasons: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return pairs of names and reasons; many names with the same reason are listed in one pair."""
    names: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        names.setdefault(reason, []).append(name)
    lists = {reason: listed(group) for reason, group in names.items() if len(group) > MAX_LISTED + 1}
    return list(dict.fromkeys((lists.get(reason, repr(name)), reason) for name, reason in reasons.items()))
