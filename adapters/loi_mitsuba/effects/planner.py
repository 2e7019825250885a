"""The planner of a fit: from one state of a plan to the next."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final

from loi_core.effects import Effect, EffectPlan, Frozen, GradientNorms, Schedule
from loi_core.errors import ParameterError
from loi_core.renderers.blurred import BlurredRenderer
from loi_core.support.wording import listed
from loi_mitsuba.effects.attached_gradient import AttachedGradient
from loi_mitsuba.effects.blurring import Blurring, PlannedImages
from loi_mitsuba.effects.gradient_draws import PILOT_SEED_OFFSET, GradientProbe
from loi_mitsuba.effects.pilot import MAX_DRAWS, Pilot
from loi_mitsuba.effects.rules import plan_by_rules, plan_with
from loi_mitsuba.effects.setup import PlanSetup
from loi_mitsuba.effects.traits import Traits, group_by_shape, group_by_unit, traits_of
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.settings import settings_of
from mitsuba_boundaries.drjit.arrays import Float32Array
from mitsuba_boundaries.sensing.frustum import Frustum

__all__ = ["PlanState", "Planner"]

NOTHING: Final[Mapping[str, str]] = MappingProxyType({})
log = logging.getLogger("loi_mitsuba")


@dataclass(frozen=True)
class PlanState:
    """The state of a plan.

    Attributes
    ----------
    optimised : tuple of str
        The optimised parameters.
    attached : frozenset of str
        Parameters whose gradient is of attached samples, if they are not blurred.
    names : tuple of str
        Optimised parameters whose gradient is Mitsuba's.
    traits : Traits
    pilot : Pilot
    rules, plan : EffectPlan
        The plan by the rules, and the current plan.
    renderer : MitsubaRenderer
        The scene under the current plan.
    blurred : BlurredRenderer or None
        Gradient of the blurred parameters.
    frozen : Frozen
        Parameters whose gradient is replaced by 0, and the evidence for releasing them.
    norms : dict
        Norms of the gradient at the pilot.
    schedule : Schedule
        When the plan is tested again.
    in_view : frozenset of str
        Parameters whose shape has been in view.
    hidden : dict of mi.Shape
        Shapes out of view whose parameters are blurred, because they have no gradient there.
    started : bool
        Whether the pilot has run.
    """

    optimised: tuple[str, ...]
    attached: frozenset[str]
    names: tuple[str, ...]
    traits: Traits
    pilot: Pilot
    rules: EffectPlan
    plan: EffectPlan
    renderer: MitsubaRenderer
    blurred: BlurredRenderer | None
    frozen: Frozen = field(default_factory=Frozen)
    norms: GradientNorms = field(default_factory=dict)
    schedule: Schedule = field(default_factory=Schedule)
    in_view: frozenset[str] = frozenset()
    hidden: Mapping[str, Any] = field(default_factory=dict)
    started: bool = False


@dataclass(frozen=True)
class Planner:
    """Decides which effects are simulated, and which parameters are attached, blurred or frozen.

    Its methods are functions from one state of a plan to the next.

    Attributes
    ----------
    setup : PlanSetup
    attached : AttachedGradient
    samples : int
        Samples per pixel of each term of the gradient.
    fraction : float
        Effects that carry less of the gradient are turned off.
    blur : mapping or None
        Options of :class:`loi_core.renderers.BlurredRenderer`; None blurs nothing.
    """

    setup: PlanSetup
    attached: AttachedGradient
    samples: int
    fraction: float
    blur: Mapping[str, Any] | None

    @property
    def base(self) -> MitsubaRenderer:
        """The renderer of the scene by the rules."""
        return self.setup.renderer

    def by_rules(self, optimise: Iterable[str]) -> PlanState:
        """Return the state for a fit of these parameters before any gradient is known.

        Raises
        ------
        ParameterError
            If `optimise` is empty or names an unknown parameter.
        """
        names = tuple(dict.fromkeys(optimise))
        for name in names or ("",):
            if name not in self.base.targets:
                msg = f"`optimise` must name parameters of {', '.join(self.base.targets)}, got {name or 'none'!r}"
                raise ParameterError(msg)
        attached = self.setup.attached.without_gradient
        if attached and self.setup.unsupported:
            self._blurring(self.base).over(self.setup.unsupported)  # checks the options: these may be blurred later
        return PlanState(names, attached, **self._fields_by_rules(names, attached, NOTHING, None))

    def start(self, point: GradientProbe, *, optimise: Iterable[str]) -> PlanState:
        """Return the state after the pilot at a point; see :meth:`loi_mitsuba.PlannedRenderer.start`."""
        state = self._without_vanishing(self.by_rules(optimise), point)
        state = replace(state, started=True, in_view=self._visible(state.traits.moving, point))
        state = self._piloted(state, point)
        state = self._with_attached_lights(state, point, state.names)
        return self._with_blurred_noise(state, point)

    def revisit(
        self,
        state: PlanState,
        step: int,
        steps: int,
        value: float | None,
        point: GradientProbe | None,
        gradient: Callable[[], Mapping[str, Float32Array]],
    ) -> PlanState:
        """Return the state of a step, given the loss and the gradient of the previous one.

        Parameters
        ----------
        state : PlanState
            Of the previous step.
        step, steps, value
            As for :meth:`loi_mitsuba.PlannedRenderer.revisit`.
        point : GradientProbe or None
            Where the previous step evaluated the gradient.
        gradient : callable
            Returns the gradient of the frozen parameters there.
        """
        schedule = state.schedule.after_step(value)
        state = replace(state, schedule=schedule if point is None else schedule.after_gradient())
        if point is not None and state.started:
            state = self._after_gradient(state, step, point, gradient)
        if state.blurred is not None:
            state = replace(state, blurred=state.blurred.revisit(step, steps))
        return state

    def _after_gradient(
        self, state: PlanState, step: int, point: GradientProbe, gradient: Callable[[], Mapping[str, Float32Array]]
    ) -> PlanState:
        revealed = self._visible(state.hidden, point)
        if revealed:  # a parameter that was blurred because its gradient was noise has a gradient of its own now
            blurred = {name: reason for name, reason in state.plan.blurred.items() if name not in revealed}
            changes = replace(state.plan, blurred=blurred).changes_from(state.plan)
            log.info("effects, as it comes into view: %s", changes)
            return self.start(point, optimise=state.optimised)
        state = self._in_view(state, point)
        if state.frozen.groups:
            state = replace(state, frozen=state.frozen.updated(gradient()))
            state = self._released(state, {}, "as gradients agree")
        if state.schedule.is_stalled:
            state = replace(state, schedule=state.schedule.after_stall())
            return self._tested(state, point, f"before step {step}, where the loss stalls")
        return self._tested(state, point, "on schedule") if state.schedule.is_due else state

    def _in_view(self, state: PlanState, point: GradientProbe) -> PlanState:
        """When a shape comes into view, sample its silhouette and release the parameters that move it."""
        missing = settings_of(state.rules).sppp > 0 and settings_of(state.plan).sppp == 0
        if not (missing or state.frozen.groups):
            return state
        revealed = self._visible(state.traits.moving, point) - state.in_view
        if not revealed:
            return state
        state = replace(state, in_view=state.in_view | revealed, frozen=state.frozen.without(revealed))
        reason = f"a shape that {listed(sorted(revealed))} moves has come into view"
        return self._released(state, {Effect.PRIMARY: reason} if missing else {}, "as it comes into view")

    def _tested(self, state: PlanState, point: GradientProbe, when: str) -> PlanState:
        """Test again whether effects that are off, and parameters that are blurred or frozen, should stay so."""
        state = self._unblurred(replace(state, schedule=state.schedule.after_probe()), point, when)
        if not state.names or not state.plan.understood or not state.plan.measured:
            return state
        if state.frozen.groups:
            state = self._with_attached_lights(state, point, state.frozen.reasons)
            state = self._with_blurred_noise(state, point)
        if not state.names:
            return state
        grown = state.pilot.grown(settings_of(state.rules), state.plan, replace(point, names=state.names), state.norms)
        return self._released(state, grown, when)

    def _piloted(self, state: PlanState, point: GradientProbe, released: frozenset[str] = frozenset()) -> PlanState:
        """Run the pilot, and freeze the parameters whose gradient is noise, except the `released` ones."""
        if not state.names:
            return state
        result = state.pilot.run(state.plan, replace(point, names=state.names))
        state = replace(state, norms=result.norms, frozen=result.frozen.without(released))
        return self._changed(state, replace(result.plan, frozen=state.frozen.reasons), "by the pilot")

    def _with_attached_lights(self, state: PlanState, point: GradientProbe, names: Iterable[str]) -> PlanState:
        """Use attached samples for the lights among `names` whose attached gradient is preferred to Mitsuba's."""
        lights = tuple(name for name in names if name in self.setup.attached.lights)
        if not lights:
            return state
        mitsuba = self.base.with_integrator(state.plan, wrt=lights)
        preferred = self.attached.preferred(
            mitsuba, point.params, point.cotangent, names=lights, seed=PILOT_SEED_OFFSET + point.seed
        )
        if not preferred:
            return state
        state = replace(state, attached=state.attached | preferred)
        return self._piloted(self._restarted(state, state.plan.blurred, "by the pilot"), point)

    def _without_vanishing(self, state: PlanState, point: GradientProbe) -> PlanState:
        """Blur parameters whose attached gradient is exactly 0.

        A noisy attached gradient is kept: a blurred gradient has ten times the noise.
        """
        names = tuple(name for name in state.plan.attached if name in self.setup.unsupported)
        vanishing = self.attached.vanishing(
            point.params, point.cotangent, names=names, seed=PILOT_SEED_OFFSET + point.seed
        )
        if not vanishing:
            return state
        glass = {name: shape for name, shape in self.setup.attached.glass.items() if name in vanishing}
        state = replace(self._hiding(state, glass, point), attached=state.attached - vanishing)
        return self._restarted(state)

    def _with_blurred_noise(self, state: PlanState, point: GradientProbe) -> PlanState:
        """Blur frozen parameters whose blurred gradient is significant."""
        significant = self._blurring(state.renderer).significant(point, state.frozen)
        if not significant:
            return state
        shapes = {name: shape for name, shape in state.traits.moving.items() if name in significant}
        state = self._hiding(state, shapes, point)
        return self._piloted(self._restarted(state, {**state.plan.blurred, **significant}, "by the pilot"), point)

    def _unblurred(self, state: PlanState, point: GradientProbe, when: str) -> PlanState:
        """Stop blurring parameters that were blurred for their noise and have a significant gradient now."""
        noisy = state.plan.blurred.keys() - self.setup.unsupported.keys()
        if not noisy:
            return state
        # With all other parameters, as in a step, because they share samples.
        targets = {name: target for name, target in self.base.targets.items() if name in noisy or name in state.names}
        traits = self._traits_of(targets)
        rules = settings_of(plan_by_rules(traits, self.samples))
        draws = replace(point, names=tuple(targets)).gradients(rules, range(point.seed, point.seed + MAX_DRAWS))
        groups = group_by_shape([name for name in targets if name in noisy], traits.moving)
        released = frozenset(noisy) - Frozen.of(draws, groups).reasons.keys()
        if not released:
            return state
        blurred = {name: reason for name, reason in state.plan.blurred.items() if name not in released}
        hidden = {name: shape for name, shape in state.hidden.items() if name not in released}
        return self._piloted(self._restarted(replace(state, hidden=hidden), blurred, when), point, released)

    def _hiding(self, state: PlanState, shapes: Mapping[str, Any], point: GradientProbe) -> PlanState:
        """Remember shapes that are out of view, to look for them in later steps."""
        visible = self._visible(shapes, point)
        hidden = {name: shape for name, shape in shapes.items() if name not in visible}
        return replace(state, hidden={**state.hidden, **hidden})

    def _visible(self, shapes: Mapping[str, Any], point: GradientProbe) -> frozenset[str]:
        """Return the parameters whose shape may be in view."""
        if not shapes:
            return frozenset()
        self.base.set_parameters(point.params)
        frustum = Frustum(self.base.sensor)
        return frozenset(name for name, shape in shapes.items() if frustum.overlaps(shape))

    def _released(self, state: PlanState, grown: Mapping[Effect, str], when: str) -> PlanState:
        """Turn effects on, and release parameters that are no longer frozen."""
        if not grown and len(state.frozen.reasons) == len(state.plan.frozen):
            return state
        plan = plan_with(state.traits, state.plan, settings_of(state.rules), grown)
        return self._changed(state, replace(plan, frozen=state.frozen.reasons), when)

    def _changed(self, state: PlanState, plan: EffectPlan, when: str) -> PlanState:
        """Return the state with another plan, and log the changes."""
        changes = plan.changes_from(state.plan)
        if changes:
            log.info("effects, %s: %s", when, changes)
        renderer = self.base.with_integrator(plan, wrt=state.names)
        blurred = None if state.blurred is None else state.blurred.with_renderer(PlannedImages(renderer))
        return replace(state, plan=plan, renderer=renderer, blurred=blurred)

    def _restarted(self, state: PlanState, blurred: Mapping[str, str] = NOTHING, when: str = "") -> PlanState:
        """Start again from the rules, with the unsupported parameters and those in `blurred` blurred; log if `when`."""
        fields = self._fields_by_rules(state.optimised, state.attached, blurred, state.blurred)
        restarted = replace(state, **fields)
        if when:
            log.info("effects, %s: %s", when, restarted.plan.changes_from(state.plan))
        return restarted

    def _fields_by_rules(
        self,
        optimised: tuple[str, ...],
        attached: frozenset[str],
        blurred: Mapping[str, str],
        previous: BlurredRenderer | None,
    ) -> dict[str, Any]:
        """Return the fields of a state that the rules decide."""
        attached_reasons = {
            name: self.setup.attached.reason_of(name) for name in optimised if name in attached and name not in blurred
        }
        unsupported = {
            name: reason
            for name, reason in {**self.setup.unsupported, **blurred}.items()
            if name in optimised and name not in attached_reasons
        }
        excluded = {*unsupported, *attached_reasons}
        targets = {
            name: target for name, target in self.base.targets.items() if name in optimised and name not in excluded
        }
        names = tuple(targets)
        traits = replace(self._traits_of(targets), attached=attached_reasons, blurred=unsupported)
        rules = plan_by_rules(traits, self.samples)
        renderer = self.base.with_integrator(rules, wrt=names)
        if not unsupported:
            blurred_renderer = None
        elif previous is not None and previous.names == tuple(unsupported):  # it knows the step and its units
            blurred_renderer = previous.with_renderer(PlannedImages(renderer))
        else:
            blurred_renderer = self._blurring(renderer).over(unsupported)
        return {
            "names": names,
            "traits": traits,
            "pilot": Pilot(
                traits, self.samples, self.fraction, group_by_unit(targets), group_by_shape(names, traits.moving)
            ),
            "rules": rules,
            "plan": rules,
            "renderer": renderer,
            "blurred": blurred_renderer,
            "frozen": Frozen(),
        }

    def _blurring(self, renderer: MitsubaRenderer) -> Blurring:
        return Blurring(PlannedImages(renderer), self.blur, tuple(self.setup.unsupported))

    def _traits_of(self, targets: Mapping[str, ParameterTarget]) -> Traits:
        traits = traits_of(self.base.names, targets, self.base.sensor)
        substitutions = self.setup.substitutions if traits.moving else {}
        return replace(traits, substitutions=substitutions, has_delta_bsdf=self.setup.has_delta_bsdf)
