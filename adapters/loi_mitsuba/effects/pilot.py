"""The pilot: a few cheap gradients of each effect, which say what carries the gradient of the loss at hand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from loi_core.effects import (
    SURE,
    Choice,
    Draws,
    Effect,
    EffectPlan,
    Holding,
    Sizes,
    allocate,
    largest_fraction,
    most_fraction,
    relative_variance,
    sizes_of,
    total,
    whole_samples,
)
from loi_core.support.wording import listed
from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.effects.gradient_draws import Probe
from loi_mitsuba.effects.rules import DIRECT, EFFECTS, everything, integrator_for, plan_of
from loi_mitsuba.effects.traits import Traits
from loi_mitsuba.scene.settings import OWN, PARTS, Settings, settings_of

__all__ = ["MOST_DRAWS", "Findings", "Pilot"]

DRAWS: Final = 4
DEEP_DRAWS: Final = 3  # of everything, which costs most
MOST_DRAWS: Final = 8
IMAGE: Final = 0.1  # of the fraction: what an image may lack, for that moves where a fit ends
DEEPEST_TRIED: Final = 4
MOST_MOVED: Final = 4  # a part gets at most so many times its samples, and at least that fraction: draws are few
LEAST: Final = 1e-9  # of a fraction that is not nothing


@dataclass(frozen=True)
class Findings:
    """What a pilot has found.

    Attributes
    ----------
    plan : EffectPlan
        What is to be simulated, and what is held.
    sizes : Sizes
        Of the gradient, for :meth:`Pilot.grown`.
    holding : Holding
        What speaks for letting go of what is held.
    """

    plan: EffectPlan
    sizes: Sizes = field(default_factory=dict)
    holding: Holding = field(default_factory=Holding)


@dataclass(frozen=True)
class Pilot:
    """What the pilot measures by.

    Attributes
    ----------
    traits : Traits
        Of the scene.
    samples : int
        Samples per pixel of each part of the gradient that is on; the time they take together is shared out.
    fraction : float
        Effects that carry less of the gradient go off.
    units, objects : tuple of tuple of str
        The optimised parameters, those of one unit together, and those of one object together.
    """

    traits: Traits
    samples: int
    fraction: float
    units: tuple[tuple[str, ...], ...]
    objects: tuple[tuple[str, ...], ...]

    def run(self, plan: EffectPlan, probe: Probe) -> Findings:
        """The plan by rules with the effects off that a few gradients show to be under the fraction.

        Objects whose gradient cannot be distinguished from noise are held. What is not exactly 0 for them stays on, so
        that it can become significant later.
        """
        rules = settings_of(plan)
        if not plan.understood or rules.integrator == OWN:
            return Findings(plan)
        settings, each, bounces, lacking = self._shallowest(rules, probe)
        holding = Holding.begun(total(list(each.values())), self.objects)
        notes = _notes(total(list(each.values())), holding, self.samples)
        drawn = {part: one.grouped(self.units) for part, one in each.items()}
        whole = total(list(drawn.values()))
        significant = self._significant(whole, holding)
        sizes = sizes_of(whole, significant)
        fractions = {part: largest_fraction(one, whole, significant) for part, one in drawn.items()}
        reasons = {Effect.BOUNCES: bounces}
        kept = dict(drawn)
        seen = any(not one.zero(name) for one in drawn.values() for name in one.gradients)
        # The smallest first, as long as all that is off together stays under the fraction.
        for part, one in sorted(drawn.items(), key=lambda item: most_fraction(item[1], sizes)):
            most = most_fraction(one, sizes)
            if (seen and most == 0.0) or (significant and lacking + most < self.fraction):
                lacking += most
                del kept[part]
                if most == 0.0:
                    why = f"exactly 0 in {one.count} draws of {self.samples} samples a pixel"
                else:
                    why = f"surely under {most:.1%} of the gradient"
                reasons[EFFECTS[part]] = why
            elif fractions[part] is not None:
                reasons[EFFECTS[part]] = f"{fractions[part]:.1%} of the gradient"
        settings = settings.sampled({part: 0 for part in drawn if part not in kept})
        edges = settings.sppp > 0 or settings.sppi > 0
        kind = integrator_for(
            self.traits, everything(self.traits, self.samples).integrator, settings.max_depth, edges=edges
        )
        settings = replace(settings, integrator=kind).sampled(self._allocation(kept, whole, significant))
        planned = plan_of(self.traits, settings, reasons, notes=notes)
        planned = replace(
            planned, choices=_with_fractions(planned, drawn, whole, significant), held=holding.reasons, measured=True
        )
        return Findings(planned, sizes, holding)

    def _shallowest(self, rules: Settings, probe: Probe) -> tuple[Settings, dict[str, Draws], str, float]:
        """The least depth at which the image lacks next to nothing, and the gradient less than the fraction.

        Returns
        -------
        settings : Settings
            The rules' at that depth.
        drawn : dict of Draws
            The parts of the gradient there, by parameter.
        reason : str
        lacking : float
            The most that the gradient may lack of longer paths, as a fraction of it.
        """
        seeds = range(probe.seed, probe.seed + DEEP_DRAWS)
        if rules.max_depth <= DIRECT or self.traits.media:
            return rules, self._parts(rules, probe), plan_of(self.traits, rules)[Effect.BOUNCES].reason, 0.0
        deep = [probe.image(rules, seed) for seed in seeds[:2]]
        for depth in range(DIRECT, min(rules.max_depth, DEEPEST_TRIED + 1)):
            shallow = replace(rules, max_depth=depth)
            if not self._same_image(deep, shallow, probe, seeds[:2]):
                continue
            settings = replace(
                shallow, integrator=integrator_for(self.traits, rules.integrator, depth, edges=rules.projective)
            )
            drawn = self._parts(settings, probe)
            # Each part draws from the seed in its own way, alone or with others, and a shallow path is the beginning of
            # the deep one of the same seed: most of the noise goes with the difference.
            parts = total([one.first(DEEP_DRAWS) for one in drawn.values()])
            lacking = probe.gradients(rules, seeds).less(parts)
            most = self._most(lacking, self._sizes(drawn))
            found = self._most(lacking, self._sizes(drawn), sure=0.0)
            if most >= self.fraction and not self.fraction <= found < math.inf:
                # It may well be less, if only what it is a fraction of were known better; a depth too many costs more.
                drawn = self._more_parts(settings, drawn, probe)
                most = self._most(lacking, self._sizes(drawn))
            if most == 0.0 or most < self.fraction:
                reason = f"longer paths surely carry under {most:.1%} of the gradient, and next to none of the image"
                return settings, drawn, reason, most
            break
        else:
            reason = f"longer paths than {depth} change the image"
            return rules, self._parts(rules, probe), reason, 0.0
        reason = f"longer paths than {depth} carry {self.fraction:.0%} of the gradient, or may"
        return rules, self._parts(rules, probe), reason, 0.0

    def _parts(self, settings: Settings, probe: Probe) -> dict[str, Draws]:
        """Draws of each part of the gradient; twice as many where something cannot be distinguished from noise."""
        seeds = range(probe.seed, probe.seed + DRAWS)
        first = {
            part: probe.gradients(settings.only(part) if settings.projective else settings, seeds)
            for part in PARTS
            if getattr(settings, part) > 0
        }
        whole = total(list(first.values()))
        united = whole.grouped(self.units)
        held = Holding.begun(whole, self.objects).reasons
        if all(united.heard(name) or united.zero(name) for name in united.gradients) and all(map(whole.zero, held)):
            return first
        return self._more_parts(settings, first, probe)

    def _more_parts(self, settings: Settings, drawn: Mapping[str, Draws], probe: Probe) -> dict[str, Draws]:
        """Twice as many draws of each part that is not exactly 0, unless it has them."""
        seeds = range(probe.seed + DRAWS, probe.seed + MOST_DRAWS)
        return {
            part: one
            if one.count == MOST_DRAWS or all(map(one.zero, one.gradients))
            else one.and_more(probe.gradients(settings.only(part) if settings.projective else settings, seeds))
            for part, one in drawn.items()
        }

    def _significant(self, whole: Draws, holding: Holding) -> tuple[str, ...]:
        """Of the units, those that can be distinguished from noise; what is held decides nothing."""
        held = {", ".join(unit) for unit in self.units if holding.reasons.keys() >= set(unit)}
        return tuple(name for name in whole.significant if name not in held)

    def _sizes(self, drawn: Mapping[str, Draws]) -> Sizes:
        whole = total(list(drawn.values()))
        united = whole.grouped(self.units)
        return sizes_of(united, self._significant(united, Holding.begun(whole, self.objects)))

    def _most(self, part: Draws, sizes: Sizes, sure: float = SURE) -> float:
        return most_fraction(part.grouped(self.units), sizes, sure)

    def grown(self, rules: Settings, plan: EffectPlan, probe: Probe, sizes: Sizes) -> dict[Effect, str]:
        """Effects that the rules turn on and a plan off, and that have appeared or grown to the fraction, with reasons.

        What was exactly 0 has appeared as soon as it is not. What was small is compared with the gradient as the pilot
        found it: near the end of a fit, where the gradient is faint, everything has a great fraction of it. Depth,
        which costs most, has been shown to matter little and gets less benefit of the doubt.
        """
        seeds = (probe.seed, probe.seed + 1)
        settings = settings_of(plan)
        shallow = replace(rules, max_depth=settings.max_depth)
        found: dict[Effect, str] = {}
        for part, effect in EFFECTS.items():
            if getattr(rules, part) == 0 or getattr(settings, part) > 0:
                continue
            one = probe.gradients(shallow.only(part), seeds)
            if plan[effect].fraction == 0.0 and not all(map(one.zero, one.gradients)):
                found[effect] = "it was exactly 0 when it was turned off, and is no longer"
            elif self._most(one, sizes) >= max(self.fraction, LEAST):
                found[effect] = f"it may have grown to {self.fraction:.0%} of the gradient that the pilot found"
        if settings.max_depth < rules.max_depth:
            deep = [probe.image(rules, seed) for seed in seeds]
            drawn = [probe.gradients(one, seeds) for one in (rules, shallow)]
            missing = self._most(drawn[0].less(drawn[1]), sizes, sure=1.0)
            if missing >= max(self.fraction, LEAST) or not self._same_image(deep, shallow, probe, seeds, sure=1.0):
                found[Effect.BOUNCES] = (
                    "longer paths carry more of the image or the gradient than when they were left out"
                )
        return found

    def _same_image(
        self, deep: Sequence[Float32Array], shallow: Settings, probe: Probe, seeds: Sequence[int], sure: float = SURE
    ) -> bool:
        lacking = [full - probe.image(shallow, seed) for full, seed in zip(deep, seeds, strict=True)]
        return _image_under(lacking, deep, IMAGE * self.fraction, sure)

    def _allocation(self, kept: Mapping[str, Draws], whole: Draws, significant: Sequence[str]) -> dict[str, int]:
        """Samples of every part that is kept, in the time that equal counts would take."""
        if len(kept) < 2 or not significant:
            return dict.fromkeys(kept, self.samples)
        spreads = [relative_variance(one, whole, significant) * self.samples for one in kept.values()]
        costs = [one.seconds / self.samples for one in kept.values()]
        budget = sum(one.seconds for one in kept.values())
        base = 2 ** (self.samples.bit_length() - 1)
        least, most = max(1, base // MOST_MOVED), base * MOST_MOVED
        counts = whole_samples(allocate(spreads, costs, budget), costs, budget, least=least, most=most)
        return dict(zip(kept, counts, strict=True))


def _image_under(lacking: Sequence[Float32Array], whole: Sequence[Float32Array], fraction: float, sure: float) -> bool:
    """Whether what an image lacks is surely under a fraction of it, in the Euclidean norm.

    Two seeds give the squared norm without the noise, and its error.
    """
    first, second = (one.astype(np.float64).reshape(-1) for one in lacking)
    products = first * second
    error = math.sqrt(products.size) * float(np.std(products))
    most = math.sqrt(max(0.0, float(np.sum(products)) + sure * error))
    return most <= fraction * float(np.linalg.norm(np.mean([one.astype(np.float64) for one in whole], axis=0)))


def _with_fractions(
    plan: EffectPlan, drawn: Mapping[str, Draws], whole: Draws, significant: Sequence[str]
) -> tuple[Choice, ...]:
    parts = {effect: part for part, effect in EFFECTS.items() if part in drawn}
    choices = []
    for choice in plan.choices:
        part = parts.get(choice.effect)
        if part is None:
            choices.append(choice)
            continue
        one = drawn[part]
        work = relative_variance(one, whole, significant) * one.seconds if significant else None
        choices.append(replace(choice, fraction=largest_fraction(one, whole, significant), variance_seconds=work))
    return tuple(choices)


def _notes(each: Draws, holding: Holding, samples: int) -> tuple[str, ...]:
    """What the pilot has to say about parameters without a gradient."""
    lost = [name for name in each.gradients if not each.heard(name) and name not in holding.reasons]
    notes = []
    if len(holding.reasons) == len(each.gradients):
        notes.append(
            "nothing that is optimised can be seen here: everything is held, and a fit stays where it is until the "
            "gradient of something can be distinguished from noise"
        )
    if lost:
        notes.append(
            f"the gradient by {listed(lost)} cannot be distinguished from noise in {each.count} draws "
            f"of {samples} samples a pixel; it is not held, for that of what moves with it can"
        )
    return tuple(notes)
