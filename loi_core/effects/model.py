"""Effects of light transport, and the plan that says which of them are simulated, how, and why."""

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
    """What may make an image change with a scene's parameters. The values are what people read."""

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
    """What a renderer's adapter declares about one effect.

    Attributes
    ----------
    effect : Effect
        Which.
    switch : str
        The setting that turns it on and off; empty if there is none.
    cost : str
        What it costs, in words.
    simulated : bool
        Whether the renderer has its gradient at all.
    """

    effect: Effect
    switch: str
    cost: str
    simulated: bool = True


@dataclass(frozen=True)
class Choice:
    """What a plan says about one effect.

    Attributes
    ----------
    effect : Effect
        Which.
    on : bool
        Whether it is simulated.
    reason : str
        Why, in one line.
    samples : int, optional
        Samples per pixel of its part of the gradient, if it has a part of its own.
    fraction : float, optional
        Norm of its part over the norm of the gradient of the loss, where that is largest among the parameters; None
        if it was not measured, or cannot be distinguished from noise.
    variance_seconds : float, optional
        Relative variance of its part times the seconds that a draw takes: what a pilot makes small. None if not
        measured.
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
    """Which effects a scene calls for, and the renderer settings that follow.

    Attributes
    ----------
    choices : tuple of Choice
        One for each effect, in the order of :class:`Effect`.
    settings : mapping
        What the renderer is told; its adapter knows the keys.
    why : mapping of str
        Reasons of settings that are no effect's own, by their name.
    substitutions : mapping of str
        Objects that the proxy scene replaces, each with the replacement and the reason in one line.
    attached : mapping of str
        Parameters whose gradient is of attached samples, each with the reason in one line.
    blurred : mapping of str
        Parameters whose gradient is of images blurred over them, each with the reason in one line.
    frozen : mapping of str
        Parameters that a fit does not move at present, each with the reason in one line.
    notes : tuple of str
        What a person should know: gradients that the renderer does not have, or why everything is on.
    understood : bool
        Whether the rules know everything that they have met in the scene; if not, everything is on.
    measured : bool
        Whether a pilot has measured fractions.

    Raises
    ------
    OptionError
        If an effect is missing or comes twice.
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
        if [one.effect for one in self.choices] != list(Effect):
            msg = f"`choices` must have each effect once, in order, got {', '.join(one.effect for one in self.choices)}"
            raise OptionError(msg)

    def __getitem__(self, effect: Effect) -> Choice:
        """The choice about one effect."""
        return self.choices[list(Effect).index(effect)]

    @property
    def on(self) -> frozenset[Effect]:
        """The effects that are simulated."""
        return frozenset(one.effect for one in self.choices if one.on)

    def __repr__(self) -> str:
        on = ", ".join(one.effect for one in self.choices if one.on)
        return f"<EffectPlan: {on or 'nothing'} on, {len(self.frozen)} parameters frozen>"

    def __str__(self) -> str:
        """Return a Markdown table of effects, substitutions, and attached, blurred and frozen parameters."""
        return "\n".join([*markdown(HEADS, self._rows), "", *self._settings, *self._notes])

    @property
    def _rows(self) -> list[list[str]]:
        rows = [
            [
                one.effect,
                "on" if one.on else "off",
                "" if one.samples is None else str(one.samples),
                "" if one.fraction is None else f"{one.fraction:.2%}",
                one.reason,
            ]
            for one in self.choices
        ]
        rows += [[original, "replaced", "", "", reason] for original, reason in self.substitutions.items()]
        for state, reasons in (("attached", self.attached), ("blurred", self.blurred), ("frozen", self.frozen)):
            rows += [[names, state, "", "", reason] for names, reason in _together(reasons)]
        return rows

    @property
    def _settings(self) -> list[str]:
        shown = ", ".join(f"{name} {value}" for name, value in self.settings.items() if value is not None)
        reasons = [f"- {name} {self.settings[name]}: {reason}" for name, reason in self.why.items()]
        return [f"Settings: {shown or 'none'}", *reasons]

    @property
    def _notes(self) -> list[str]:
        return [f"Note: {note}" for note in self.notes]

    def changes_from(self, other: EffectPlan) -> str:
        """What is different from another plan, in one line; empty if nothing is."""
        changes = [
            f"{new.effect} {'on' if new.on else 'off'} ({new.reason})"
            for new, old in zip(self.choices, other.choices, strict=True)
            if new.on != old.on
        ]
        for state, now, before in (("frozen", self.frozen, other.frozen), ("blurred", self.blurred, other.blurred)):
            fresh = {name: reason for name, reason in now.items() if name not in before}
            changes += [f"{names} {state} ({reason})" for names, reason in _together(fresh)]
        for state, before, now in (
            ("no longer attached", other.attached, self.attached),
            ("no longer blurred", other.blurred, self.blurred),
            ("released", other.frozen, {**self.frozen, **self.blurred}),
        ):
            changes += [f"{names} {state}" for names, _ in _together({name: "" for name in before if name not in now})]
        for name in dict.fromkeys([*other.settings, *self.settings]):
            old_value, new_value = other.settings.get(name), self.settings.get(name)
            if old_value != new_value:
                changes.append(f"{name} {old_value} -> {new_value}")
        return "; ".join(changes)


def _together(reasons: Mapping[str, str]) -> list[tuple[str, str]]:
    """Names, each with its reason; those of one reason together, in short, if they are many."""
    names: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        names.setdefault(reason, []).append(name)
    many = {reason: listed(group) for reason, group in names.items() if len(group) > MAX_LISTED + 1}
    return list(dict.fromkeys((many.get(reason, repr(name)), reason) for name, reason in reasons.items()))
