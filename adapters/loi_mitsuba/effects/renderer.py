"""A Mitsuba scene as a renderer that simulates only the effects that the loss at hand calls for."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from loi_core.effects import Effect, EffectPlan, Holding, Schedule, Sizes
from loi_core.errors import OptionError, ParameterError
from loi_core.objectives.base import Objective
from loi_core.renderers.blurred import BLUR_KEYS, BlurredRenderer
from loi_core.renderers.contract import Loss, LossPullback, RendererCapabilities
from loi_core.support.arrays import to_numpy
from loi_core.support.values import real_number
from loi_core.support.wording import clause, listed, shown
from loi_mitsuba.attached.gradient import AttachedGradient
from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.effects.blurring import Blurring
from loi_mitsuba.effects.effect_images import effect_images
from loi_mitsuba.effects.gradient_draws import APART, Probe
from loi_mitsuba.effects.pilot import MOST_DRAWS, Pilot
from loi_mitsuba.effects.rules import everything, plan_by_rules, plan_of, plan_with
from loi_mitsuba.effects.setup import prepare_renderer
from loi_mitsuba.effects.traits import Traits, group_by_unit, traits_of
from loi_mitsuba.effects.verify import Verification, verification
from loi_mitsuba.proxy.scene import ProxySettings
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.binding import host_numbers
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import Scene
from loi_mitsuba.scene.queries import group_by_shape
from loi_mitsuba.scene.settings import settings_of
from loi_mitsuba.sensing.frustum import Frustum

__all__ = ["FRACTION", "PlannedRenderer"]

FRACTION: Final = 0.1  # what is off together turns the gradient by less than 6 degrees, whose cosine is 0.995
log = logging.getLogger("loi_mitsuba")


class PlannedRenderer:
    """A Mitsuba scene that is rendered by a plan; keeps the contract of :class:`loi_core.Renderer`.

    It begins with what sound rules say. The first gradient that is asked of it is also the first of a pilot, which
    turns off what carries less than a fraction of it. What was turned off is looked at again after 20 gradients, then
    40, 80 and so on, at once when a shape that moves comes into view, and when the loss of a fit stalls; what
    appears or grows goes on and stays on.

    Objects whose gradient the pilot cannot tell from noise are blurred, if that of images blurred over their parameters
    can be told from it. Others are held: the gradient by their parameters is 0, so that a fit leaves them where they
    are, until the gradients of further steps agree; see ``loi_core.effects.Holding``. Either ends when the object comes
    into view, and blurring also once the object's own gradient can be told from noise, which is looked up whenever what
    was turned off is. A change is logged in one line, at level INFO of the logger ``loi_mitsuba``.

    Parameters
    ----------
    scene, parameters, sensor
        As those of :class:`MitsubaRenderer`.
    spp : int
        Samples per pixel of the image, and of each part of the gradient before time is shared out among them.
    fraction : float
        What is turned off carries together less than this fraction of the gradient, for every optimised parameter, and
        a tenth of it of the image; at 0 only what is exactly 0 goes off. At least 0 and less than 1.
    proxy : ProxySettings, table or None
        How far the scene may be from the one from which the gradient by what moves is taken, where Mitsuba has none in
        the scene itself: under point, spot and directional lights, in perfect mirrors and clear glass, by textures with
        steps. None takes all gradients from the scene as it is, which the image always is of.
    blur : table or None
        How the parameters are blurred that have no gradient there either, such as cameras and what moves clear glass,
        or nothing but noise; the plan lists them. The keys are the options of
        :class:`loi_core.renderers.BlurredRenderer`, with 4 `pairs` by default; `names` blurs these parameters and no
        others. None blurs nothing: such parameters are refused, or their gradient is what Mitsuba makes of it.
    attached_lights : bool
        Whether the gradient by lights that move is of samples that move with them, for shapes that emit, points and
        spots, where Mitsuba's own has nothing more that is not noise. The plan lists them.
    attached_glass : bool
        Whether the gradient by clear glass that moves, balls and smooth meshes, is of light and views that are followed
        through it. The plan lists it.

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
        parameters: Mapping[str, ParameterTarget | Mapping[str, Any]],
        *,
        spp: int = 16,
        fraction: float = FRACTION,
        sensor: int = 0,
        proxy: ProxySettings | Mapping[str, float] | None = ProxySettings(),  # noqa: B008 - frozen
        blur: Mapping[str, Any] | None = MappingProxyType({}),
        attached_lights: bool = True,
        attached_glass: bool = True,
    ) -> None:
        if not 0.0 <= real_number(fraction) < 1.0:
            msg = f"`fraction` must be at least 0 and less than 1, got {shown(fraction)}"
            raise OptionError(msg)
        self._fraction = real_number(fraction)
        if blur is not None and (not isinstance(blur, Mapping) or set(blur) - set(BLUR_KEYS)):
            msg = f"`blur` must be None, or a table of {', '.join(BLUR_KEYS)}, got {shown(blur)}"
            raise OptionError(msg)
        for option, value in (("attached_lights", attached_lights), ("attached_glass", attached_glass)):
            if not isinstance(value, bool):
                msg = f"`{option}` must be true or false, got {shown(value)}"
                raise OptionError(msg)
        self._blur = blur
        self._whole = prepare_renderer(
            scene,
            parameters,
            sensor,
            spp,
            ProxySettings.of(proxy),
            blur,
            attached_lights=attached_lights,
            attached_glass=attached_glass,
        )
        self._base = self._whole.renderer
        self._blurred: BlurredRenderer | None = None
        self._samples = int(spp)
        self._following = AttachedGradient(self._base, self._whole.followed, self._samples)
        self._followed = self._whole.followed.without_gradient  # whose gradient is of samples that move with them
        self._begun = False
        self._schedule = Schedule()
        self._last: Probe | None = None
        self._sizes: Sizes = {}
        self._holding = Holding()
        self._seen: frozenset[str] = frozenset()
        self._hidden: dict[str, Any] = {}  # shapes out of view, moved by what is blurred since it has no gradient there
        self._optimised = tuple(self._base.targets)
        self._take(self._optimised)
        if self._followed and self._whole.missing:
            self._blurring.over(self._whole.missing)  # checked now: what is followed may turn out to be blurred later

    @property
    def capabilities(self) -> RendererCapabilities:
        """The image is radiance, the gradient depends on the loss and the step, and the effects are planned."""
        return RendererCapabilities(
            at_step=self.at_step,
            render_loss_vjp=self.render_loss_vjp,
            unabridged=lambda: self.unabridged,
            encoding="linear",
            planner=self,
        )

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
        """The optimised parameters whose gradient is Mitsuba's, those together whose gradients have one unit."""
        return self._groups

    @property
    def targets(self) -> dict[str, ParameterTarget]:
        """What each parameter stands for."""
        return self._base.targets

    @property
    def scene(self) -> Any:
        """The scene, an ``mi.Scene``; its parameters are those of the last call."""
        return self._base.scene

    def parameters(self) -> dict[str, Float32Array]:
        """Every parameter as the scene had it when it was loaded; see :class:`MitsubaRenderer`."""
        return self._base.parameters()

    def render(self, params: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        """The image, shape (H, W, C), float32; see :class:`MitsubaRenderer`."""
        return self._current.render(params, seed=seed)

    def render_vjp(
        self, params: Mapping[str, Any], *, seed: int = 0
    ) -> tuple[Float32Array, Callable[[Any], dict[str, Float32Array]]]:
        """The image and its pullback; see :class:`MitsubaRenderer`.

        The pullback keeps the plan of its image. The gradient of what is held is 0.
        """
        image, pullback = self.render_loss_vjp(params, seed=seed)
        return image, partial(pullback, None)

    def render_loss_vjp(self, params: Mapping[str, Any], *, seed: int = 0) -> tuple[Float32Array, LossPullback]:
        """The same, with a pullback that takes the loss, or None, and the cotangent: blurred gradients may use it."""
        image = self._current.render(params, seed=seed)
        self._look()
        current = self._current  # that of the pullback also after the plan has changed
        kept = {name: np.array(value, dtype=np.float32) for name, value in params.items()}
        held: frozenset[str] | None = None

        def counted(loss: Loss | None, given: Any) -> dict[str, Float32Array]:
            nonlocal held
            cotangent = host_numbers("cotangent", given, image.shape)
            pulled = current.vjp(kept, cotangent, seed=seed)
            begins = not self._begun
            if begins:
                self.begin(kept, cotangent, optimise=self._optimised, seed=seed)
            if self._plan.followed:
                pulled |= self._following.vjp(kept, cotangent, names=self._plan.followed, seed=seed)
            if self._blurred is not None:
                pulled |= self._blurred.vjp(kept, cotangent, seed=seed, loss=loss)
            self._last = Probe(self._base, kept, np.array(cotangent, dtype=np.float32), self._names, seed)
            self._schedule = self._schedule.counted()
            if not begins and held is None:  # a second gradient of one image has the same noise, and would agree
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
        self._optimised = names
        self._hidden = {}
        self._followed = self._whole.followed.without_gradient
        self._take(names)
        probe = Probe(self._base, dict(params), np.array(to_numpy(cotangent), np.float32), self._names, seed)
        self._blur_silent(probe)
        self._last = replace(probe, names=self._names)
        self._begun = True
        self._schedule = Schedule()
        self._seen = self._in_view()
        self._run_pilot(self._last)
        self._follow_lamps(self._last, self._names)
        self._blur_noise(self._last)
        return self._plan

    @property
    def _blurring(self) -> Blurring:  # not kept: it refers back to this renderer
        return Blurring(self, self._blur, tuple(self._whole.missing))

    def _run_pilot(self, probe: Probe, free: frozenset[str] = frozenset()) -> None:
        """Plan by a few gradients; what is `free` is not held, as others have told it from noise."""
        if self._names:
            found = self._pilot.run(self._plan, probe)
            self._sizes, self._holding = found.sizes, found.holding.without(free)
            self._change(replace(found.plan, held=self._holding.reasons), "by the pilot")

    def _follow_lamps(self, probe: Probe, names: Iterable[str]) -> None:
        """Of the lamps among what is optimised, take those by their own light that have the better gradient so."""
        lamps = tuple(name for name in names if name in self._whole.followed.lights)
        if not lamps:
            return
        own = self._base.with_integrator(self._plan, wrt=lamps)
        better = self._following.better(own, probe.params, probe.cotangent, names=lamps, seed=APART + probe.seed)
        if better:
            self._followed |= better
            self._retake(self._plan.blurred, "by the pilot")
            self._last = replace(probe, names=self._names)
            self._run_pilot(self._last)

    def _blur_silent(self, probe: Probe) -> None:
        """Blur what is followed and has no gradient at all here.

        What has nothing but noise stays as it is: that of what is blurred has ten times the noise.
        """
        otherwise = tuple(name for name in self._plan.followed if name in self._whole.missing)
        silent = self._following.silent(probe.params, probe.cotangent, names=otherwise, seed=APART + probe.seed)
        if not silent:
            return
        glass = {name: shape for name, shape in self._whole.followed.glass.items() if name in silent}
        shown = self._shown(glass)
        self._hidden |= {name: shape for name, shape in glass.items() if name not in shown}
        self._followed -= silent
        self._take(self._optimised)

    def _blur_noise(self, probe: Probe) -> None:
        """Blur what is held, if its gradient can be told from noise that way."""
        noisy = self._blurring.better(probe, self._holding)
        if noisy:
            shown = self._in_view()
            moving = self._traits.moving.items()
            self._hidden |= {name: shape for name, shape in moving if name in noisy and name not in shown}
            self._retake({**self._plan.blurred, **noisy}, "by the pilot")
            self._last = replace(probe, names=self._names)
            self._run_pilot(self._last)

    def _unblur(self, probe: Probe, when: str) -> None:
        """Take from the scene itself again what was blurred for its noise, and has a gradient that is no more noise."""
        noisy = self._plan.blurred.keys() - self._whole.missing.keys()
        if not noisy:
            return
        # Together with all others, as in a step, since they share its samples.
        targets = {name: one for name, one in self._base.targets.items() if name in noisy or name in self._names}
        traits = self._traits_of(targets)
        rules = settings_of(plan_by_rules(traits, self._samples))
        seeds = range(probe.seed, probe.seed + MOST_DRAWS)
        drawn = replace(probe, names=tuple(targets)).gradients(rules, seeds)
        objects = group_by_shape({name: targets[name] for name in targets if name in noisy}, traits.moving)
        free = frozenset(noisy) - Holding.begun(drawn, objects).reasons.keys()
        if not free:
            return
        self._hidden = {name: shape for name, shape in self._hidden.items() if name not in free}
        self._retake({name: reason for name, reason in self._plan.blurred.items() if name not in free}, when)
        self._last = replace(probe, names=self._names)
        self._run_pilot(self._last, free)

    def _retake(self, blurred: Mapping[str, str], when: str) -> None:
        """Start from the rules again, with other parameters blurred."""
        before = self._plan
        self._take(self._optimised, blurred)
        log.info("effects, %s: %s", when, self._plan.changes_from(before))

    def at_step(self, step: int, steps: int, value: float | None) -> None:
        """What :func:`loi_core.fit` says before every step: looks again at what is off when the loss stalls.

        That is when it has reached no new least value for 20 steps, then for 40 more, 80 more and so on. `value` is the
        loss of the step before; None where a fit begins.
        """
        if self._blurred is not None:
            self._blurred.at_step(step, steps, value)
        self._schedule = self._schedule.watched(value)
        if self._schedule.stalls:
            self._schedule = self._schedule.waited()
            self._probe(f"before step {step}, where the loss stalls")

    @property
    def unabridged(self) -> MitsubaRenderer:
        """The same scene with every effect on, by which the outcome of a fit is judged."""
        return self._base.with_integrator(self.everything, wrt=self._names)

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

        Raises
        ------
        OptionError
            If every parameter is blurred or followed.
        """
        if not self._names:
            others = clause({**self._plan.blurred, **self._plan.followed}, "is", "are")
            msg = f"there is nothing to verify: {others} blurred or followed, and no gradient is Mitsuba's own"
            raise OptionError(msg)
        return verification(
            self._current,
            self._base.with_integrator(self.everything, wrt=self._names),
            objective,
            self.parameters() if params is None else dict(params),
            self._groups,
            draws=draws,
            seed=seed,
        )

    def effect_images(self, params: Mapping[str, Any], cotangent: Any, *, seed: int = 0) -> dict[str, Float32Array]:
        """By effect, how its part of the image changes along the descent of the loss: arrays (H, W, C).

        Effects that a pilot has turned off are among them, those that the rules exclude are not. Empty where Mitsuba
        has no derivative of images, as in media, or the gradient is 0.
        """
        if not self._names:
            return {}
        return effect_images(
            self._base, self._rules, self._names, 4 * self._samples, params, to_numpy(cotangent), seed=seed
        )

    def _take(self, names: tuple[str, ...], noisy: Mapping[str, str] = MappingProxyType({})) -> None:
        """Start from the rules for these parameters, of which those that are `noisy` are blurred too."""
        ours = [name for name in names if name in self._followed and name not in noisy]
        followed = {name: self._following.reason_of(name) for name in ours}
        blurred = {**self._whole.missing, **noisy}
        missing = {name: reason for name, reason in blurred.items() if name in names and name not in followed}
        apart = {*missing, *followed}
        targets = {name: one for name, one in self._base.targets.items() if name in names and name not in apart}
        self._names = tuple(targets)
        self._groups = group_by_unit(targets)
        self._traits = replace(self._traits_of(targets), followed=followed, blurred=missing)
        objects = group_by_shape(targets, self._traits.moving)
        self._pilot = Pilot(self._traits, self._samples, self._fraction, self._groups, objects)
        self._holding = Holding()
        self._rules = plan_by_rules(self._traits, self._samples)
        self._set(self._rules)
        if not missing:
            self._blurred = None
        elif self._blurred is None or self._blurred.names != tuple(missing):  # or else it knows how far a fit has come
            self._blurred = self._blurring.over(missing)

    def _traits_of(self, targets: Mapping[str, ParameterTarget]) -> Traits:
        traits = traits_of(self._base.names, targets, self._base.sensor)
        return replace(traits, exchanged=self._whole.exchanged if traits.moving else {}, smooth=self._whole.smooth)

    def _in_view(self) -> frozenset[str]:
        """Parameters whose shape may be in view, at the values of the last call."""
        return self._shown(self._traits.moving)

    def _shown(self, shapes: Mapping[str, Any]) -> frozenset[str]:
        """Those whose shape may be in view; what the camera sees is found out only where there are any."""
        if not shapes:
            return frozenset()
        view = Frustum(self._base.sensor)
        return frozenset(name for name, shape in shapes.items() if view.overlaps(shape))

    def _look(self) -> None:
        """When a shape comes into view, sample outlines if that had been turned off, and let go what moves it.

        What was blurred for its noise has a gradient of its own then, and the next one is a pilot's.
        """
        if not self._begun:
            return
        shown = self._shown(self._hidden)
        if shown:
            self._hidden = {name: shape for name, shape in self._hidden.items() if name not in shown}
            kept = {name: reason for name, reason in self._plan.blurred.items() if name not in shown}
            self._retake(kept, "as it comes into view")
            self._begun = False
            return
        missing = settings_of(self._rules).sppp > 0 and settings_of(self._plan).sppp == 0
        if not (missing or self._holding.groups):
            return
        fresh = self._in_view() - self._seen
        if not fresh:
            return
        self._seen |= fresh
        self._holding = self._holding.without(fresh)
        reason = f"what {listed(sorted(fresh))} moves has come into view"
        self._raise({Effect.PRIMARY: reason} if missing else {}, "as it comes into view")

    def _probe(self, when: str) -> None:
        """Look again at what is off."""
        self._schedule = self._schedule.looked()
        if self._last is not None:
            self._unblur(self._last, when)
        if self._last is None or not self._names or not self._plan.understood or not self._plan.measured:
            return
        if self._holding.groups:
            self._follow_lamps(self._last, self._holding.reasons)
            self._blur_noise(self._last)
        if not self._names:
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
        self._current = self._base.with_integrator(plan, wrt=self._names)

    def _change(self, plan: EffectPlan, when: str) -> None:
        changes = plan.changes_from(self._plan)
        if changes:
            log.info("effects, %s: %s", when, changes)
        self._set(plan)
