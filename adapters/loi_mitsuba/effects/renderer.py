"""A renderer of a Mitsuba scene that simulates only the effects that the loss needs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from loi_core.effects import EffectPlan
from loi_core.errors import OptionError
from loi_core.objectives.base import Objective
from loi_core.renderers.blurred import BLUR_KEYS
from loi_core.renderers.contract import Loss, LossPullback, RendererCapabilities
from loi_core.renderers.verification import Verification, verification
from loi_core.support.arrays import to_numpy
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import real_number
from loi_core.support.wording import clause, shown
from loi_mitsuba.effects.attached_gradient import AttachedGradient
from loi_mitsuba.effects.effect_images import effect_images
from loi_mitsuba.effects.gradient_draws import GradientProbe
from loi_mitsuba.effects.planner import Planner, PlanState
from loi_mitsuba.effects.rules import everything, plan_of
from loi_mitsuba.effects.setup import prepare_renderer
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.binding import host_numbers
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import Scene
from mitsuba_boundaries.drjit.arrays import Float32Array
from mitsuba_boundaries.proxy.scene import ProxySettings

__all__ = ["FRACTION", "PlannedRenderer"]

FRACTION: Final = 0.1  # effects that are off rotate the gradient by less than 6 degrees, whose cosine is 0.995


@suggest_keywords
class PlannedRenderer:
    """A Mitsuba scene that is rendered by a plan; satisfies the contract of :class:`loi_core.Renderer`.

    A plan never changes: images and gradients depend on parameters and seed alone. At first the plan follows sound
    rules. :meth:`start` returns a renderer with a better plan, by a pilot: a few gradients, which turn off effects that
    carry less than `fraction` of the gradient. :meth:`revisit` returns the renderer of the next step. It tests effects
    that are off again after 20 gradients, then 40, 80 and so on, as soon as a moving shape has come into view, and when
    the loss stalls. Effects that appear or grow are turned on and stay on. :func:`loi_core.fit` calls both.

    If the gradient of an object is indistinguishable from noise, its parameters are blurred, provided that the blurred
    gradient is significant. Otherwise they are frozen: their gradient is 0 until the gradients of further steps agree;
    see ``loi_core.effects.Frozen``. Both end when the object comes into view. Blurring also ends when the object's own
    gradient becomes significant, which is tested together with the effects. Changes are logged in one line, at level
    INFO of the logger ``loi_mitsuba``.

    Parameters
    ----------
    scene, parameters, sensor
        As for :class:`MitsubaRenderer`.
    spp : int
        Samples per pixel of the image, and of each term of the gradient before their time is allocated.
    fraction : float
        The effects that are off carry together less than this fraction of the gradient with respect to any optimised
        parameter, and less than a tenth of it of the image. At 0 only effects that are exactly 0 are turned off. At
        least 0 and less than 1.
    proxy : ProxySettings, table or None
        How far the proxy scene may differ from the scene. The proxy has the gradients of moving shapes that Mitsuba
        lacks in the scene itself: under point, spot and directional lights, in perfect mirrors and clear glass, and of
        textures with steps. None takes all gradients from the scene itself, which the image always shows.
    blur : table or None
        How parameters are blurred that have no gradient there either, such as those of cameras and clear glass, or only
        noise; the plan lists them. The keys are the options of :class:`loi_core.renderers.BlurredRenderer`, with 4
        `pairs` by default; `names` blurs these parameters and no others. With None, parameters without a gradient are
        refused, and the others have Mitsuba's.
    attached_lights : bool
        Whether moving area, point and spot lights have the gradient of attached samples, where Mitsuba's own gradient
        has nothing more that is significant. The plan lists them.
    attached_glass : bool
        Whether moving spheres and smooth meshes of clear glass have the gradient of attached samples. The plan lists
        them.

    Notes
    -----
    A change of the path depth changes the image, by less than the fraction. Samples are allocated by measured times, so
    that two runs may differ by noise.

    In your own loop, call :meth:`start` once, and :meth:`revisit` after every step. Otherwise the renderer keeps the
    plan by the rules, and freezes nothing.

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
        if blur is not None and (not isinstance(blur, Mapping) or set(blur) - set(BLUR_KEYS)):
            msg = f"`blur` must be None, or a table of {', '.join(BLUR_KEYS)}, got {shown(blur)}"
            raise OptionError(msg)
        for option, value in (("attached_lights", attached_lights), ("attached_glass", attached_glass)):
            if not isinstance(value, bool):
                msg = f"`{option}` must be true or false, got {shown(value)}"
                raise OptionError(msg)
        try:
            settings = ProxySettings.of(proxy)
        except ValueError as error:
            msg = f"`proxy`: {error}"
            raise OptionError(msg) from None
        setup = prepare_renderer(
            scene,
            parameters,
            sensor,
            spp,
            settings,
            blur,
            attached_lights=attached_lights,
            attached_glass=attached_glass,
        )
        self._base = setup.renderer
        self._samples = int(spp)
        attached = AttachedGradient(setup.renderer, setup.attached, self._samples)
        self._planner = Planner(setup, attached, self._samples, real_number(fraction), blur)
        self._state = self._planner.by_rules(self._base.targets)
        self._frozen_gradient: _FrozenGradient | None = None

    @property
    def capabilities(self) -> RendererCapabilities:
        """Images are radiance; gradients depend on the loss; the effects are planned, and planned again."""
        return RendererCapabilities(
            start=self.start,
            revisit=self.revisit,
            render_loss_vjp=self.render_loss_vjp,
            unabridged=lambda: self.unabridged,
            encoding="linear",
            planner=self,
        )

    @property
    def plan(self) -> EffectPlan:
        """The current plan."""
        return self._state.plan

    @property
    def everything(self) -> EffectPlan:
        """The plan with all effects on that Mitsuba can differentiate, without guiding: the reference of `verify`."""
        traits = self._state.traits
        return plan_of(traits, everything(traits, self._samples))

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The optimised parameters whose gradient is Mitsuba's, in groups of one unit."""
        return self._state.pilot.units

    @property
    def targets(self) -> dict[str, ParameterTarget]:
        """The target of each parameter."""
        return self._base.targets

    @property
    def scene(self) -> Any:
        """The scene, an ``mi.Scene``; its parameters have the values of the last call."""
        return self._base.scene

    @property
    def unabridged(self) -> MitsubaRenderer:
        """The same scene with all effects on, which judges the result of a fit."""
        return self._base.with_integrator(self.everything, wrt=self._state.names)

    def parameters(self) -> dict[str, Float32Array]:
        """Return the values of the scene as it was loaded; see :meth:`MitsubaRenderer.parameters`."""
        return self._base.parameters()

    def render(self, params: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        """Render the image, shape (H, W, C), float32; see :meth:`MitsubaRenderer.render`."""
        return self._state.renderer.render(params, seed=seed)

    def render_vjp(
        self, params: Mapping[str, Any], *, seed: int = 0
    ) -> tuple[Float32Array, Callable[[Any], dict[str, Float32Array]]]:
        """Render the image and return it with its pullback; see :meth:`MitsubaRenderer.render_vjp`.

        The gradient of frozen parameters is 0.
        """
        image, pullback = self.render_loss_vjp(params, seed=seed)
        return image, partial(pullback, None)

    def render_loss_vjp(self, params: Mapping[str, Any], *, seed: int = 0) -> tuple[Float32Array, LossPullback]:
        """As `render_vjp`, with a pullback of the loss, or None, and the cotangent: blurred gradients use the loss."""
        state = self._state
        image, values = state.renderer.render(params, seed=seed), _host(params)

        def pullback(loss: Loss | None, cotangent: Any) -> dict[str, Float32Array]:
            checked = host_numbers("cotangent", cotangent, image.shape)
            gradient = state.renderer.vjp(values, checked, seed=seed)
            noise = {name: gradient[name] for name in state.frozen.reasons}
            if noise:
                self._frozen_gradient = _FrozenGradient(values, np.array(checked), seed, noise)
            if state.plan.attached:
                gradient |= self._planner.attached.vjp(values, checked, names=state.plan.attached, seed=seed)
            if state.blurred is not None:
                gradient |= state.blurred.vjp(values, checked, seed=seed, loss=loss)
            return gradient | {name: np.zeros_like(value) for name, value in noise.items()}

        return image, pullback

    def start(
        self, params: Mapping[str, Any], cotangent: Any, *, optimise: Iterable[str] | None = None, seed: int = 0
    ) -> PlannedRenderer:
        """Return a renderer with a plan for a fit that starts at `params`.

        Parameters
        ----------
        params : dict of arrays
        cotangent : array, shape (H, W, C)
            Gradient of the loss with respect to the image at `params`.
        optimise : iterable of str, optional
            The free parameters; all by default. The gradient of the others is 0.
        seed : int
            Seed of the pilot.

        Raises
        ------
        ParameterError
            If `optimise` is empty or names an unknown parameter.
        """
        names = self._base.targets if optimise is None else optimise
        return self._with_state(self._planner.start(self._point(params, cotangent, seed), optimise=names))

    def revisit(
        self,
        step: int,
        steps: int,
        value: float | None = None,
        params: Mapping[str, Any] | None = None,
        cotangent: Any = None,
        *,
        seed: int = 0,
    ) -> PlannedRenderer:
        """Return the renderer of `step` of `steps`; :func:`loi_core.fit` calls this before every step.

        The loss has stalled if it has reached no new minimum for 20 steps, then for 40, 80, 160 ... more.

        Parameters
        ----------
        step, steps : int
            The next step, counted from 0, and their number.
        value : float, optional
            Loss of the previous step; None where a fit begins.
        params, cotangent, seed
            Of the previous step; `cotangent` is the gradient of the loss with respect to the image, shape (H, W, C).
            None if there is none.
        """
        point = None if params is None or cotangent is None else self._point(params, cotangent, seed)

        def gradient() -> Mapping[str, Float32Array]:
            """Return the gradient of the frozen parameters; the pullback of the step has usually evaluated it."""
            assert point is not None  # noqa: S101  # only the gradient of a step is asked for
            known = self._frozen_gradient
            if known is not None and known.is_at(point):
                return known.gradient
            return self._state.renderer.vjp(point.params, point.cotangent, seed=point.seed)

        return self._with_state(self._planner.revisit(self._state, step, steps, value, point, gradient))

    def _point(self, params: Mapping[str, Any], cotangent: Any, seed: int) -> GradientProbe:
        return GradientProbe(self._base, _host(params), np.array(to_numpy(cotangent), np.float32), (), seed)

    def _with_state(self, state: PlanState) -> PlannedRenderer:
        changed = copy(self)
        changed._state = state
        changed._frozen_gradient = None
        return changed

    def verify(
        self, objective: Objective, params: Mapping[str, Any] | None = None, *, draws: int = 16, seed: int = 0
    ) -> Verification:
        """Compare the plan with all effects on, without guiding: the time of a step, and the gradient of the loss.

        Parameters
        ----------
        objective : Objective
            The loss.
        params : dict of arrays, optional
            Where; the scene's own values by default.
        draws : int
            Gradients of each, 3 or more.
        seed : int
            First seed; the two use different ones.

        Raises
        ------
        OptionError
            If all parameters are blurred or have attached gradients.
        """
        state = self._state
        if not state.names:
            names = clause({**state.plan.blurred, **state.plan.attached}, "is", "are")
            msg = f"there is nothing to verify: {names} blurred or attached, and no gradient is Mitsuba's own"
            raise OptionError(msg)
        return verification(
            state.renderer,
            self.unabridged,
            objective,
            self.parameters() if params is None else dict(params),
            state.pilot.units,
            draws=draws,
            seed=seed,
        )

    def effect_images(
        self, params: Mapping[str, Any], cotangent: Any, *, optimise: Iterable[str] | None = None, seed: int = 0
    ) -> dict[str, Float32Array]:
        """Return for each effect the change of the image along the descent of the loss, shape (H, W, C).

        The parameters in `optimise` change, by default those that the plan is for. Effects that the pilot turned off
        are included, and those that the rules exclude are not. Empty where Mitsuba has no derivative of images, as in
        media, or where the gradient is 0.
        """
        state = self._state if optimise is None else self._planner.by_rules(optimise)
        if not state.names:
            return {}
        return effect_images(
            self._base, state.rules, state.names, 4 * self._samples, params, to_numpy(cotangent), seed=seed
        )


@dataclass(frozen=True)
class _FrozenGradient:
    """The last gradient of the frozen parameters, which `revisit` would evaluate again."""

    params: Mapping[str, Float32Array]
    cotangent: Float32Array
    seed: int
    gradient: Mapping[str, Float32Array]

    def is_at(self, point: GradientProbe) -> bool:
        """Return whether it is the gradient at this point."""
        same = all(np.array_equal(value, point.params[name]) for name, value in self.params.items())
        return same and self.seed == point.seed and np.array_equal(self.cotangent, point.cotangent)


def _host(params: Mapping[str, Any]) -> dict[str, Float32Array]:
    """Return copies of the parameters as NumPy arrays."""
    return {name: np.array(to_numpy(value), dtype=np.float32) for name, value in params.items()}
