"""The pilot: a few cheap gradients of each effect, which show the effects that carry the gradient of the loss."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from loi_core.effects import (
    SIGNIFICANT_ERRORS,
    Choice,
    Draws,
    Effect,
    EffectPlan,
    Frozen,
    GradientNorms,
    allocate,
    fraction_bound,
    largest_fraction,
    power_of_two_samples,
    relative_variance,
    significant_norms,
    total,
)
from loi_core.support.wording import listed
from loi_mitsuba.effects.gradient_draws import GradientProbe
from loi_mitsuba.effects.rules import DIRECT_DEPTH, EFFECTS, everything, integrator_for, plan_of
from loi_mitsuba.effects.traits import Traits
from loi_mitsuba.scene.settings import GRADIENT_TERMS, SCENE_INTEGRATOR, Settings, settings_of
from mitsuba_boundaries.drjit.arrays import Float32Array

__all__ = ["MAX_DRAWS", "Pilot", "PilotResult"]

DRAWS: Final = 4
DEEP_DRAWS: Final = 3  # with all effects on, which costs most
MAX_DRAWS: Final = 8
IMAGE_FRACTION: Final = 0.1  # of the fraction, that the image may lack: errors of the image move the optimum
MAX_TRIED_DEPTH: Final = 4
MAX_SAMPLE_RATIO: Final = 4  # of allocated to equal samples, or the inverse: the draws are few
MIN_GROWN_FRACTION: Final = 1e-9


@dataclass(frozen=True)
class PilotResult:
    """The result of a pilot.

    Attributes
    ----------
    plan : EffectPlan
        The simulated effects, and the frozen parameters.
    norms : GradientNorms
        Norms of the gradient, for :meth:`Pilot.grown`.
    frozen : Frozen
        The frozen parameters, with the evidence for releasing them.
    """

    plan: EffectPlan
    norms: GradientNorms = field(default_factory=dict)
    frozen: Frozen = field(default_factory=Frozen)


@dataclass(frozen=True)
class Pilot:
    """Measures the effects of a scene.

    Attributes
    ----------
    traits : Traits
        Traits of the scene.
    samples : int
        Samples per pixel of each term of the gradient; their total time is allocated to the terms that stay on.
    fraction : float
        Effects that carry less of the gradient are turned off.
    units, objects : tuple of tuple of str
        The optimised parameters, grouped by unit and by object.
    """

    traits: Traits
    samples: int
    fraction: float
    units: tuple[tuple[str, ...], ...]
    objects: tuple[tuple[str, ...], ...]

    def run(self, plan: EffectPlan, probe: GradientProbe) -> PilotResult:
        """Turn off the effects of a plan by the rules that carry less than the fraction, as a few gradients show.

        Objects whose gradient is indistinguishable from noise are frozen. Effects that are not exactly 0 for them stay
        on, so that their gradient can become significant.
        """
        rules = settings_of(plan)
        if not plan.understood or rules.integrator == SCENE_INTEGRATOR:
            return PilotResult(plan)
        settings, draws, depth_reason, missing = self._shallowest(rules, probe)
        whole_by_name = total(list(draws.values()))
        frozen = Frozen.of(whole_by_name, self.objects)
        notes = _notes(whole_by_name, frozen, self.samples)
        terms = {term: term_draws.grouped(self.units) for term, term_draws in draws.items()}
        whole = total(list(terms.values()))
        significant = self._significant(whole, frozen)
        norms = significant_norms(whole, significant)
        active, reasons = self._terms_to_keep(terms, whole, significant, norms, missing)
        settings = settings.sampled({term: 0 for term in terms if term not in active})
        edges = settings.sppp > 0 or settings.sppi > 0
        full = everything(self.traits, self.samples).integrator
        integrator = integrator_for(self.traits, full, settings.max_depth, edges=edges)
        settings = replace(settings, integrator=integrator).sampled(self._allocation(active, whole, significant))
        planned = plan_of(self.traits, settings, {Effect.BOUNCES: depth_reason, **reasons}, notes=notes)
        choices = _with_fractions(planned, terms, whole, significant)
        planned = replace(planned, choices=choices, frozen=frozen.reasons, measured=True)
        return PilotResult(planned, norms, frozen)

    def _terms_to_keep(
        self,
        terms: Mapping[str, Draws],
        whole: Draws,
        significant: tuple[str, ...],
        norms: GradientNorms,
        missing: float,
    ) -> tuple[dict[str, Draws], dict[Effect, str]]:
        """Turn terms off, the smallest first, while all that is off stays below the fraction; add the reasons."""
        active = dict(terms)
        reasons = {}
        has_gradient = any(
            not term_draws.is_zero(name) for term_draws in terms.values() for name in term_draws.gradients
        )
        for term, term_draws in sorted(terms.items(), key=lambda item: fraction_bound(item[1], norms)):
            largest = fraction_bound(term_draws, norms)
            measured = largest_fraction(term_draws, whole, significant)
            if (has_gradient and largest == 0.0) or (significant and missing + largest < self.fraction):
                missing += largest
                del active[term]
                reasons[EFFECTS[term]] = f"surely under {largest:.1%} of the gradient"
                if largest == 0.0:
                    reasons[EFFECTS[term]] = f"exactly 0 in {term_draws.count} draws of {self.samples} samples a pixel"
            elif measured is not None:
                reasons[EFFECTS[term]] = f"{measured:.1%} of the gradient"
        return active, reasons

    def _shallowest(self, rules: Settings, probe: GradientProbe) -> tuple[Settings, dict[str, Draws], str, float]:
        """Find the smallest depth whose image is complete and whose gradient misses less than the fraction.

        Returns
        -------
        settings : Settings
            The settings of the rules at that depth.
        draws : dict of Draws
            Draws of each term of the gradient at that depth.
        reason : str
        missing : float
            Upper bound of the fraction of the gradient that longer paths carry.
        """
        seeds = range(probe.seed, probe.seed + DEEP_DRAWS)
        if rules.max_depth <= DIRECT_DEPTH or self.traits.has_medium:
            return rules, self._draw_terms(rules, probe), plan_of(self.traits, rules)[Effect.BOUNCES].reason, 0.0
        deep = [probe.image(rules, seed) for seed in seeds[:2]]
        for depth in range(DIRECT_DEPTH, min(rules.max_depth, MAX_TRIED_DEPTH + 1)):
            shallow = replace(rules, max_depth=depth)
            if not self._same_image(deep, shallow, probe, seeds[:2]):
                continue
            integrator = integrator_for(self.traits, rules.integrator, depth, edges=rules.projective)
            settings = replace(shallow, integrator=integrator)
            draws = self._draw_terms(settings, probe)
            # Each term uses the seed in the same way, alone or with others, and a short path is the beginning of the
            # long path of the same seed: most of the noise cancels in the difference.
            shallow_draws = total([term_draws.first(DEEP_DRAWS) for term_draws in draws.values()])
            longer = probe.gradients(rules, seeds).minus(shallow_draws)
            largest = self._largest_fraction(longer, self._norms(draws))
            measured = self._largest_fraction(longer, self._norms(draws), n_errors=0.0)
            if largest >= self.fraction and not self.fraction <= measured < math.inf:
                # The bound may be loose because the whole gradient is noisy; too large a depth costs more than draws.
                draws = self._draw_more(settings, draws, probe)
                largest = self._largest_fraction(longer, self._norms(draws))
            if largest == 0.0 or largest < self.fraction:
                reason = f"longer paths surely carry under {largest:.1%} of the gradient, and hardly any of the image"
                return settings, draws, reason, largest
            break
        else:
            reason = f"longer paths than {depth} change the image"
            return rules, self._draw_terms(rules, probe), reason, 0.0
        reason = f"longer paths than {depth} carry {self.fraction:.0%} of the gradient, or may"
        return rules, self._draw_terms(rules, probe), reason, 0.0

    def _draw_terms(self, settings: Settings, probe: GradientProbe) -> dict[str, Draws]:
        """Draw each term of the gradient; twice as often if a gradient is indistinguishable from noise."""
        seeds = range(probe.seed, probe.seed + DRAWS)
        draws = {
            term: probe.gradients(settings.only(term) if settings.projective else settings, seeds)
            for term in GRADIENT_TERMS
            if getattr(settings, term) > 0
        }
        whole = total(list(draws.values()))
        by_unit = whole.grouped(self.units)
        frozen = Frozen.of(whole, self.objects).reasons
        if all(by_unit.is_significant(name) or by_unit.is_zero(name) for name in by_unit.gradients) and all(
            map(whole.is_zero, frozen)
        ):
            return draws
        return self._draw_more(settings, draws, probe)

    def _draw_more(self, settings: Settings, draws: Mapping[str, Draws], probe: GradientProbe) -> dict[str, Draws]:
        """Double the draws of each term that is not exactly 0, up to MAX_DRAWS."""
        seeds = range(probe.seed + DRAWS, probe.seed + MAX_DRAWS)
        return {
            term: term_draws
            if term_draws.count == MAX_DRAWS or all(map(term_draws.is_zero, term_draws.gradients))
            else term_draws.extended(probe.gradients(settings.only(term) if settings.projective else settings, seeds))
            for term, term_draws in draws.items()
        }

    def _significant(self, whole: Draws, frozen: Frozen) -> tuple[str, ...]:
        """Return the units with a significant gradient; units of frozen parameters have no vote."""
        frozen_units = {", ".join(unit) for unit in self.units if frozen.reasons.keys() >= set(unit)}
        return tuple(name for name in whole.significant if name not in frozen_units)

    def _norms(self, draws: Mapping[str, Draws]) -> GradientNorms:
        whole = total(list(draws.values()))
        by_unit = whole.grouped(self.units)
        return significant_norms(by_unit, self._significant(by_unit, Frozen.of(whole, self.objects)))

    def _largest_fraction(self, term: Draws, norms: GradientNorms, n_errors: float = SIGNIFICANT_ERRORS) -> float:
        return fraction_bound(term.grouped(self.units), norms, n_errors)

    def grown(self, rules: Settings, plan: EffectPlan, probe: GradientProbe, norms: GradientNorms) -> dict[Effect, str]:
        """Return the effects of the rules that a plan turned off and that carry a gradient now, with the reasons.

        An effect that was exactly 0 counts as soon as it is not 0. A small effect is compared with the gradient at the
        pilot: near the end of a fit, where the gradient is small, every effect is a large fraction of it. Depth, which
        costs most and was measured to be negligible, counts only if its expected fraction is large enough.
        """
        seeds = (probe.seed, probe.seed + 1)
        settings = settings_of(plan)
        shallow = replace(rules, max_depth=settings.max_depth)
        threshold = max(self.fraction, MIN_GROWN_FRACTION)
        grown: dict[Effect, str] = {}
        for term, effect in EFFECTS.items():
            if getattr(rules, term) == 0 or getattr(settings, term) > 0:
                continue
            term_draws = probe.gradients(shallow.only(term), seeds)
            if plan[effect].fraction == 0.0 and not all(map(term_draws.is_zero, term_draws.gradients)):
                grown[effect] = "it was exactly 0 when it was turned off, and no longer is"
            elif self._largest_fraction(term_draws, norms) >= threshold:
                grown[effect] = f"it may have grown to {self.fraction:.0%} of the gradient at the pilot"
        if settings.max_depth < rules.max_depth:
            deep = [probe.image(rules, seed) for seed in seeds]
            deep_draws, shallow_draws = (probe.gradients(candidate, seeds) for candidate in (rules, shallow))
            missing = self._largest_fraction(deep_draws.minus(shallow_draws), norms, n_errors=1.0)
            if missing >= threshold or not self._same_image(deep, shallow, probe, seeds, n_errors=1.0):
                grown[Effect.BOUNCES] = (
                    "longer paths carry more of the image or the gradient than when they were turned off"
                )
        return grown

    def _same_image(
        self,
        deep: Sequence[Float32Array],
        shallow: Settings,
        probe: GradientProbe,
        seeds: Sequence[int],
        n_errors: float = SIGNIFICANT_ERRORS,
    ) -> bool:
        missing = [image - probe.image(shallow, seed) for image, seed in zip(deep, seeds, strict=True)]
        return _is_negligible(missing, deep, IMAGE_FRACTION * self.fraction, n_errors)

    def _allocation(self, active: Mapping[str, Draws], whole: Draws, significant: Sequence[str]) -> dict[str, int]:
        """Allocate samples to the terms that stay on, in the time that equal counts would take."""
        if len(active) < 2 or not significant:
            return dict.fromkeys(active, self.samples)
        variances = [relative_variance(term_draws, whole, significant) * self.samples for term_draws in active.values()]
        costs = [term_draws.seconds / self.samples for term_draws in active.values()]
        budget = sum(term_draws.seconds for term_draws in active.values())
        base = 2 ** (self.samples.bit_length() - 1)
        smallest, largest = max(1, base // MAX_SAMPLE_RATIO), base * MAX_SAMPLE_RATIO
        counts = power_of_two_samples(
            allocate(variances, costs, budget), costs, budget, minimum=smallest, maximum=largest
        )
        return dict(zip(active, counts, strict=True))


def _is_negligible(
    missing: Sequence[Float32Array], whole: Sequence[Float32Array], fraction: float, n_errors: float
) -> bool:
    """Return whether an image certainly misses less than a fraction of its Euclidean norm.

    Two seeds give an estimate of the squared norm without bias from noise, and its error.
    """
    first, second = (image.astype(np.float64).reshape(-1) for image in missing)
    products = first * second
    error = math.sqrt(products.size) * float(np.std(products))
    bound = math.sqrt(max(0.0, float(np.sum(products)) + n_errors * error))
    return bound <= fraction * float(np.linalg.norm(np.mean([image.astype(np.float64) for image in whole], axis=0)))


def _with_fractions(
    plan: EffectPlan, terms: Mapping[str, Draws], whole: Draws, significant: Sequence[str]
) -> tuple[Choice, ...]:
    """Return the choices of a plan with the measured fraction and work of each term."""
    draws = {effect: terms[term] for term, effect in EFFECTS.items() if term in terms}
    choices = []
    for choice in plan.choices:
        term_draws = draws.get(choice.effect)
        if term_draws is None:
            choices.append(choice)
            continue
        work = relative_variance(term_draws, whole, significant) * term_draws.seconds if significant else None
        choices.append(
            replace(choice, fraction=largest_fraction(term_draws, whole, significant), variance_seconds=work)
        )
    return tuple(choices)


def _notes(whole: Draws, frozen: Frozen, samples: int) -> tuple[str, ...]:
    """Return notes about parameters whose gradient is indistinguishable from noise."""
    noisy = [name for name in whole.gradients if not whole.is_significant(name) and name not in frozen.reasons]
    notes = []
    if len(frozen.reasons) == len(whole.gradients):
        notes.append(
            "no optimised parameter has a significant gradient here: all are frozen, and a fit does not move until the "
            "gradient of a parameter can be distinguished from noise"
        )
    if noisy:
        notes.append(
            f"the gradient with respect to {listed(noisy)} cannot be distinguished from noise in {whole.count} draws "
            f"of {samples} samples a pixel; it is not frozen, because another parameter of its object is significant"
        )
    return tuple(notes)
