"""Sound rules: what a scene's traits alone decide about its effects. They never turn off what might matter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from loi_core.effects import Choice, Effect, EffectPlan
from loi_core.support.wording import clause
from loi_mitsuba.effects.traits import VOLUME_INTEGRATORS, Traits, is_known
from loi_mitsuba.scene.settings import OWN, PARTS, Settings, as_mapping, settings_of

__all__ = ["DIRECT", "EFFECTS", "everything", "integrator_for", "plan_by_rules", "plan_of", "plan_with"]

EFFECTS: Final = {"sppc": Effect.CONTINUOUS, "sppp": Effect.PRIMARY, "sppi": Effect.INDIRECT}
DIRECT: Final = 2  # paths from the camera over one surface to a light
STILL: Final = "nothing that is optimised moves a shape"
APART: Final = ", but what is followed or blurred"


def everything(traits: Traits, samples: int) -> Settings:
    """Every effect that Mitsuba has the gradient of, without guiding: what a plan is compared with."""
    border = bool(traits.moving) and traits.reaches_border
    if not is_known(traits.own_integrator):
        return Settings(OWN, traits.depth, samples, sample_border=border)
    if traits.media or traits.own_integrator in VOLUME_INTEGRATORS:
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
    """The plan before anything is rendered: settings of :func:`everything` less what surely has no gradient."""
    full = everything(traits, samples)
    if traits.unknown:
        why = "not known to the rules: " + ", ".join(traits.unknown)
        notes = (f"everything is on, for the rules do not know {', '.join(traits.unknown)}", *_missing(traits))
        choices = [_choice(effect, effect is not Effect.CAMERA, why, full) for effect in Effect]
        choices[list(Effect).index(Effect.CAMERA)] = _camera()
        return EffectPlan(
            tuple(choices),
            as_mapping(full),
            _why(traits, full),
            exchanged=traits.exchanged,
            followed=traits.followed,
            blurred=traits.blurred,
            notes=notes,
            understood=False,
        )
    depth = min(traits.depth, DIRECT) if traits.alone else traits.depth
    edges = bool(traits.moving) and full.projective
    indirect = edges and not (traits.alone and depth <= DIRECT)
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
    """The integrator that is fastest for what is left of `full`, the one that has everything."""
    if full != "prb_projective":
        return full
    if not edges:
        return "prb"
    # That for direct light has only the gradient of what lamps are sampled for, of which mirrors have nothing.
    return "direct_projective" if depth == DIRECT and not traits.unlit_mirrors else full


def plan_of(
    traits: Traits, settings: Settings, reasons: dict[Effect, str] | None = None, *, notes: tuple[str, ...] = ()
) -> EffectPlan:
    """A plan of these settings, each effect with the rules' reason unless `reasons` has another."""
    told = _reasons(traits, settings) | (reasons or {})
    on = {
        Effect.CONTINUOUS: settings.sppc > 0,
        Effect.PRIMARY: settings.sppp > 0,
        Effect.INDIRECT: settings.sppi > 0,
        Effect.BOUNCES: settings.max_depth > DIRECT,
        Effect.SPECULAR: _specular(traits) and settings.max_depth > DIRECT,
        Effect.MEDIA: settings.integrator == "prbvolpath",
        Effect.EMITTERS: bool(traits.emission) and settings.sppc > 0,
        Effect.CAMERA: False,
        Effect.APPEARANCE: bool(traits.appearance) and settings.sppc > 0,
    }
    choices = tuple(_choice(effect, on[effect], told[effect], settings) for effect in Effect)
    return EffectPlan(
        choices,
        as_mapping(settings),
        _why(traits, settings),
        exchanged=traits.exchanged,
        followed=traits.followed,
        blurred=traits.blurred,
        notes=(*_missing(traits), *notes),
    )


def plan_with(traits: Traits, plan: EffectPlan, rules: Settings, grown: Mapping[Effect, str]) -> EffectPlan:
    """A measured plan with more effects on, each with its reason, as the settings of the rules have them."""
    settings = settings_of(plan)
    for part, effect in EFFECTS.items():
        if effect in grown:
            settings = settings.sampled({part: getattr(rules, part)})
    depth = rules.max_depth if Effect.BOUNCES in grown else settings.max_depth
    edges = settings.sppp > 0 or settings.sppi > 0
    kind = integrator_for(traits, everything(traits, rules.sppc).integrator, depth, edges=edges)
    reasons = {choice.effect: choice.reason for choice in plan.choices} | dict(grown)
    more = plan_of(traits, replace(settings, max_depth=depth, integrator=kind), reasons)
    kept = [
        replace(new, fraction=old.fraction, variance_seconds=old.variance_seconds) if new.on == old.on else new
        for new, old in zip(more.choices, plan.choices, strict=True)
    ]
    return replace(more, choices=tuple(kept), measured=True)


def _choice(effect: Effect, on: bool, reason: str, settings: Settings) -> Choice:  # noqa: FBT001
    samples = {EFFECTS[part]: getattr(settings, part) for part in PARTS}.get(effect)
    return Choice(effect, on, reason, samples if on and samples else None)


def _camera() -> Choice:
    return Choice(Effect.CAMERA, on=False, reason="Mitsuba has no gradient by sensors")


def _reasons(traits: Traits, settings: Settings) -> dict[Effect, str]:
    but = APART if traits.followed or traits.blurred else ""
    moves = clause(traits.moving, "moves a shape", "move shapes")
    single = len(traits.moving) == 1
    shades = [*traits.moving, *traits.appearance, *traits.emission, *traits.volumes]
    limit = (
        f"the scene's own limit is {traits.depth}"
        if traits.limited
        else f"the scene sets no limit, {traits.depth} stands for all"
    )
    if not traits.moving:
        primary = indirect = STILL + but
    elif not settings.projective:
        primary = indirect = f"{moves}, but {settings.integrator} has no gradient of edges"
    else:
        primary = f"{moves}, and {'its outline' if single else 'their outlines'} in view"
        indirect = f"{moves}, and with {'it' if single else 'them'} shadows, and edges seen in other surfaces"
        if traits.alone:
            indirect = "the scene is one convex shape, which neither shadows nor reflects itself"
    if settings.max_depth > DIRECT:
        bounces = f"light may reach the camera over {settings.max_depth - 1} surfaces; {limit}"
    else:
        bounces = "the scene is one convex shape, which does not light itself" if traits.alone else limit
    return {
        Effect.CONTINUOUS: clause(shades, "changes how surfaces or media look", "change how surfaces or media look")
        if shades
        else f"nothing is optimised{but}",
        Effect.PRIMARY: primary,
        Effect.INDIRECT: indirect,
        Effect.BOUNCES: bounces,
        Effect.SPECULAR: _surfaces(traits),
        Effect.MEDIA: "the scene has a participating medium" if traits.media else "the scene has no medium",
        Effect.EMITTERS: clause(traits.emission, "changes emitters", "change emitters")
        if traits.emission
        else f"no emitter is optimised{but}",
        Effect.CAMERA: _camera().reason,
        Effect.APPEARANCE: clause(traits.appearance, "changes materials", "change materials")
        if traits.appearance
        else f"no material is optimised{but}",
    }


def _why(traits: Traits, settings: Settings) -> dict[str, str]:
    """Reasons of the settings that are not those of one effect."""
    kinds = {
        OWN: "the scene's own, which the rules do not know",
        "prbvolpath": "the only one with media",
        "prb": "there are no edges to sample",
        "direct_projective": "edges, and no light over more than one surface",
        "prb_projective": "edges, and light over several surfaces",
    }
    why = {"integrator": kinds[settings.integrator]}
    if settings.sppi > 0:
        why["guiding"] = "guided samples never fall where no seed has been, and cost much on a processor"
    if traits.moving:
        why["sample_border"] = (
            "a shape may cross the border, over which the film's filter reaches"
            if settings.sample_border
            else "the film's filter ends at the border"
        )
    return why


def _specular(traits: Traits) -> bool:
    return traits.delta_reflection or traits.delta_transmission or traits.glossy


def _surfaces(traits: Traits) -> str:
    kinds = [
        word
        for word, there in (
            ("mirrors", traits.delta_reflection),
            ("clear glass", traits.delta_transmission),
            ("glossy surfaces", traits.glossy),
        )
        if there
    ]
    return f"the scene has {' and '.join(kinds)}" if kinds else "every surface is diffuse"


def _missing(traits: Traits) -> tuple[str, ...]:
    """Gradients that a scene calls for and Mitsuba does not have, beyond those that a GradientWarning names."""
    notes = []
    if traits.moving and (traits.delta_reflection or traits.delta_transmission) and traits.smooth:
        notes.append(
            "edges that are seen in a perfect mirror or through clear glass have no gradient in Mitsuba; those in a "
            "rough conductor or dielectric have, and so has what `blur` names"
        )
    if traits.moving and traits.media:
        notes.append("the motion of outlines and shadows has no gradient in Mitsuba where there is a medium")
    if traits.moving and traits.reaches_border and not traits.samples_border:
        notes.append("the film must have sample_border=True, for shapes that cross the border of the image")
    return tuple(notes)
