"""A Mitsuba scene as a renderer that simulates only the effects that the loss at hand calls for."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.effects import Effect, EffectPlan, Holding, Schedule, Sizes
from loi_core.errors import OptionError, ParameterError
from loi_core.fitting.loop import FitStep
from loi_core.objectives.base import Objective
from loi_core.pixels.encoding import Encoding
from loi_core.support.arrays import to_numpy
from loi_core.support.values import real_number
from loi_core.support.wording import shown
from loi_mitsuba.effects.images import effect_images
from loi_mitsuba.effects.pilot import Pilot
from loi_mitsuba.effects.probe import Probe
from loi_mitsuba.effects.rules import everything, plan_by_rules, plan_of, plan_with
from loi_mitsuba.effects.traits import groups_of, in_view, objects_of, traits_of
from loi_mitsuba.effects.verify import Verification, verification
from loi_mitsuba.entries import Names, Scene, named_scene
from loi_mitsuba.handles import Host
from loi_mitsuba.integrators import bordered, settings_of
from loi_mitsuba.loading import (
    Target,
    checked_samples,
    checked_targets,
    find_sensor,
    most_samples,
    use_variant,
)
from loi_mitsuba.neighbour import Found, Neighbour, Surroundings, neighbour_of
from loi_mitsuba.neighboured import NeighbouredRenderer, exchanged_targets, targets_of_lights
from loi_mitsuba.renderer import MitsubaRenderer

__all__ = ["FRACTION", "PlannedRenderer"]

FRACTION: Final = 0.1  # what is off together turns the gradient by less than 6 degrees, whose cosine is 0.995
log = logging.getLogger("loi_mitsuba")


class PlannedRenderer:
    """A Mitsuba scene that is rendered by a plan; keeps the contract of :class:`loi_core.Renderer`.

    It begins with what sound rules say. The first gradient that is asked of it is also the first of a pilot, which
    turns off what carries less than a fraction of it. What was turned off is looked at again after 20 gradients, then
    40, 80 and so on, at once when a shape that moves comes into view, and when a loss that it watches stalls; what
    appears or grows goes on and stays on.

    Objects whose gradient the pilot cannot tell from noise are held: the gradient by their parameters is 0, so that a
    fit leaves them where they are, until the gradients of further steps agree, or the object comes into view; see
    :class:`loi_core.effects.Holding`. A change is logged in one line, at level INFO of the logger ``loi_mitsuba``.

    Parameters
    ----------
    scene, parameters, sensor
        As those of :class:`MitsubaRenderer`.
    spp : int
        Samples per pixel of the image, and of each part of the gradient before time is shared out among them.
    fraction : float
        What is turned off carries together less than this fraction of the gradient, for every optimised parameter, and
        a tenth of it of the image; at 0 only what is exactly 0 goes off. At least 0 and less than 1.
    neighbour : Neighbour, table or None
        How far the scene may be from the one from which the gradient by what moves is taken, where Mitsuba has none in
        the scene itself: under point, spot and directional lights, in perfect mirrors and clear glass. None takes all
        gradients from the scene as it is, which the image always is of.

    Notes
    -----
    When the depth of paths changes, so does the image, by less than the fraction. Times decide how samples are shared
    out, so that two runs may differ by noise; a plan, given to :class:`MitsubaRenderer` as its integrator, is fixed.

    Raises
    ------
    SceneLoadError, ParameterError, OptionError
        As :class:`MitsubaRenderer`.
    """

    def __init__(
        self,
        scene: dict[str, Any] | str | Path | Scene,
        parameters: Mapping[str, Target | Mapping[str, Any]],
        *,
        spp: int = 16,
        fraction: float = FRACTION,
        sensor: int = 0,
        neighbour: Neighbour | Mapping[str, float] | None = Neighbour(),  # noqa: B008 - frozen
    ) -> None:
        if not 0.0 <= real_number(fraction) < 1.0:
            msg = f"`fraction` must be at least 0 and less than 1, got {shown(fraction)}"
            raise OptionError(msg)
        self._fraction = real_number(fraction)
        self._base, self._exchanged, self._smooth = _base(scene, parameters, sensor, spp, Neighbour.of(neighbour))
        self._samples = int(spp)
        self._begun = False
        self._schedule = Schedule()
        self._last: Probe | None = None
        self._sizes: Sizes = {}
        self._holding = Holding()
        self._seen: frozenset[str] = frozenset()
        self._take(tuple(self._base.targets))

    @property
    def encoding(self) -> Encoding:
        """What Mitsuba renders is radiance, "linear"."""
        return "linear"

    @property
    def plan(self) -> EffectPlan:
        """What is simulated now."""
        return self._plan

    @property
    def everything(self) -> EffectPlan:
        """Every effect that Mitsuba has the gradient of, without guiding: what :meth:`verify` compares with."""
        return plan_of(self._traits, everything(self._traits, self._samples))

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The optimised parameters, those together whose gradients have one unit."""
        return self._groups

    @property
    def scene(self) -> Any:
        """The scene, an ``mi.Scene``; its parameters are those of the last call."""
        return self._base.scene

    def parameters(self) -> dict[str, Host]:
        """Every parameter as the scene had it when it was loaded; see :class:`MitsubaRenderer`."""
        return self._base.parameters()

    def render(self, params: Mapping[str, Any], *, seed: int = 0) -> Host:
        """The image, shape (H, W, C), float32; see :class:`MitsubaRenderer`."""
        return self._current.render(params, seed=seed)

    def render_vjp(self, params: Mapping[str, Any], *, seed: int = 0) -> tuple[Host, Callable[[Any], dict[str, Host]]]:
        """The image and its pullback; see :class:`MitsubaRenderer`.

        The pullback keeps the plan of its image. The gradient of what is held is 0.
        """
        image = self._current.render(params, seed=seed)
        self._look()
        current = self._current  # that of the pullback also after the plan has changed
        kept = {name: np.array(value, dtype=np.float32) for name, value in params.items()}
        held: frozenset[str] | None = None

        def counted(cotangent: Any) -> dict[str, Host]:
            nonlocal held
            pulled = current.pull(kept, cotangent, seed=seed)
            self._last = Probe(self._base, kept, np.array(cotangent, dtype=np.float32), self._names, seed)
            self._schedule = self._schedule.counted()
            if not self._begun:
                self.begin(kept, cotangent, optimise=self._names, seed=seed)
            elif held is None:  # a second gradient of one image has the same noise, and would agree with it
                self._holding = self._holding.seen(pulled)
                self._raise({}, "as gradients agree")
            if held is None:
                held = frozenset(self._holding.reasons)
            if self._schedule.is_due:
                self._probe("on schedule")
            return pulled | {name: np.zeros_like(pulled[name]) for name in held}

        return image, counted

    def begin(self, params: Mapping[str, Any], cotangent: Any, *, optimise: Iterable[str], seed: int = 0) -> EffectPlan:
        """Plan a fit that starts at `params`, where the loss has the gradient `cotangent`, shape (H, W, C).

        From now on only the parameters named in `optimise` have a gradient; that of the others is 0, and so is that of
        those which the plan holds, until it lets them go.

        Raises
        ------
        ParameterError
            If `optimise` names none, or one that is not there.
        """
        names = tuple(dict.fromkeys(optimise))
        for name in names or ("",):
            if name not in self._base.targets:
                msg = f"`optimise` must name parameters of {', '.join(self._base.targets)}, got {name or 'none'!r}"
                raise ParameterError(msg)
        self._take(names)
        self._last = Probe(self._base, dict(params), np.array(to_numpy(cotangent), np.float32), names, seed)
        self._begun = True
        self._schedule = Schedule()
        found = self._pilot.run(self._plan, self._last)
        self._sizes, self._holding = found.sizes, found.holding
        self._seen = self._in_view()
        self._change(found.plan, "by the pilot")
        return self._plan

    def watch(self, step: FitStep, params: Mapping[str, Any], image: Any) -> None:  # noqa: ARG002 - a callback's
        """A callback for :func:`loi_core.fit`: looks again at what is off when the loss stalls.

        That is when it has reached no new least value for 20 steps, then for 40 more, 80 more and so on.
        """
        self._schedule = self._schedule.watched(step.value)
        if self._schedule.stalls:
            self._schedule = self._schedule.waited()
            self._probe(f"at step {step.step}, where the loss stalls")

    @property
    def unabridged(self) -> MitsubaRenderer:
        """The same scene with every effect on, by which the outcome of a fit is judged."""
        return self._base.with_integrator(self.everything, follow=self._names)

    def verify(
        self, objective: Objective, params: Mapping[str, Any] | None = None, *, draws: int = 16, seed: int = 0
    ) -> Verification:
        """The plan beside everything on, without guiding: time of a step, and the gradient of the loss.

        Parameters
        ----------
        objective : Objective
            The loss.
        params : dict of arrays, optional
            Where; the scene's own by default.
        draws : int
            Gradients of each, 3 or more.
        seed : int
            First seed; the two use others.
        """
        return verification(
            self._current,
            self._base.with_integrator(self.everything, follow=self._names),
            objective,
            self.parameters() if params is None else dict(params),
            self._groups,
            draws=draws,
            seed=seed,
        )

    def effect_images(self, params: Mapping[str, Any], cotangent: Any, *, seed: int = 0) -> dict[str, Host]:
        """By effect, how its part of the image changes along the descent of the loss: arrays (H, W, C).

        Effects that a pilot has turned off are among them, those that the rules exclude are not. Empty where Mitsuba
        has no derivative of images, as in media, or the gradient is 0.
        """
        return effect_images(
            self._base, self._rules, self._names, 4 * self._samples, params, to_numpy(cotangent), seed=seed
        )

    def _take(self, names: tuple[str, ...]) -> None:
        """Start from the rules for these parameters."""
        targets = {name: target for name, target in self._base.targets.items() if name in names}
        self._names = tuple(targets)
        self._groups = groups_of(targets)
        traits = traits_of(self._base.names, targets, self._base.sensor)
        self._traits = replace(traits, exchanged=self._exchanged if traits.moving else {}, smooth=self._smooth)
        objects = objects_of(targets, self._traits.moving)
        self._pilot = Pilot(self._traits, self._samples, self._fraction, self._groups, objects)
        self._holding = Holding()
        self._rules = plan_by_rules(self._traits, self._samples)
        self._set(self._rules)

    def _in_view(self) -> frozenset[str]:
        """Parameters whose shape may be in view, at the values of the last call."""
        return frozenset(name for name, shape in self._traits.moving.items() if in_view(self._base.sensor, shape))

    def _look(self) -> None:
        """When a shape comes into view, sample outlines if that had been turned off, and let go what moves it."""
        missing = settings_of(self._rules).sppp > 0 and settings_of(self._plan).sppp == 0
        if not self._begun or not (missing or self._holding.groups):
            return
        fresh = self._in_view() - self._seen
        if not fresh:
            return
        self._seen |= fresh
        self._holding = self._holding.without(fresh)
        reason = f"what {', '.join(map(repr, sorted(fresh)))} moves has come into view"
        self._raise({Effect.PRIMARY: reason} if missing else {}, "as it comes into view")

    def _probe(self, when: str) -> None:
        """Look again at what is off."""
        self._schedule = self._schedule.looked()
        if self._last is None or not self._plan.understood or not self._plan.measured:
            return
        grown = self._pilot.grown(settings_of(self._rules), self._plan, self._last, self._sizes)
        self._raise(grown, when)

    def _raise(self, grown: Mapping[Effect, str], when: str) -> None:
        """Turn effects on, and let go what is no longer held."""
        if not grown and len(self._holding.reasons) == len(self._plan.held):
            return
        plan = plan_with(self._traits, self._plan, settings_of(self._rules), grown)
        self._change(replace(plan, held=self._holding.reasons), when)

    def _set(self, plan: EffectPlan) -> None:
        self._plan = plan
        self._current = self._base.with_integrator(plan, follow=self._names)

    def _change(self, plan: EffectPlan, when: str) -> None:
        changes = plan.changes_from(self._plan)
        if changes:
            log.info("effects, %s: %s", when, changes)
        self._set(plan)


def _base(
    scene: Any, parameters: Any, sensor: int, spp: Any, near: Neighbour
) -> tuple[MitsubaRenderer, dict[str, str], bool]:
    """The scene by the rules' plan, with its neighbour where what moves calls for one.

    Also what that has exchanged, and whether surfaces are left that are perfectly smooth. The film samples its border
    if need be. The plan comes first, so that warnings of missing gradients are about its integrator.
    """
    use_variant()
    targets = checked_targets(parameters)
    names = named_scene(scene, targets)
    found = find_sensor(names.scene, sensor)
    samples = checked_samples("spp", spp, most_samples(found.film()))
    traits = traits_of(names, targets, found)
    plan = plan_by_rules(traits, samples)
    ready = bordered(scene, plan)
    if ready is not scene:
        names = named_scene(ready, targets)
    options: dict[str, Any] = {"integrator": plan, "spp": spp, "sensor": sensor}
    if traits.moving and not traits.media and (traits.lights or traits.delta_reflection or traits.delta_transmission):
        for size in (near, replace(near, mirrors=0.0)):  # rough surfaces may lack what a parameter stands for
            try:
                pair = _neighboured(ready, names, targets, traits.moving, size, options)
            except ParameterError:
                continue
            if pair is None:
                break
            base, near_scene = pair
            return base, {one.what: one.reason for one in near_scene.exchanges}, near_scene.smooth
    return MitsubaRenderer(names.loaded, targets, **options), {}, True


def _neighboured(
    scene: Any,
    called: Names,
    targets: Mapping[str, Target],
    moving: Mapping[str, Any],
    near: Neighbour,
    options: dict[str, Any],
) -> tuple[NeighbouredRenderer, Found] | None:
    """A scene and its neighbour, if there is something to exchange."""
    loaded = called.loaded
    lights = targets_of_lights(called, targets)
    stay = [number for number, entry in lights.values() if entry not in ("intensity.value", "irradiance.value")]
    around = Surroundings.of(loaded.scene, moving.values(), stay)
    sensor = find_sensor(loaded.scene, options["sensor"])
    found = neighbour_of(scene, near, around, lambda shape: in_view(sensor, shape), floats=loaded.floats)
    if found is None:
        return None
    exchanged = exchanged_targets(lights, found, called)
    base = NeighbouredRenderer(loaded, targets, neighbour=found.loaded, moving=moving, exchanged=exchanged, **options)
    return base, found
