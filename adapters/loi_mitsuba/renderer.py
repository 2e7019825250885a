"""Any Mitsuba scene as a renderer: named parameters to an image, and a pullback."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from copy import copy
from pathlib import Path
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_core.effects import EffectPlan
from loi_core.errors import OptionError, ParameterError
from loi_core.renderers.contract import RendererCapabilities
from loi_core.support.values import whole_number
from loi_core.support.wording import shown
from loi_mitsuba.boundary.edge_sampling import EdgeBoundary
from loi_mitsuba.boundary.intersections import IntersectionBoundary
from loi_mitsuba.boundary.projective import ProjectiveBoundary
from loi_mitsuba.boundary.received_shadows import ReceivedShadowBoundary
from loi_mitsuba.boundary.terms import BoundarySampler, BoundaryTerm, InteriorTerm
from loi_mitsuba.diagnostics import warn_about_entries, warn_about_moving_shapes
from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.geometry.coincident_edges import UniqueEdges
from loi_mitsuba.scene.binding import ParameterBinding, host_numbers
from loi_mitsuba.scene.load import (
    ParameterTarget,
    checked_samples,
    checked_targets,
    find_sensor,
    max_samples,
    one_line,
    use_variant,
)
from loi_mitsuba.scene.parameters import Scene, SceneIndex, index_scene
from loi_mitsuba.scene.safety import SceneLoadError, check_description
from loi_mitsuba.scene.settings import PARTS, bordered, integrator_of, leaves_edges_out, settings_of
from loi_mitsuba.sensing.film import Film

__all__ = ["MitsubaRenderer", "split_seed"]


OWN_INTEGRATOR: Final = "scene"
DIRECT: Final = 2  # the longest paths of an integrator of direct light, which it does not tell
ENDLESS: Final = 2**31  # at least so much says one that has no longest


class MitsubaRenderer:
    """A Mitsuba scene whose named parameters can be fitted; keeps the contract of :class:`loi_core.Renderer`.

    Parameters
    ----------
    scene : dict, path or mi.Scene
        For ``mi.load_dict``, of an XML file, or loaded. A loaded scene, or a loaded object in a dict, is the caller's
        own: its parameters are set on every call and stay set, and a second renderer starts from there.
    parameters : dict of str or handle
        What each parameter stands for, by its name: an entry of the scene (:func:`list_parameters` shows all), or
        :class:`Translate`, :class:`Rotate` or :class:`Scale` of a shape. Several handles may share a shape. Scene
        files, which have no classes, spell a handle as a table, ``{ Translate = "ball", axis = [1, 0, 0] }``.
    integrator : dict, mi.Integrator, "scene" or EffectPlan, optional
        "scene" takes the scene's own; a plan, of :func:`plan_effects`, brings its own samples too, and what it holds
        is not held here. By default direct light with projective sampling, without guiding, which costs more than it is
        worth on a processor.
    spp : int
        Samples per pixel of the image.
    spp_grad : int, optional
        Samples per pixel of each part of the gradient that the integrator has not turned off by 0. By default `spp`,
        unless the integrator has been given any of ``sppc``, ``sppp`` and ``sppi``: then its own, and those that it
        has not been given are the sample count of the sensor's sampler.
    sensor : int
        Which of the scene's sensors looks.
    without_gradient : names of parameters, optional
        Those that are only rendered: their gradient is 0, and they may be cameras, lights and entries for which Mitsuba
        has none. For a :class:`loi_core.renderers.BlurredRenderer`.

    Raises
    ------
    SceneLoadError
        If Mitsuba cannot load the scene.
    ParameterError
        If a target is not there or has no gradient; the message says what to do instead.
    OptionError
        If another argument is not allowed.

    Notes
    -----
    Values are float32 NumPy arrays. The image and its gradient use seeds of their own, so that their errors are
    independent and the gradient of a loss is not biased by their product. If no variant has been set, it is
    ``cuda_ad_rgb`` where there is a GPU, or else ``llvm_ad_rgb``.

    Examples
    --------
    >>> renderer = MitsubaRenderer(                             # doctest: +SKIP
    ...     "scene.xml", {"place": Translate("sphere_0"), "colour": "lamp.emitter.radiance.value"}, spp=32
    ... )
    >>> fit(renderer, LOIObjective(photo), steps=200, learning_rate=0.02)   # doctest: +SKIP
    """

    _left_out: frozenset[str] = frozenset()  # parts of the gradient that are left to another renderer

    def __init__(
        self,
        scene: dict[str, Any] | str | Path | Scene,  # scene files take from here that it may be a path
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
        self._names = index_scene(bordered(scene, integrator), targets)
        self._scene = self._names.scene
        self._sensor = find_sensor(self._scene, sensor)
        self._use(integrator, spp, spp_grad)
        images = frozenset(without_gradient)
        self._named = ParameterBinding(self._names, targets, images)
        self._followed = self._able = tuple(name for name in targets if name not in images)
        self._edges = EdgeBoundary.of(self._scene, self._sensor, self._named.moving(self._able))
        moving = self._named.moving(self._able)
        self._crossings = IntersectionBoundary.of(self._scene, self._sensor, moving)
        self._received = ReceivedShadowBoundary.of(self._scene, self._sensor, moving)
        self._once = UniqueEdges.of(moving)
        self._film = Film(self._sensor.film())
        known = [] if self._edges is None else self._edges.shapes
        self._sided = frozenset(name for name in self._able if any(one in known for one in self._named.moving([name])))
        self._check_moving(told=isinstance(integrator, EffectPlan) and leaves_edges_out(integrator))

    @property
    def capabilities(self) -> RendererCapabilities:
        """The image is radiance, "linear"."""
        return RendererCapabilities(encoding="linear")

    @property
    def scene(self) -> Any:
        """The scene, an ``mi.Scene``; its parameters are those of the last call."""
        return self._scene

    @property
    def sensor(self) -> Any:
        """The sensor that looks, an ``mi.Sensor``."""
        return self._sensor

    @property
    def wrt(self) -> tuple[str, ...]:
        """The parameters that have a gradient; that of others is 0."""
        return self._followed

    @property
    def names(self) -> SceneIndex:
        """What the scene's entries and shapes are called."""
        return self._names

    @property
    def targets(self) -> dict[str, ParameterTarget]:
        """What each parameter stands for."""
        return dict(self._named.targets)

    def with_integrator(
        self,
        integrator: Any,
        *,
        spp: int | None = None,
        spp_grad: int | None = None,
        wrt: Iterable[str] | None = None,
    ) -> MitsubaRenderer:
        """The same scene and parameters under another integrator; the two share the scene.

        Parameters
        ----------
        integrator, spp, spp_grad
            As those of the class; `spp` is that of this renderer by default.
        follow : names of parameters, optional
            Those whose gradient is wanted; that of the others is 0, and costs nothing. All of this one by default.

        Raises
        ------
        OptionError
            If an argument is not allowed.
        """
        other = copy(self)
        other._use(integrator, self._spp if spp is None else spp, spp_grad)
        if wrt is not None:
            other._followed = tuple(name for name in self._able if name in set(wrt))
        return other

    def parameters(self) -> dict[str, Float32Array]:
        """Every parameter as the scene had it when it was loaded: float32, new arrays on each call."""
        return {name: value.copy() for name, value in self._named.start.items()}

    def render(self, params: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        """The image, shape (H, W, C), float32.

        Raises
        ------
        ParameterError
            If `params` has not exactly the parameters' names, shapes, and finite values.
        OptionError
            If `seed` is not allowed, or Mitsuba's variant is not that under which the scene was loaded.
        """
        self._named.set(self._leaves(params))
        with dr.suspend_grad():
            image = self._integrator.render(
                self._scene, self._sensor, split_seed(seed)[0], self._spp, develop=True, evaluate=True
            )
        return np.array(image.numpy(), dtype=np.float32, order="C")

    def render_vjp(
        self, params: Mapping[str, Any], *, seed: int = 0
    ) -> tuple[Float32Array, Callable[[Any], dict[str, Float32Array]]]:
        """The image and its pullback, which may be called again, also after other renders. Errors as of `render`."""
        image = self.render(params, seed=seed)
        shape = image.shape
        kept = {name: np.array(value, dtype=np.float32) for name, value in params.items()}

        def pullback(cotangent: Any) -> dict[str, Float32Array]:
            return self.vjp(kept, host_numbers("cotangent", cotangent, shape), seed=seed)

        return image, pullback

    def vjp(self, params: Mapping[str, Any], cotangent: Any, *, seed: int = 0) -> dict[str, Float32Array]:
        """A cotangent of the image, shape (H, W, C), carried to the parameters without an image; errors as of `render`.

        It is what the pullback of :meth:`render_vjp` with the same `params` and `seed` gives.
        """
        if not self._followed:
            self._leaves(params)  # which checks them
            return {name: np.zeros_like(start) for name, start in self._named.start.items()}
        self._check_variant()
        pulled = {name: np.zeros_like(start) for name, start in self._named.start.items()}
        together: dict[tuple[str, ...], list[InteriorTerm | BoundaryTerm]] = {}
        for carry, names in self._parts():
            together.setdefault(names, []).append(carry)
        given = np.ascontiguousarray(cotangent, dtype=np.float32)
        for number, (names, carries) in enumerate(together.items()):
            with self._named.attached(params, frozenset(names), settled=number > 0) as leaves:
                # Within this scope nothing flows on into the parameters' own graph before all parts of the
                # gradient, some of which Mitsuba carries back one after the other, have arrived there.
                with dr.isolate_grad():
                    for carry in carries:
                        carry.vjp(given, split_seed(seed)[1])
                found = self._named.gradients(leaves, names)
            pulled |= {name: pulled[name] + found[name] for name in names}
        return pulled

    def jvp(self, params: Mapping[str, Any], tangent: Mapping[str, Any], *, seed: int = 0) -> Float32Array:
        """How the image changes along a direction of the parameters: shape (H, W, C); errors as of `render`.

        The derivative that :meth:`pull` is the transpose of. Not every integrator of Mitsuba has it.
        """
        self._check_variant()
        width, height = self._film.size
        total: Float32Array = np.zeros((height, width, self._film.channels), np.float32)
        for carry, names in self._parts():
            with self._named.attached(params, frozenset(names)) as leaves:
                for name in names:
                    direction = host_numbers(name, tangent[name], self._named.start[name].shape)
                    dr.set_grad(leaves[name], mi.Float(direction.reshape(-1)))
                    dr.enqueue(dr.ADMode.Forward, leaves[name])
                # Up to the scene's own entries, since Mitsuba's loops do not look any further back than these.
                dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
                total = total + carry.jvp(*split_seed(seed))
        return total

    def _parts(self) -> list[tuple[InteriorTerm | BoundaryTerm, tuple[str, ...]]]:
        """What carries which parts of the gradient, and to which parameters.

        Outlines of meshes with sides are not Mitsuba's, nor are curves along which shapes go through each other, nor
        shadows that fall on what moves.
        """
        moving = tuple(name for name in self._followed if self._named.moving([name]))
        sided = tuple(name for name in moving if name in self._sided)
        round_ones = tuple(name for name in moving if name not in self._sided)
        own, outlines, shadows = self._integrator, self._samples_of("sppp"), self._samples_of("sppi")
        drawn: list[tuple[BoundarySampler, Any, int, tuple[str, ...]]] = [
            (ProjectiveBoundary(self._sensor, self._film, "sppp"), own, outlines, round_ones),
            (ProjectiveBoundary(self._sensor, self._film, "sppi", self._once), own, shadows, moving),
        ]
        if self._received is not None:
            drawn.append((self._received, own, shadows, moving))
        ours = [one for one in (self._crossings, self._edges if sided else None) if one is not None]
        if ours and outlines:
            # Edges have no gradient by what has none of them, so that they may be asked of a scene in which more moves.
            radiance = self._radiance
            drawn = [*((one, radiance, outlines, moving) for one in ours), *drawn]
        parts: list[tuple[InteriorTerm | BoundaryTerm, tuple[str, ...]]] = [
            (BoundaryTerm(one, self._scene, self._film, integrator, samples), names)
            for one, integrator, samples, names in drawn
            if samples and names
        ]
        if "sppc" not in self._left_out and getattr(own, "sppc", None) != 0:
            samples = self._samples_of("sppc") or self._spp_grad
            shading = InteriorTerm(self._scene, self._named.entries, self._sensor, self._film, own, samples)
            parts.append((shading, self._followed))
        return parts

    def _samples_of(self, part: str) -> int:
        """Samples per pixel of a part of the gradient; 0 where the integrator does not have it, or it is off."""
        if part in self._left_out or not hasattr(self._integrator, part):
            return 0
        usual = self._sensor.sampler().sample_count()
        return int(self._integrator.override_spp(getattr(self._integrator, part), self._spp_grad, usual))

    @property
    def _radiance(self) -> Any:
        """What says how bright it is where a ray goes, over as many surfaces as the gradient has."""
        depth = getattr(self._integrator, "max_depth", DIRECT)
        return mi.load_dict(
            {
                "type": "path",
                "max_depth": depth if 0 <= depth < ENDLESS else -1,
                "hide_emitters": bool(getattr(self._integrator, "hide_emitters", False)),
            }
        )

    def _use(self, integrator: Any, spp: int, spp_grad: int | None) -> None:
        """Take an integrator and its samples."""
        most = max_samples(self._sensor.film())
        self._spp = checked_samples("spp", spp, most)
        if isinstance(integrator, EffectPlan):
            if spp_grad is not None:
                msg = "`spp_grad` and a plan exclude each other, for a plan has its own samples; give one of them"
                raise OptionError(msg)
            settings = settings_of(integrator)
            for name in PARTS:
                if getattr(settings, name) > 0:
                    checked_samples(name, getattr(settings, name), most)
            self._integrator, self._spp_grad = integrator_of(settings, self._scene)
            return
        self._integrator = _integrator(self._scene, integrator)
        self._spp_grad = _gradient_samples(self._integrator, self._spp, spp_grad, most)

    def _leaves(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """`params`, checked, as flat arrays of Dr.Jit."""
        self._check_variant()
        return self._named.leaves(params)

    def _check_variant(self) -> None:
        """Refuse to go on where Mitsuba's variant is no longer that of the scene."""
        if mi.variant() != self._variant:
            msg = (
                f"Mitsuba's variant is {mi.variant()!r}, the scene's is {self._variant!r}; call mi.set_variant with it"
            )
            raise OptionError(msg)

    def _check_moving(self, *, told: bool) -> None:
        """Refuse or warn where the gradient of moving shapes is missing, unless a plan has told why."""
        moving = self._named.moving(self._followed)
        if not told:
            warn_about_moving_shapes(
                self._scene, self._sensor, self._integrator, moving, self._edges.shapes if self._edges else ()
            )
        warn_about_entries(self._names, {name: self._named.targets[name] for name in self._able})
        kind = self._sensor.class_name()
        if moving and getattr(self._integrator, "sppp", 0) != 0 and kind != "PerspectiveCamera":
            msg = (
                f"`sensor` is a {kind}, and Mitsuba has the gradient of a silhouette in view for perspective only; use "
                f"a narrow perspective, or an integrator with sppp=0 if nothing that moves is in view"
            )
            raise ParameterError(msg)


def _integrator(scene: Any, integrator: Any) -> Any:
    if integrator is None:
        integrator = {"type": "direct_projective", "guiding": "none"}
    elif isinstance(integrator, str) and integrator == OWN_INTEGRATOR:
        integrator = scene.integrator()
    if isinstance(integrator, dict):
        try:
            check_description(integrator)
            integrator = mi.load_dict(integrator)
        except (RuntimeError, SceneLoadError) as error:
            msg = f"`integrator` cannot be loaded: {one_line(error)}"
            raise OptionError(msg) from None
    if not isinstance(integrator, mi.Integrator):
        msg = f"`integrator` must be a dict, an mi.Integrator or 'scene', got {shown(integrator)}"
        raise OptionError(msg)
    return integrator


def _gradient_samples(integrator: Any, spp: int, spp_grad: int | None, most: int) -> int:
    """What to ask Mitsuba for: 0 leaves the integrator's own counts, any other number overrides those above 0."""
    if spp_grad is not None:
        return checked_samples("spp_grad", spp_grad, most)
    return 0 if any(getattr(integrator, name, None) for name in PARTS) else spp


def split_seed(seed: int) -> tuple[int, int]:
    """Independent seeds for the image and for its gradient, the same for the same `seed` everywhere."""
    number = whole_number(seed)
    if number is None or number < 0:
        msg = f"`seed` must be a whole number, 0 or more, got {shown(seed)}"
        raise OptionError(msg)
    first, second = np.random.SeedSequence(number).generate_state(2)
    return int(first), int(second)
