"""The pilot: a few cheap gradients of each effect, which say what carries the gradient of the loss at hand."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.effects import Choice, Draws, Effect, EffectPlan, allocate, total, whole_samples
from loi_mitsuba.effects.rules import DIRECT, everything, integrator_for, plan_of
from loi_mitsuba.effects.settings import OWN, PARTS, Settings, settings_of
from loi_mitsuba.effects.traits import Traits
from loi_mitsuba.handles import Host
from loi_mitsuba.renderer import MitsubaRenderer

__all__ = ["EFFECTS", "Pilot", "Probe", "Sizes"]

Sizes: TypeAlias = Mapping[str, tuple[float, float]]
"""By parameter, the norm of its gradient and the error of that; a norm of 0 if it cannot be told from noise."""

EFFECTS: Final = {"sppc": Effect.CONTINUOUS, "sppp": Effect.PRIMARY, "sppi": Effect.INDIRECT}
DRAWS: Final = 4
DEEP_DRAWS: Final = 3  # of everything, which costs most
MOST_DRAWS: Final = 8
IMAGE: Final = 0.1  # of the share: what an image may lack, for that moves where a fit ends
DEEPEST_TRIED: Final = 4
MOST_MOVED: Final = 4  # a part gets at most so many times its samples, and at least that fraction: draws are few
LEAST: Final = 1e-9  # of a share that is not nothing
SURE: Final = 2.0  # errors of a mean that a decision has to clear


@dataclass(frozen=True)
class Probe:
    """Where the gradient is asked for.

    Attributes
    ----------
    renderer : MitsubaRenderer
        Any of those that share the scene.
    params : dict of arrays
        The parameters.
    cotangent : array, shape (H, W, C)
        The gradient of the loss by the image there.
    names : tuple of str
        The parameters that are optimised.
    groups : tuple of tuple of str
        The same, those of one unit together.
    seed : int
        First of the seeds that are used.
    """

    renderer: MitsubaRenderer
    params: Mapping[str, Any]
    cotangent: Any
    names: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    seed: int = 0

    def gradients(self, settings: Settings, seeds: Sequence[int]) -> Draws:
        """Draws of the gradient under these settings."""
        made = self.renderer.with_integrator(
            settings.load(), spp_grad=None if settings.projective else settings.sppc, follow=self.names
        )
        drawn = _draw(lambda seed: made.pull(self.params, self.cotangent, seed=seed), self.names, seeds)
        return drawn.grouped(self.groups)

    def image(self, settings: Settings, seed: int) -> Host:
        """The image under these settings."""
        return self.renderer.with_integrator(settings.load()).render(self.params, seed=seed)


def _draw(function: Callable[[int], Mapping[str, Any]], names: Sequence[str], seeds: Sequence[int]) -> Draws:
    """One draw of a gradient for each seed, and the time of the fastest: the first may compile."""
    drawn, times = [], []
    for seed in seeds:
        begin = time.perf_counter()
        pulled = function(seed)
        times.append(time.perf_counter() - begin)
        drawn.append({name: pulled[name] for name in names})
    return Draws.of(drawn, min(times))


def _sizes(whole: Draws) -> Sizes:
    heard = _heard(whole)
    return {name: (whole.size(name) if name in heard else 0.0, whole.error(name)) for name in whole.gradients}


def _most(part: Draws, sizes: Sizes, sure: float = SURE) -> float:
    """What a part of a gradient surely does not exceed as a share of the whole, for any parameter.

    To the share that was found, `sure` of its errors are added, which come from both. Where the whole cannot be told
    from noise, no share is small enough but that of a part which was exactly 0 in every draw.
    """
    shares = [0.0]
    for name, (size, error) in sizes.items():
        if part.zero(name):
            continue
        if size == 0.0:
            return math.inf
        share = part.size(name) / size
        shares.append(share + sure * math.hypot(part.error(name), share * error) / size)
    return max(shares)


@dataclass(frozen=True)
class Pilot:
    """What the pilot measures by.

    Attributes
    ----------
    traits : Traits
        Of the scene.
    samples : int
        Samples per pixel of each part of the gradient that is on; the time they take together is shared out.
    share : float
        Effects that carry less of the gradient go off.
    """

    traits: Traits
    samples: int
    share: float

    def run(self, plan: EffectPlan, probe: Probe) -> tuple[EffectPlan, Sizes]:
        """The plan by rules with the effects off that a few gradients show to be under the share.

        Returns
        -------
        plan : EffectPlan
        sizes : Sizes
            Of the gradient, for :meth:`grown`.
        """
        rules = settings_of(plan)
        if not plan.understood or rules.integrator == OWN:
            return plan, {}
        settings, drawn, bounces, lacking = self._shallowest(rules, probe)
        whole = total(list(drawn.values()))
        sizes = _sizes(whole)
        shares = {part: _share(one, whole) for part, one in drawn.items()}
        reasons = {Effect.BOUNCES: bounces}
        kept = dict(drawn)
        # The smallest first, as long as all that is off together stays under the share.
        for part, one in sorted(drawn.items(), key=lambda item: _most(item[1], sizes)):
            most = _most(one, sizes)
            if _heard(whole) and (most == 0.0 or lacking + most < self.share):
                lacking += most
                del kept[part]
                if most == 0.0:
                    why = f"exactly 0 in {one.count} draws of {self.samples} samples a pixel"
                else:
                    why = f"surely under {most:.1%} of the gradient"
                reasons[EFFECTS[part]] = why
            elif shares[part] is not None:
                reasons[EFFECTS[part]] = f"{shares[part]:.1%} of the gradient"
        settings = settings.sampled({part: 0 for part in drawn if part not in kept})
        edges = settings.sppp > 0 or settings.sppi > 0
        kind = integrator_for(everything(self.traits, self.samples).integrator, settings.max_depth, edges=edges)
        settings = replace(settings, integrator=kind).sampled(self._allocation(kept, whole))
        planned = plan_of(self.traits, settings, reasons, notes=_findings(whole, self.samples))
        return replace(planned, choices=_with_shares(planned, drawn, whole, shares), measured=True), sizes

    def _shallowest(self, rules: Settings, probe: Probe) -> tuple[Settings, dict[str, Draws], str, float]:
        """The least depth at which the image lacks next to nothing, and the gradient less than the share.

        Returns
        -------
        settings : Settings
            The rules' at that depth.
        drawn : dict of Draws
            The parts of the gradient there.
        reason : str
        lacking : float
            The most that the gradient may lack of longer paths, as a share of it.
        """
        seeds = range(probe.seed, probe.seed + DEEP_DRAWS)
        if rules.max_depth <= DIRECT or self.traits.media:
            return rules, self._parts(rules, probe), plan_of(self.traits, rules)[Effect.BOUNCES].reason, 0.0
        deep = [probe.image(rules, seed) for seed in seeds[:2]]
        for depth in range(DIRECT, min(rules.max_depth, DEEPEST_TRIED + 1)):
            shallow = replace(rules, max_depth=depth)
            if not self._same_image(deep, shallow, probe, seeds[:2]):
                continue
            settings = replace(shallow, integrator=integrator_for(rules.integrator, depth, edges=rules.projective))
            drawn = self._parts(settings, probe)
            # Each part draws from the seed in its own way, alone or with others, and a shallow path is the beginning of
            # the deep one of the same seed: most of the noise goes with the difference.
            parts = total([one.first(DEEP_DRAWS) for one in drawn.values()])
            most = _most(probe.gradients(rules, seeds).less(parts), _sizes(total(list(drawn.values()))))
            if most == 0.0 or most < self.share:
                reason = f"longer paths surely carry under {most:.1%} of the gradient, and next to none of the image"
                return settings, drawn, reason, most
            break
        else:
            reason = f"longer paths than {depth} change the image"
            return rules, self._parts(rules, probe), reason, 0.0
        reason = f"longer paths than {depth} carry {self.share:.0%} of the gradient, or may"
        return rules, self._parts(rules, probe), reason, 0.0

    def _parts(self, settings: Settings, probe: Probe) -> dict[str, Draws]:
        """Draws of each part of the gradient; twice as many where parameters cannot be told from noise."""
        drawn = {
            part: settings.only(part) if settings.projective else settings
            for part in PARTS
            if getattr(settings, part) > 0
        }
        first = {part: probe.gradients(one, range(probe.seed, probe.seed + DRAWS)) for part, one in drawn.items()}
        whole = total(list(first.values()))
        if all(name in _heard(whole) or whole.zero(name) for name in whole.gradients):
            return first
        more = range(probe.seed + DRAWS, probe.seed + MOST_DRAWS)
        return {
            part: one.and_more(probe.gradients(drawn[part], more)) if any(map(np.any, one.gradients.values())) else one
            for part, one in first.items()
        }

    def grown(self, rules: Settings, plan: EffectPlan, probe: Probe, sizes: Sizes) -> dict[Effect, str]:
        """Effects that are on by the rules, are off in a plan, and have appeared or grown to the share, with reasons.

        What was exactly 0 has appeared as soon as it is not. What was small is compared with the gradient as the pilot
        found it: near the end of a fit, where the gradient is faint, everything has a great share of it. Depth, which
        costs most, has been shown to matter little and gets less benefit of the doubt.
        """
        seeds = (probe.seed, probe.seed + 1)
        settings = settings_of(plan)
        shallow = replace(rules, max_depth=settings.max_depth)
        found: dict[Effect, str] = {}
        for part, effect in EFFECTS.items():
            if getattr(rules, part) == 0 or getattr(settings, part) > 0:
                continue
            one = probe.gradients(shallow.only(part), seeds)
            if plan[effect].share == 0.0 and not all(map(one.zero, one.gradients)):
                found[effect] = "it was exactly 0 when it was turned off, and is no longer"
            elif _most(one, sizes) >= max(self.share, LEAST):
                found[effect] = f"it may have grown to {self.share:.0%} of the gradient that the pilot found"
        if settings.max_depth < rules.max_depth:
            deep = [probe.image(rules, seed) for seed in seeds]
            drawn = [probe.gradients(one, seeds) for one in (rules, shallow)]
            missing = _most(drawn[0].less(drawn[1]), sizes, sure=1.0)
            if missing >= max(self.share, LEAST) or not self._same_image(deep, shallow, probe, seeds, sure=1.0):
                found[Effect.BOUNCES] = (
                    "longer paths carry more of the image or the gradient than when they were left out"
                )
        return found

    def _same_image(
        self, deep: Sequence[Host], shallow: Settings, probe: Probe, seeds: Sequence[int], sure: float = SURE
    ) -> bool:
        lacking = [full - probe.image(shallow, seed) for full, seed in zip(deep, seeds, strict=True)]
        return _image_under(lacking, deep, IMAGE * self.share, sure)

    def _allocation(self, kept: Mapping[str, Draws], whole: Draws) -> dict[str, int]:
        """Samples of every part that is kept, in the time that equal counts would take."""
        heard = _heard(whole)
        if len(kept) < 2 or not heard:
            return dict.fromkeys(kept, self.samples)
        spreads = [_spread(one, whole) * self.samples for one in kept.values()]
        costs = [one.seconds / self.samples for one in kept.values()]
        budget = sum(one.seconds for one in kept.values())
        base = 2 ** (self.samples.bit_length() - 1)
        least, most = max(1, base // MOST_MOVED), base * MOST_MOVED
        counts = whole_samples(allocate(spreads, costs, budget), costs, budget, least=least, most=most)
        return dict(zip(kept, counts, strict=True))


def _heard(whole: Draws) -> list[str]:
    """The parameters whose gradient can be told from noise."""
    return [name for name in whole.gradients if whole.norm(name) > SURE * whole.error(name)]


def _spread(part: Draws, whole: Draws) -> float:
    """Variance of a part, each parameter relative to its own gradient, since their units differ."""
    return sum(part.variance(name) / whole.norm(name) ** 2 for name in _heard(whole))


def _image_under(lacking: Sequence[Host], whole: Sequence[Host], share: float, sure: float) -> bool:
    """Whether what an image lacks is surely under a share of it, in the Euclidean norm.

    Two seeds give the squared norm without the noise, and its error.
    """
    first, second = (one.astype(np.float64).reshape(-1) for one in lacking)
    products = first * second
    error = math.sqrt(products.size) * float(np.std(products))
    most = math.sqrt(max(0.0, float(np.sum(products)) + sure * error))
    return most <= share * float(np.linalg.norm(np.mean([one.astype(np.float64) for one in whole], axis=0)))


def _share(part: Draws, whole: Draws) -> float | None:
    """The largest share among the parameters whose gradient can be told from noise; None if there is none."""
    return max((part.norm(name) / whole.norm(name) for name in _heard(whole)), default=None)


def _with_shares(
    plan: EffectPlan, drawn: Mapping[str, Draws], whole: Draws, shares: Mapping[str, float | None]
) -> tuple[Choice, ...]:
    parts = {effect: part for part, effect in EFFECTS.items() if part in drawn}
    choices = []
    for choice in plan.choices:
        part = parts.get(choice.effect)
        if part is None:
            choices.append(choice)
            continue
        work = _spread(drawn[part], whole) * drawn[part].seconds if _heard(whole) else None
        choices.append(replace(choice, share=shares[part], variance_seconds=work))
    return tuple(choices)


def _findings(whole: Draws, samples: int) -> tuple[str, ...]:
    """What the pilot has to say about parameters without a gradient."""
    absent = [name for name in whole.gradients if whole.zero(name)]
    lost = [name for name in whole.gradients if name not in absent and name not in _heard(whole)]
    notes = []
    if absent:
        notes.append(f"the image does not change with {_joined(absent)} here: the gradient is exactly 0")
    if lost:
        notes.append(
            f"the gradient by {_joined(lost)} cannot be told from noise in {whole.count} draws of {samples} samples "
            f"a pixel; a fit would follow noise"
        )
    return tuple(notes)


def _joined(names: Sequence[str]) -> str:
    return " and ".join(f"'{name}'" for name in names)
