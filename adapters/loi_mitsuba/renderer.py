"""Mitsuba scenes as renderers of the core: from named parameters to an image, and its pullback."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from copy import copy
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_core.effects import EffectPlan
from loi_core.errors import OptionError, ParameterError
from loi_core.renderers.contract import RendererCapabilities
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import whole_number
from loi_core.support.wording import shown
from loi_mitsuba.diagnostics import warn_about_entries, warn_about_moving_shapes
from loi_mitsuba.scene.binding import ParameterBinding, host_numbers
from loi_mitsuba.scene.load import (
    ParameterTarget,
    checked_samples,
    checked_targets,
    find_sensor,
    one_line,
    use_variant,
)
from loi_mitsuba.scene.parameters import Scene, SceneIndex, index_scene
from loi_mitsuba.scene.settings import (
    GRADIENT_TERMS,
    SCENE_INTEGRATOR,
    omits_edges,
    settings_of,
    with_sampled_border,
)
from mitsuba_boundaries.drjit.arrays import Float32Array
from mitsuba_boundaries.gradient import ImageGradient
from mitsuba_boundaries.scene_checks import UnsafeSceneError, check_scene
from mitsuba_boundaries.sensing.film import max_samples

__all__ = ["MitsubaRenderer", "split_seed"]


@suggest_keywords
class MitsubaRenderer:
    """A Mitsuba scene whose named parameters can be fitted; keeps the contract of :class:`loi_core.Renderer`.

    Parameters
    ----------
    scene : dict, path or mi.Scene
        A dict for ``mi.load_dict``, the path of an XML file, or a loaded scene. A loaded scene, or a loaded object in a
        dict, is shared with the caller: each call sets its parameters and leaves them set, and a second renderer starts
        from there.
    parameters : dict of str or handle
        Targets by the names of the parameters: a scene parameter (:func:`list_parameters` shows all), or
        :class:`Translate`, :class:`Rotate` or :class:`Scale` of a shape. Several handles may share a shape. Scene
        files, which have no classes, spell a handle as a table, ``{ Translate = "ball", axis = [1, 0, 0] }``.
    integrator : dict, mi.Integrator, "scene" or EffectPlan, optional
        "scene" uses the scene's own. A plan, of :func:`plan_effects`, has its own sample counts; its frozen parameters
        are not frozen here. By default direct light with projective sampling, without guiding, which costs more than it
        saves on a CPU.
    spp : int
        Samples per pixel of the image.
    spp_grad : int, optional
        Samples per pixel of each term of the gradient, except terms that the integrator turns off by 0. By default
        `spp`, unless the integrator sets any of ``sppc``, ``sppp`` and ``sppi``: then its counts are used, and the
        sample count of the sensor's sampler for those that it does not set.
    sensor : int
        Index of the sensor in the scene.
    without_gradient : iterable of str, optional
        Parameters that are only rendered. Their gradient is 0, and they may be parameters for which Mitsuba has no
        gradient, such as cameras. For a :class:`loi_core.renderers.BlurredRenderer`.

    Raises
    ------
    SceneLoadError
        If Mitsuba cannot load the scene.
    ParameterError
        If a target does not exist or has no gradient; the message suggests an alternative.
    OptionError
        If another argument is not allowed.

    Notes
    -----
    Values are float32 NumPy arrays. The image and its gradient use independent seeds, so that the gradient of a loss is
    not biased by the product of their errors. If no variant has been set, it becomes ``cuda_ad_rgb`` where there is a
    GPU, or else ``llvm_ad_rgb``.

    Examples
    --------
    >>> renderer = MitsubaRenderer(                             # doctest: +SKIP
    ...     "scene.xml", {"place": Translate("sphere_0"), "colour": "lamp.emitter.radiance.value"}, spp=32
    ... )
    >>> fit(renderer, LOIObjective(photo), steps=200, learning_rate=0.02)   # doctest: +SKIP
    """

    _excluded: frozenset[str] = frozenset()  # sample counts of gradient terms that another renderer computes

    def __init__(
        self,
        scene: dict[str, Any] | str | Path | Scene,  # the annotation allows scene files to give a path
        parameters: Mapping[str, ParameterTarget | Mapping[str, Any]],
        *,
        integrator: Any = None,
        spp: int = 16,
        spp_grad: int | None = None,
        sensor: int = 0,
        without_gradient: Iterable[str] = (),
    ) -> None:
        self._variant = use_variant()
        targets = checked_targets(parameters)
        self._index = index_scene(with_sampled_border(scene, integrator), targets)
        self._scene = self._index.scene
        self._sensor = find_sensor(self._scene, sensor)
        self._set_integrator(integrator, spp, spp_grad)
        render_only = frozenset(without_gradient)
        self._binding = ParameterBinding(self._index, targets, render_only)
        self._differentiable = tuple(name for name in targets if name not in render_only)
        self._gradient = ImageGradient(self._scene, self._sensor, self._binding.moving(self._differentiable))
        self._set_wrt(self._differentiable)
        self._check_gradients(is_planned=isinstance(integrator, EffectPlan) and omits_edges(integrator))

    @property
    def capabilities(self) -> RendererCapabilities:
        """The image is linear radiance."""
        return RendererCapabilities(encoding="linear")

    @property
    def scene(self) -> Any:
        """The scene, an ``mi.Scene``, with the parameters of the last call."""
        return self._scene

    @property
    def sensor(self) -> Any:
        """The sensor that renders the image, an ``mi.Sensor``."""
        return self._sensor

    @property
    def wrt(self) -> tuple[str, ...]:
        """The parameters with respect to which the image is differentiated; the gradient of the others is 0."""
        return self._wrt

    @property
    def names(self) -> SceneIndex:
        """The index of the scene's parameters and shapes."""
        return self._index

    @property
    def targets(self) -> dict[str, ParameterTarget]:
        """The targets by the names of the parameters."""
        return dict(self._binding.targets)

    def with_integrator(
        self,
        integrator: Any,
        *,
        spp: int | None = None,
        spp_grad: int | None = None,
        wrt: Iterable[str] | None = None,
    ) -> MitsubaRenderer:
        """Return a renderer of the same scene, which both share, and parameters with another integrator.

        Parameters
        ----------
        integrator, spp, spp_grad
            As for the class; `spp` is this renderer's by default.
        wrt : iterable of str, optional
            Parameters to differentiate with respect to, by default all; the gradient of the others is 0 and costs
            nothing.

        Raises
        ------
        OptionError
            If an argument is not allowed.
        """
        changed = copy(self)
        changed._set_integrator(integrator, self._spp if spp is None else spp, spp_grad)
        changed._set_wrt(self._wrt if wrt is None else wrt)
        return changed

    def parameters(self) -> dict[str, Float32Array]:
        """Return the values of all parameters in the scene as it was loaded, as new float32 arrays."""
        return {name: value.copy() for name, value in self._binding.start.items()}

    def set_parameters(self, params: Mapping[str, Any]) -> None:
        """Set the parameters in the scene. Errors as of :meth:`render`."""
        self._binding.set(self._leaves(params))

    def render(self, params: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        """Render the image, shape (H, W, C), float32.

        Raises
        ------
        ParameterError
            If `params` has not exactly the parameters' names, shapes, and finite values.
        OptionError
            If `seed` is not allowed, or Mitsuba's variant has changed since the scene was loaded.
        """
        self.set_parameters(params)
        with dr.suspend_grad():
            image = self._integrator.render(
                self._scene, self._sensor, split_seed(seed)[0], self._spp, develop=True, evaluate=True
            )
        return np.array(image.numpy(), dtype=np.float32, order="C")

    def render_vjp(
        self, params: Mapping[str, Any], *, seed: int = 0
    ) -> tuple[Float32Array, Callable[[Any], dict[str, Float32Array]]]:
        """Render the image and return it with its pullback, which may be called repeatedly. Errors as of `render`."""
        image = self.render(params, seed=seed)
        shape = image.shape
        frozen = {name: np.array(value, dtype=np.float32) for name, value in params.items()}

        def pullback(cotangent: Any) -> dict[str, Float32Array]:
            return self.vjp(frozen, host_numbers("cotangent", cotangent, shape), seed=seed)

        return image, pullback

    def vjp(self, params: Mapping[str, Any], cotangent: Any, *, seed: int = 0) -> dict[str, Float32Array]:
        """Return the vector-Jacobian product without rendering the image.

        It equals the pullback of :meth:`render_vjp` with the same `params` and `seed`.

        Parameters
        ----------
        params : mapping of arrays
        cotangent : array, shape (H, W, C)
        seed : int

        Returns
        -------
        dict of arrays
            The gradient of each parameter, in its shape. Errors as of `render`.
        """
        gradient = {name: np.zeros_like(start) for name, start in self._binding.start.items()}
        if not self._wrt:
            self._leaves(params)  # to check them
            return gradient
        self._check_variant()
        cotangent = np.ascontiguousarray(cotangent, dtype=np.float32)
        with self._binding.attached(params, self._wrt) as leaves:
            self._gradient.vjp(
                self._integrator, cotangent, seed=split_seed(seed)[1], spp=self._spp_grad, excluded=self._excluded
            )
            return gradient | self._binding.gradients(leaves, self._wrt)

    def jvp(self, params: Mapping[str, Any], tangent: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        """Return the Jacobian-vector product: the derivative of the image along `tangent`, shape (H, W, C).

        :meth:`vjp` is its adjoint. Not all integrators of Mitsuba support forward mode. Errors as of `render`.
        """
        self._check_variant()
        with self._binding.attached(params, self._wrt) as leaves:
            for name in self._wrt:
                direction = host_numbers(name, tangent[name], self._binding.start[name].shape)
                dr.set_grad(leaves[name], mi.Float(direction.reshape(-1)))
                dr.enqueue(dr.ADMode.Forward, leaves[name])
            # Propagate to the scene's entries now, because Mitsuba's loops traverse no further back than these.
            dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
            return self._gradient.jvp(
                self._integrator, seed=split_seed(seed)[1], spp=self._spp_grad, excluded=self._excluded
            )

    def _set_wrt(self, wrt: Iterable[str], excluded: frozenset[str] | None = None) -> None:
        """Set the parameters to differentiate with respect to and, if given, the excluded terms."""
        names = frozenset(wrt)
        self._wrt = tuple(name for name in self._differentiable if name in names)
        self._excluded = self._excluded if excluded is None else excluded

    def _set_integrator(self, integrator: Any, spp: int, spp_grad: int | None) -> None:
        """Set the integrator and the sample counts, checked."""
        max_count = max_samples(self._sensor.film())
        self._spp = checked_samples("spp", spp, max_count)
        if isinstance(integrator, EffectPlan):
            if spp_grad is not None:
                msg = "`spp_grad` and a plan exclude each other, because a plan has its own counts; give one of them"
                raise OptionError(msg)
            settings = settings_of(integrator)
            for name in GRADIENT_TERMS:
                if getattr(settings, name) > 0:
                    checked_samples(name, getattr(settings, name), max_count)
            self._integrator = self._scene.integrator() if settings.integrator == SCENE_INTEGRATOR else settings.load()
            self._spp_grad = 0 if settings.projective else settings.sppc  # 0 keeps the integrator's own counts
            return
        self._integrator = _load_integrator(self._scene, integrator)
        self._spp_grad = _gradient_samples(self._integrator, self._spp, spp_grad, max_count)

    def _leaves(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return `params`, checked, as flat Dr.Jit arrays."""
        self._check_variant()
        return self._binding.leaves(params)

    def _check_variant(self) -> None:
        """Raise OptionError if Mitsuba's variant has changed since the scene was loaded."""
        if mi.variant() != self._variant:
            msg = (
                f"Mitsuba's variant is {mi.variant()!r}, the scene's is {self._variant!r}; call mi.set_variant with it"
            )
            raise OptionError(msg)

    def _check_gradients(self, *, is_planned: bool) -> None:
        """Raise or warn where the gradient of moving shapes is missing; a plan has given its reasons already."""
        moving = self._binding.moving(self._differentiable)
        if not is_planned:
            edged = self._gradient.edged_shapes
            warn_about_moving_shapes(self._scene, self._sensor, self._integrator, moving, edged)
        warn_about_entries(self._index, {name: self._binding.targets[name] for name in self._differentiable})
        sensor_type = self._sensor.class_name()
        if moving and getattr(self._integrator, "sppp", 0) != 0 and sensor_type != "PerspectiveCamera":
            msg = (
                f"`sensor` is a {sensor_type}, and Mitsuba has the gradient of visible silhouettes for perspective "
                f"only; use a narrow perspective, or an integrator with sppp=0 if nothing that moves is in view"
            )
            raise ParameterError(msg)


def _load_integrator(scene: Any, integrator: Any) -> Any:
    if integrator is None:
        integrator = {"type": "direct_projective", "guiding": "none"}
    elif isinstance(integrator, str) and integrator == SCENE_INTEGRATOR:
        integrator = scene.integrator()
    if isinstance(integrator, dict):
        try:
            check_scene(integrator)
            integrator = mi.load_dict(integrator)
        except (RuntimeError, UnsafeSceneError) as error:
            msg = f"`integrator` cannot be loaded: {one_line(error)}"
            raise OptionError(msg) from None
    if not isinstance(integrator, mi.Integrator):
        msg = f"`integrator` must be a dict, an mi.Integrator or 'scene', got {shown(integrator)}"
        raise OptionError(msg)
    return integrator


def _gradient_samples(integrator: Any, spp: int, spp_grad: int | None, max_count: int) -> int:
    """Return Mitsuba's `spp_grad`: 0 keeps the integrator's own counts, another number replaces those above 0."""
    if spp_grad is not None:
        return checked_samples("spp_grad", spp_grad, max_count)
    return 0 if any(getattr(integrator, name, None) for name in GRADIENT_TERMS) else spp


def split_seed(seed: int) -> tuple[int, int]:
    """Return independent seeds for the image and for its gradient, derived from `seed`.

    Raises
    ------
    OptionError
        If `seed` is not an integer of at least 0.
    """
    number = whole_number(seed)
    if number is None or number < 0:
        msg = f"`seed` must be a whole number, 0 or more, got {shown(seed)}"
        raise OptionError(msg)
    first, second = np.random.SeedSequence(number).generate_state(2)
    return int(first), int(second)
