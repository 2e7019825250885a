"""Sound rules: the effects that the traits of a scene allow to turn off without measuring any."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from loi_core.effects import Choice, Effect, EffectPlan
from loi_core.support.wording import clause
from loi_mitsuba.effects.traits import VOLUME_INTEGRATORS, Traits, is_known
from loi_mitsuba.scene.settings import GRADIENT_TERMS, SCENE_INTEGRATOR, Settings, settings_of

__all__ = ["DIRECT_DEPTH", "EFFECTS", "everything", "integrator_for", "plan_by_rules", "plan_of", "plan_with"]

EFFECTS: Final = {"sppc": Effect.CONTINUOUS, "sppp": Effect.PRIMARY, "sppi": Effect.INDIRECT}
DIRECT_DEPTH: Final = 2  # of paths from the camera over one surface to a light
NO_MOTION: Final = "no optimised parameter moves a shape"
EXCEPTION: Final = ", apart from attached or blurred parameters"
CAMERA_REASON: Final = "Mitsuba has no gradient for sensors"


def everything(traits: Traits, samples: int) -> Settings:
    """Return settings with all effects on that Mitsuba can differentiate, without guiding: the reference of a plan."""
    border = bool(traits.moving) and traits.reaches_border
    if not is_known(traits.integrator):
        return Settings(SCENE_INTEGRATOR, traits.depth, samples, sample_border=border)
    if traits.has_medium or traits.integrator in VOLUME_INTEGRATORS:
        return Settings("prbvolpath", traits.depth, samples, hide_emitters=traits.hide_emitters, sample_border=border)
    return Settings(
        "prb_projective",
        traits.depth,
        samples,
        samples,
        samples,
        hide_emitters=traits.hide_emitters,
        sample_border=border,
    )


def plan_by_rules(traits: Traits, samples: int) -> EffectPlan:
    """Return the plan before any rendering: :func:`everything` without the effects that certainly have no gradient."""
    full = everything(traits, samples)
    if traits.unknown:
        reason = "not known to the rules: " + ", ".join(traits.unknown)
        plan = plan_of(traits, full)
        note = f"everything is on, because the rules do not know {', '.join(traits.unknown)}"
        choices = [
            choice if choice.effect is Effect.CAMERA else _choice(choice.effect, True, reason, full)  # noqa: FBT003
            for choice in plan.choices
        ]
        return replace(plan, choices=tuple(choices), notes=(note, *plan.notes), understood=False)
    depth = min(traits.depth, DIRECT_DEPTH) if traits.is_single_convex_shape else traits.depth
    edges = bool(traits.moving) and full.projective
    indirect = edges and not (traits.is_single_convex_shape and depth <= DIRECT_DEPTH)
    settings = Settings(
        integrator_for(traits, full.integrator, depth, edges=edges),
        depth,
        samples,
        samples if edges else 0,
        samples if indirect else 0,
        hide_emitters=full.hide_emitters,
        sample_border=full.sample_border,
    )
    return plan_of(traits, settings)


def integrator_for(traits: Traits, full: str, depth: int, *, edges: bool) -> str:
    """Return the fastest integrator for the effects that are on; `full` is the integrator with all of them."""
    if full != "prb_projective":
        return full
    if not edges:
        return "prb"
    # direct_projective differentiates emitter samples only, which mirrors do not reflect.
    return "direct_projective" if depth == DIRECT_DEPTH and not traits.unlit_mirrors else full


def plan_of(
    traits: Traits, settings: Settings, reasons: dict[Effect, str] | None = None, *, notes: tuple[str, ...] = ()
) -> EffectPlan:
    """Return the plan with these settings; `reasons` replace the reasons of the rules."""
    all_reasons = _effect_reasons(traits, settings) | (reasons or {})
    on = {
        Effect.CONTINUOUS: settings.sppc > 0,
        Effect.PRIMARY: settings.sppp > 0,
        Effect.INDIRECT: settings.sppi > 0,
        Effect.BOUNCES: settings.max_depth > DIRECT_DEPTH,
        Effect.SPECULAR: _has_specular_surfaces(traits) and settings.max_depth > DIRECT_DEPTH,
        Effect.MEDIA: settings.integrator == "prbvolpath",
        Effect.EMITTERS: bool(traits.emission) and settings.sppc > 0,
        Effect.CAMERA: False,
        Effect.APPEARANCE: bool(traits.appearance) and settings.sppc > 0,
    }
    choices = tuple(_choice(effect, on[effect], all_reasons[effect], settings) for effect in Effect)
    return EffectPlan(
        choices,
        settings.to_mapping(),
        _setting_reasons(traits, settings),
        substitutions=traits.substitutions,
        attached=traits.attached,
        blurred=traits.blurred,
        notes=(*_notes(traits), *notes),
    )


def plan_with(traits: Traits, plan: EffectPlan, rules: Settings, grown: Mapping[Effect, str]) -> EffectPlan:
    """Return a measured plan with the effects in `grown` on as in the settings of the rules, each with its reason."""
    settings = settings_of(plan)
    for term, effect in EFFECTS.items():
        if effect in grown:
            settings = settings.sampled({term: getattr(rules, term)})
    depth = rules.max_depth if Effect.BOUNCES in grown else settings.max_depth
    edges = settings.sppp > 0 or settings.sppi > 0
    integrator = integrator_for(traits, everything(traits, rules.sppc).integrator, depth, edges=edges)
    reasons = {choice.effect: choice.reason for choice in plan.choices} | dict(grown)
    extended = plan_of(traits, replace(settings, max_depth=depth, integrator=integrator), reasons)
    choices = [
        replace(new, fraction=old.fraction, variance_seconds=old.variance_seconds) if new.on == old.on else new
        for new, old in zip(extended.choices, plan.choices, strict=True)
    ]
    return replace(extended, choices=tuple(choices), measured=True)


def _choice(effect: Effect, on: bool, reason: str, settings: Settings) -> Choice:  # noqa: FBT001
    samples = {EFFECTS[term]: getattr(settings, term) for term in GRADIENT_TERMS}.get(effect)
    return Choice(effect, on, reason, samples if on and samples else None)


def _effect_reasons(traits: Traits, settings: Settings) -> dict[Effect, str]:
    """Return the reason for each effect, in one line."""
    exception = EXCEPTION if traits.attached or traits.blurred else ""
    shading = [*traits.moving, *traits.appearance, *traits.emission, *traits.volumes]
    primary, indirect = _edge_reasons(traits, settings, exception)
    return {
        Effect.CONTINUOUS: clause(shading, "changes shading", "change shading")
        if shading
        else f"nothing is optimised{exception}",
        Effect.PRIMARY: primary,
        Effect.INDIRECT: indirect,
        Effect.BOUNCES: _depth_reason(traits, settings),
        Effect.SPECULAR: _surfaces(traits),
        Effect.MEDIA: "the scene has a participating medium" if traits.has_medium else "the scene has no medium",
        Effect.EMITTERS: clause(traits.emission, "changes emitters", "change emitters")
        if traits.emission
        else f"no emitter is optimised{exception}",
        Effect.CAMERA: CAMERA_REASON,
        Effect.APPEARANCE: clause(traits.appearance, "changes materials", "change materials")
        if traits.appearance
        else f"no material is optimised{exception}",
    }


def _edge_reasons(traits: Traits, settings: Settings, exception: str) -> tuple[str, str]:
    """Return the reasons for primary and for indirect visibility."""
    if not traits.moving:
        return NO_MOTION + exception, NO_MOTION + exception
    moves = clause(traits.moving, "moves a shape", "move shapes")
    if not settings.projective:
        reason = f"{moves}, but {settings.integrator} has no gradient of edges"
        return reason, reason
    outline, pronoun = ("its outline", "its") if len(traits.moving) == 1 else ("their outlines", "their")
    indirect = f"{moves}, with {pronoun} shadows, and edges seen in other surfaces"
    if traits.is_single_convex_shape:
        indirect = "the scene is one convex shape, which neither shadows nor reflects itself"
    return f"{moves}, with {outline} in view", indirect


def _depth_reason(traits: Traits, settings: Settings) -> str:
    limit = f"the scene sets no limit, and {traits.depth} is used"
    if traits.is_depth_limited:
        limit = f"the scene's own limit is {traits.depth}"
    if settings.max_depth > DIRECT_DEPTH:
        return f"light may reach the camera over {settings.max_depth - 1} surfaces; {limit}"
    return "the scene is one convex shape, which does not light itself" if traits.is_single_convex_shape else limit


def _setting_reasons(traits: Traits, settings: Settings) -> dict[str, str]:
    """Return the reasons for settings that are not the settings of one effect."""
    integrators = {
        SCENE_INTEGRATOR: "the scene's own, which the rules do not know",
        "prbvolpath": "the only one with media",
        "prb": "there are no edges to sample",
        "direct_projective": "edges, and no light over more than one surface",
        "prb_projective": "edges, and light over several surfaces",
    }
    reasons = {"integrator": integrators[settings.integrator]}
    if settings.sppi > 0:
        reasons["guiding"] = "guided samples never fall where no seed was, and are slow on a CPU"
    if traits.moving:
        reasons["sample_border"] = (
            "a shape may cross the border, and the film's filter reaches over it"
            if settings.sample_border
            else "the film's filter ends at the border"
        )
    return reasons


def _has_specular_surfaces(traits: Traits) -> bool:
    return traits.delta_reflection or traits.delta_transmission or traits.glossy


def _surfaces(traits: Traits) -> str:
    surfaces = {
        "mirrors": traits.delta_reflection,
        "clear glass": traits.delta_transmission,
        "glossy surfaces": traits.glossy,
    }
    present = [name for name, exists in surfaces.items() if exists]
    return f"the scene has {' and '.join(present)}" if present else "every surface is diffuse"


def _notes(traits: Traits) -> tuple[str, ...]:
    """Return notes about gradients that Mitsuba lacks in this scene and no GradientWarning mentions."""
    notes = []
    if traits.moving and (traits.delta_reflection or traits.delta_transmission) and traits.has_delta_bsdf:
        notes.append(
            "edges seen in a perfect mirror or through clear glass have no gradient in Mitsuba; make the surface a "
            "rough conductor or dielectric, or name the parameters in `blur`"
        )
    if traits.moving and traits.has_medium:
        notes.append("moving outlines and shadows have no gradient in Mitsuba where there is a medium")
    if traits.moving and traits.reaches_border and not traits.samples_border:
        notes.append("shapes that cross the border of the image need a film with sample_border=True")
    return tuple(notes)
