"""The planner of a fit: its state, and the events that change the plan."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from loi_core.effects import Effect, EffectPlan, Frozen, GradientNorms, Schedule
from loi_core.errors import ParameterError
from loi_core.renderers.blurred import BlurredRenderer
from loi_core.renderers.contract import Loss
from loi_core.support.arrays import to_numpy
from loi_core.support.wording import listed
from loi_mitsuba.effects.attached_gradient import AttachedGradient
from loi_mitsuba.effects.blurring import Blurring, legal_values
from loi_mitsuba.effects.gradient_draws import PILOT_SEED_OFFSET, GradientProbe
from loi_mitsuba.effects.pilot import MAX_DRAWS, Pilot
from loi_mitsuba.effects.rules import plan_by_rules, plan_with
from loi_mitsuba.effects.setup import PlanSetup
from loi_mitsuba.effects.traits import Traits, group_by_unit, traits_of
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.queries import group_by_shape
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
    groups : tuple of tuple of str
        The parameters in `names`, in groups of one unit.
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
        When the plan is revisited.
    in_view : frozenset of str
        Parameters whose shape has been in view.
    hidden : dict of mi.Shape
        Shapes out of view whose parameters are blurred, because they have no gradient there.
    probe : GradientProbe or None
        Where the gradient was evaluated last.
    started : bool
        Whether the pilot has run.
    """

    optimised: tuple[str, ...]
    attached: frozenset[str]
    names: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
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
    probe: GradientProbe | None = None
    started: bool = False


class Planner:
    """Decides which effects are simulated, and which parameters are attached, blurred or frozen.

    Parameters
    ----------
    setup : PlanSetup
    samples : int
        Samples per pixel of each term of the gradient.
    fraction : float
        Effects that carry less of the gradient are turned off.
    blur : mapping or None
        Options of :class:`loi_core.renderers.BlurredRenderer`; None blurs nothing.

    Attributes
    ----------
    base : MitsubaRenderer
        Renderer of the scene by the rules.
    state : PlanState
        The current state; replaced, never changed.
    """

    def __init__(self, setup: PlanSetup, *, samples: int, fraction: float, blur: Mapping[str, Any] | None) -> None:
        self._setup = setup
        self.base = setup.renderer
        self._samples = samples
        self._fraction = fraction
        self._blur = blur
        self._attached = AttachedGradient(setup.renderer, setup.attached, samples)
        optimised, attached = tuple(self.base.targets), setup.attached.without_gradient
        self.state = PlanState(optimised, attached, **self._fields_by_rules(optimised, attached, NOTHING, None))
        if attached and setup.unsupported:
            self._blurring.over(setup.unsupported)  # checks the options now: these parameters may be blurred later

    @property
    def _blurring(self) -> Blurring:  # not stored: it refers to this planner
        return Blurring(_PlannedImages(self), self._blur, tuple(self._setup.unsupported))

    def begin(self, params: Mapping[str, Any], cotangent: Any, *, optimise: Iterable[str], seed: int) -> EffectPlan:
        """Plan a fit that starts at `params`; see :meth:`loi_mitsuba.PlannedRenderer.begin`."""
        names = tuple(dict.fromkeys(optimise))
        for name in names or ("",):
            if name not in self.base.targets:
                msg = f"`optimise` must name parameters of {', '.join(self.base.targets)}, got {name or 'none'!r}"
                raise ParameterError(msg)
        self._update(optimised=names, hidden={}, attached=self._setup.attached.without_gradient)
        self._restart()
        probe = self._probe_at(params, np.array(to_numpy(cotangent), np.float32), seed)
        self._blur_vanishing(probe)
        probe = self._current_probe(probe)
        self._update(started=True, schedule=Schedule(), in_view=self._visible(self.state.traits.moving))
        self._run_pilot(probe)
        self._attach_lights(probe, self.state.names)
        self._blur_noisy(self._last_probe)
        return self.state.plan

    def attached_vjp(self, params: Mapping[str, Any], cotangent: Any, *, seed: int) -> dict[str, Float32Array]:
        """Return the gradient of the parameters with attached samples."""
        names = self.state.plan.attached
        return self._attached.vjp(params, cotangent, names=names, seed=seed) if names else {}

    def blurred_vjp(
        self, params: Mapping[str, Any], cotangent: Any, *, seed: int, loss: Loss | None
    ) -> dict[str, Float32Array]:
        """Return the gradient of the blurred parameters."""
        blurred = self.state.blurred
        return {} if blurred is None else blurred.vjp(dict(params), cotangent, seed=seed, loss=loss)

    def observe(
        self,
        params: Mapping[str, Any],
        cotangent: Float32Array,
        gradient: Mapping[str, Float32Array],
        *,
        seed: int,
        first: bool,
        frozen: frozenset[str] | None,
    ) -> frozenset[str]:
        """Record a gradient, revisit the plan if it is due, and return the frozen parameters of this gradient.

        Parameters
        ----------
        params, cotangent, gradient, seed
            The gradient and where it was evaluated.
        first : bool
            Whether the pilot ran with this gradient.
        frozen : frozenset of str or None
            The frozen parameters of an earlier gradient of the same image. Its noise is the same, and would seem to
            confirm the gradient, so that it is no evidence for releasing parameters.
        """
        probe = self._probe_at(params, np.array(cotangent, dtype=np.float32), seed)
        self._update(probe=probe, schedule=self.state.schedule.after_gradient())
        if frozen is None:
            if not first:
                self._update(frozen=self.state.frozen.updated(gradient))
                self._release({}, "as gradients agree")
            frozen = frozenset(self.state.frozen.reasons)
        if self.state.schedule.is_due:
            self._revisit("on schedule")
        return frozen

    def at_step(self, step: int, steps: int, value: float | None) -> None:
        """Revisit the plan before a step if the loss has stalled."""
        if self.state.blurred is not None:
            self.state.blurred.at_step(step, steps, value)
        self._update(schedule=self.state.schedule.after_step(value))
        if self.state.schedule.is_stalled:
            self._update(schedule=self.state.schedule.after_stall())
            self._revisit(f"before step {step}, where the loss stalls")

    def check_visibility(self) -> None:
        """When a shape comes into view, sample its silhouette and release the parameters that move it.

        A parameter that was blurred because its gradient was noise has a gradient of its own then; the next gradient
        starts a new pilot.
        """
        state = self.state
        if not state.started:
            return
        revealed = self._visible(state.hidden)
        if revealed:
            self._update(hidden={name: shape for name, shape in state.hidden.items() if name not in revealed})
            blurred = {name: reason for name, reason in state.plan.blurred.items() if name not in revealed}
            self._restart_and_log(blurred, "as it comes into view")
            self._update(started=False)
            return
        missing = settings_of(state.rules).sppp > 0 and settings_of(state.plan).sppp == 0
        if not (missing or state.frozen.groups):
            return
        revealed = self._visible(state.traits.moving) - state.in_view
        if not revealed:
            return
        self._update(in_view=state.in_view | revealed, frozen=state.frozen.without(revealed))
        reason = f"a shape that {listed(sorted(revealed))} moves has come into view"
        self._release({Effect.PRIMARY: reason} if missing else {}, "as it comes into view")

    def _revisit(self, when: str) -> None:
        """Test again whether effects that are off, and parameters that are blurred or frozen, should stay so."""
        self._update(schedule=self.state.schedule.after_probe())
        if self.state.probe is None:
            return
        self._unblur(self.state.probe, when)
        if not self.state.names or not self.state.plan.understood or not self.state.plan.measured:
            return
        if self.state.frozen.groups:
            self._attach_lights(self._last_probe, self.state.frozen.reasons)
            self._blur_noisy(self._last_probe)
        if not self.state.names:
            return
        rules = settings_of(self.state.rules)
        grown = self.state.pilot.grown(rules, self.state.plan, self._last_probe, self.state.norms)
        self._release(grown, when)

    def _run_pilot(self, probe: GradientProbe, released: frozenset[str] = frozenset()) -> None:
        """Run the pilot, and freeze the parameters whose gradient is noise, except the `released` ones."""
        if self.state.names:
            result = self.state.pilot.run(self.state.plan, probe)
            self._update(norms=result.norms, frozen=result.frozen.without(released))
            self._change(replace(result.plan, frozen=self.state.frozen.reasons), "by the pilot")

    def _attach_lights(self, probe: GradientProbe, names: Iterable[str]) -> None:
        """Use attached samples for the lights among `names` whose attached gradient is preferred to Mitsuba's."""
        lights = tuple(name for name in names if name in self._setup.attached.lights)
        if not lights:
            return
        mitsuba = self.base.with_integrator(self.state.plan, wrt=lights)
        preferred = self._attached.preferred(
            mitsuba, probe.params, probe.cotangent, names=lights, seed=PILOT_SEED_OFFSET + probe.seed
        )
        if preferred:
            self._update(attached=self.state.attached | preferred)
            self._restart_and_log(self.state.plan.blurred, "by the pilot")
            self._run_pilot(self._current_probe(probe))

    def _blur_vanishing(self, probe: GradientProbe) -> None:
        """Blur parameters whose attached gradient is exactly 0.

        A noisy attached gradient is kept: a blurred gradient has ten times the noise.
        """
        names = tuple(name for name in self.state.plan.attached if name in self._setup.unsupported)
        vanishing = self._attached.vanishing(
            probe.params, probe.cotangent, names=names, seed=PILOT_SEED_OFFSET + probe.seed
        )
        if not vanishing:
            return
        glass = {name: shape for name, shape in self._setup.attached.glass.items() if name in vanishing}
        self._hide(glass)
        self._update(attached=self.state.attached - vanishing)
        self._restart()

    def _blur_noisy(self, probe: GradientProbe) -> None:
        """Blur frozen parameters whose blurred gradient is significant."""
        significant = self._blurring.significant(probe, self.state.frozen)
        if significant:
            self._hide({name: shape for name, shape in self.state.traits.moving.items() if name in significant})
            self._restart_and_log({**self.state.plan.blurred, **significant}, "by the pilot")
            self._run_pilot(self._current_probe(probe))

    def _unblur(self, probe: GradientProbe, when: str) -> None:
        """Stop blurring parameters that were blurred for their noise and have a significant gradient now."""
        noisy = self.state.plan.blurred.keys() - self._setup.unsupported.keys()
        if not noisy:
            return
        # With all other parameters, as in a step, because they share samples.
        targets = {
            name: target for name, target in self.base.targets.items() if name in noisy or name in self.state.names
        }
        traits = self._traits_of(targets)
        rules = settings_of(plan_by_rules(traits, self._samples))
        draws = replace(probe, names=tuple(targets)).gradients(rules, range(probe.seed, probe.seed + MAX_DRAWS))
        groups = group_by_shape([name for name in targets if name in noisy], traits.moving)
        released = frozenset(noisy) - Frozen.of(draws, groups).reasons.keys()
        if not released:
            return
        self._update(hidden={name: shape for name, shape in self.state.hidden.items() if name not in released})
        blurred = {name: reason for name, reason in self.state.plan.blurred.items() if name not in released}
        self._restart_and_log(blurred, when)
        self._run_pilot(self._current_probe(probe), released)

    def _hide(self, shapes: Mapping[str, Any]) -> None:
        """Remember shapes that are out of view, to look for them in later images."""
        visible = self._visible(shapes)
        hidden = {name: shape for name, shape in shapes.items() if name not in visible}
        self._update(hidden={**self.state.hidden, **hidden})

    def _visible(self, shapes: Mapping[str, Any]) -> frozenset[str]:
        """Return the parameters whose shape may be in view at the scene's current values."""
        if not shapes:
            return frozenset()
        frustum = Frustum(self.base.sensor)
        return frozenset(name for name, shape in shapes.items() if frustum.overlaps(shape))

    def _release(self, grown: Mapping[Effect, str], when: str) -> None:
        """Turn effects on, and release parameters that are no longer frozen."""
        state = self.state
        if not grown and len(state.frozen.reasons) == len(state.plan.frozen):
            return
        plan = plan_with(state.traits, state.plan, settings_of(state.rules), grown)
        self._change(replace(plan, frozen=state.frozen.reasons), when)

    def _change(self, plan: EffectPlan, when: str) -> None:
        changes = plan.changes_from(self.state.plan)
        if changes:
            log.info("effects, %s: %s", when, changes)
        self._update(plan=plan, renderer=self.base.with_integrator(plan, wrt=self.state.names))

    def _restart_and_log(self, blurred: Mapping[str, str], when: str) -> None:
        previous = self.state.plan
        self._restart(blurred)
        log.info("effects, %s: %s", when, self.state.plan.changes_from(previous))

    def _restart(self, blurred: Mapping[str, str] = NOTHING) -> None:
        """Start again from the rules, with the unsupported parameters and those in `blurred` blurred."""
        state = self.state
        self._update(**self._fields_by_rules(state.optimised, state.attached, blurred, state.blurred))

    def _fields_by_rules(
        self,
        optimised: tuple[str, ...],
        attached: frozenset[str],
        blurred: Mapping[str, str],
        blurred_renderer: BlurredRenderer | None,
    ) -> dict[str, Any]:
        """Return the fields of a state that the rules decide."""
        attached_reasons = {
            name: self._setup.attached.reason_of(name) for name in optimised if name in attached and name not in blurred
        }
        unsupported = {
            name: reason
            for name, reason in {**self._setup.unsupported, **blurred}.items()
            if name in optimised and name not in attached_reasons
        }
        excluded = {*unsupported, *attached_reasons}
        targets = {
            name: target for name, target in self.base.targets.items() if name in optimised and name not in excluded
        }
        names, groups = tuple(targets), group_by_unit(targets)
        traits = replace(self._traits_of(targets), attached=attached_reasons, blurred=unsupported)
        rules = plan_by_rules(traits, self._samples)
        if not unsupported:
            blurred_renderer = None
        elif blurred_renderer is None or blurred_renderer.names != tuple(unsupported):  # otherwise it knows the step
            blurred_renderer = self._blurring.over(unsupported)
        return {
            "names": names,
            "groups": groups,
            "traits": traits,
            "pilot": Pilot(traits, self._samples, self._fraction, groups, group_by_shape(names, traits.moving)),
            "rules": rules,
            "plan": rules,
            "renderer": self.base.with_integrator(rules, wrt=names),
            "blurred": blurred_renderer,
            "frozen": Frozen(),
        }

    def _traits_of(self, targets: Mapping[str, ParameterTarget]) -> Traits:
        traits = traits_of(self.base.names, targets, self.base.sensor)
        substitutions = self._setup.substitutions if traits.moving else {}
        return replace(traits, substitutions=substitutions, has_delta_bsdf=self._setup.has_delta_bsdf)

    def _probe_at(self, params: Mapping[str, Any], cotangent: Float32Array, seed: int) -> GradientProbe:
        return GradientProbe(self.base, dict(params), cotangent, self.state.names, seed)

    def _current_probe(self, probe: GradientProbe) -> GradientProbe:
        """Store and return the probe for the parameters whose gradient is Mitsuba's now."""
        probe = replace(probe, names=self.state.names)
        self._update(probe=probe)
        return probe

    @property
    def _last_probe(self) -> GradientProbe:
        probe = self.state.probe
        assert probe is not None  # noqa: S101  # stored before any change of a plan
        return probe

    def _update(self, **changes: Any) -> None:
        self.state = replace(self.state, **changes)


@dataclass(frozen=True)
class _PlannedImages:
    """The images under the current plan, for blurred gradients."""

    planner: Planner

    def parameters(self) -> dict[str, Float32Array]:
        return self.planner.base.parameters()

    def render(self, params: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        return self.planner.state.renderer.render(legal_values(params, self.planner.base.targets), seed=seed)

    def render_vjp(self, params: Mapping[str, Any], *, seed: int = 0) -> Any:
        return self.planner.state.renderer.render_vjp(params, seed=seed)
