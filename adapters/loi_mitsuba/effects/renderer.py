"""A renderer of a Mitsuba scene that simulates only the effects that the loss needs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
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
from loi_core.support.arrays import to_numpy
from loi_core.support.values import real_number
from loi_core.support.wording import clause, shown
from loi_mitsuba.effects.effect_images import effect_images
from loi_mitsuba.effects.planner import Planner
from loi_mitsuba.effects.rules import everything, plan_of
from loi_mitsuba.effects.setup import prepare_renderer
from loi_mitsuba.effects.verify import Verification, verification
from loi_mitsuba.proxy.scene import ProxySettings
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.binding import host_numbers
from loi_mitsuba.scene.load import ParameterTarget
from loi_mitsuba.scene.parameters import Scene
from mitsuba_boundaries.drjit.arrays import Float32Array

__all__ = ["FRACTION", "PlannedRenderer"]

FRACTION: Final = 0.1  # effects that are off rotate the gradient by less than 6 degrees, whose cosine is 0.995


class PlannedRenderer:
    """A Mitsuba scene that is rendered by a plan; satisfies the contract of :class:`loi_core.Renderer`.

    The first plan follows sound rules. The first gradient starts a pilot, a few gradients more, which turns off effects
    that carry less than `fraction` of the gradient. Effects that are off are tested again after 20 gradients, then 40,
    80 and so on, as soon as a moving shape comes into view, and when the loss of a fit stalls. Effects that appear or
    grow are turned on and stay on.

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
    that two runs may differ by noise. A plan that is given to :class:`MitsubaRenderer` as its integrator is fixed.

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
            raise OptionError(str(error)) from None
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
        self._planner = Planner(setup, samples=self._samples, fraction=real_number(fraction), blur=blur)

    @property
    def capabilities(self) -> RendererCapabilities:
        """Images are radiance; gradients depend on the loss and the step; the effects are planned."""
        return RendererCapabilities(
            at_step=self.at_step,
            render_loss_vjp=self.render_loss_vjp,
            unabridged=lambda: self.unabridged,
            encoding="linear",
            planner=self,
        )

    @property
    def plan(self) -> EffectPlan:
        """The current plan."""
        return self._planner.state.plan

    @property
    def everything(self) -> EffectPlan:
        """The plan with all effects on that Mitsuba can differentiate, without guiding: the reference of `verify`."""
        traits = self._planner.state.traits
        return plan_of(traits, everything(traits, self._samples))

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The optimised parameters whose gradient is Mitsuba's, in groups of one unit."""
        return self._planner.state.groups

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
        return self._base.with_integrator(self.everything, wrt=self._planner.state.names)

    def parameters(self) -> dict[str, Float32Array]:
        """Return the values of the scene as it was loaded; see :meth:`MitsubaRenderer.parameters`."""
        return self._base.parameters()

    def render(self, params: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        """Render the image, shape (H, W, C), float32; see :meth:`MitsubaRenderer.render`."""
        return self._planner.state.renderer.render(params, seed=seed)

    def render_vjp(
        self, params: Mapping[str, Any], *, seed: int = 0
    ) -> tuple[Float32Array, Callable[[Any], dict[str, Float32Array]]]:
        """Render the image and return it with its pullback; see :meth:`MitsubaRenderer.render_vjp`.

        The pullback keeps the plan of its image. The gradient of frozen parameters is 0.
        """
        image, pullback = self.render_loss_vjp(params, seed=seed)
        return image, partial(pullback, None)

    def render_loss_vjp(self, params: Mapping[str, Any], *, seed: int = 0) -> tuple[Float32Array, LossPullback]:
        """As `render_vjp`, with a pullback of the loss, or None, and the cotangent: blurred gradients use the loss."""
        planner = self._planner
        image = planner.state.renderer.render(params, seed=seed)
        planner.check_visibility()
        renderer = planner.state.renderer  # the pullback keeps it when the plan changes
        values = {name: np.array(value, dtype=np.float32) for name, value in params.items()}
        frozen: frozenset[str] | None = None

        def pullback(loss: Loss | None, cotangent: Any) -> dict[str, Float32Array]:
            nonlocal frozen
            checked = host_numbers("cotangent", cotangent, image.shape)
            gradient = renderer.vjp(values, checked, seed=seed)
            first = not planner.state.started
            if first:
                planner.begin(values, checked, optimise=planner.state.optimised, seed=seed)
            gradient |= planner.attached_vjp(values, checked, seed=seed)
            gradient |= planner.blurred_vjp(values, checked, seed=seed, loss=loss)
            frozen = planner.observe(values, checked, gradient, seed=seed, first=first, frozen=frozen)
            return gradient | {name: np.zeros_like(gradient[name]) for name in frozen}

        return image, pullback

    def begin(self, params: Mapping[str, Any], cotangent: Any, *, optimise: Iterable[str], seed: int = 0) -> EffectPlan:
        """Plan a fit that starts at `params`, where the loss has the gradient `cotangent`, shape (H, W, C).

        From then on the gradient is 0 for parameters that are not in `optimise`, and for frozen ones until they are
        released.

        Raises
        ------
        ParameterError
            If `optimise` is empty or names an unknown parameter.
        """
        return self._planner.begin(params, cotangent, optimise=optimise, seed=seed)

    def at_step(self, step: int, steps: int, value: float | None) -> None:
        """Test effects that are off again if the loss has stalled; :func:`loi_core.fit` calls this before every step.

        The loss has stalled if it has reached no new minimum for 20 steps, then for 40, 80, 160 ... more. `value`
        is the loss of the previous step; None where a fit begins.
        """
        self._planner.at_step(step, steps, value)

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
        state = self._planner.state
        if not state.names:
            names = clause({**state.plan.blurred, **state.plan.attached}, "is", "are")
            msg = f"there is nothing to verify: {names} blurred or attached, and no gradient is Mitsuba's own"
            raise OptionError(msg)
        return verification(
            state.renderer,
            self.unabridged,
            objective,
            self.parameters() if params is None else dict(params),
            state.groups,
            draws=draws,
            seed=seed,
        )

    def effect_images(self, params: Mapping[str, Any], cotangent: Any, *, seed: int = 0) -> dict[str, Float32Array]:
        """Return for each effect the change of the image along the descent of the loss, shape (H, W, C).

        Effects that the pilot turned off are included, and those that the rules exclude are not. Empty where Mitsuba
        has no derivative of images, as in media, or where the gradient is 0.
        """
        state = self._planner.state
        if not state.names:
            return {}
        return effect_images(
            self._base, state.rules, state.names, 4 * self._samples, params, to_numpy(cotangent), seed=seed
        )
