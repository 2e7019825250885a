"""The views of a fit: one render, or several that share parameters, each compared with its own image."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from loi_core.effects import EffectPlan
from loi_core.errors import OptionError, RendererError
from loi_core.fitting.parameters import SharedParameters, own_parameters
from loi_core.fitting.stages import StagedObjectives, staged_objectives
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import Objective, PixelL2
from loi_core.renderers.contract import LossPullback, Parameters, Renderer, capabilities_of, render_loss_vjp
from loi_core.support.arrays import Array, detached
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["Images", "View", "Views", "by_view", "mean", "ungrouped"]

Images: TypeAlias = Any
"""An image, shape (H, W, C), or a dict of images by the names of several views."""


def ungrouped(values: Mapping[str, Any]) -> Any:
    """Return a dict by view as the caller sees it: the only entry if the view has no name."""
    return values[""] if "" in values else dict(values)


def by_view(values: Any) -> dict[str, Any]:
    """Return the dict that :func:`ungrouped` was given."""
    return dict(values) if isinstance(values, Mapping) else {"": values}


@dataclass(frozen=True)
class View:
    """A renderer, and the objectives of its image.

    Attributes
    ----------
    renderer : Renderer
    objectives : tuple of Objective
        From far to near, one for each stage.
    names : tuple of str
        Names of its parameters.
    requested : Objective
        The objective that the caller passed.
    fixed : dict of arrays
        Parameters that do not move and keep this view's own values.
    """

    renderer: Renderer
    objectives: tuple[Objective, ...]
    names: tuple[str, ...]
    requested: Objective
    fixed: Parameters = field(default_factory=dict)

    def select(self, params: Parameters) -> Parameters:
        """Return the parameters of this view."""
        if self.fixed:
            return {name: self.fixed[name] if name in self.fixed else params[name] for name in self.names}
        return (
            params if len(params) == len(self.names) else {name: params[name] for name in params if name in self.names}
        )

    def render(self, params: Parameters, *, seed: int = 0) -> Array:
        """Return the image, detached."""
        return detached(self.renderer.render(self.select(params), seed=seed))

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, LossPullback]:
        """Return the image, detached, and its pullback."""
        image, pullback = render_loss_vjp(self.renderer, self.select(params), seed=seed)
        return detached(image), pullback


@dataclass(frozen=True)
class Views:
    """Views by name.

    Attributes
    ----------
    by_name : dict of View
    single : bool
        Whether there is only one, without a name.
    at_once : int
        Number of views that a step renders.
    finishes : bool
        Whether the last objective only finishes the result of the main stage.
    """

    by_name: Mapping[str, View]
    single: bool
    at_once: int
    finishes: bool = False

    @classmethod
    def of(
        cls,
        renderer: object,
        objective: object,
        stages: object,
        at_once: object,
        polish: object = None,
        *,
        exposure_is_free: bool = False,
    ) -> Views:
        """Return the views for arguments of :func:`loi_core.fit`; see :func:`staged_objectives` for `exposure_is_free`.

        Raises
        ------
        OptionError
            If names, stages, `views_per_step` or `polish` are not allowed.
        RendererError
            If a parameter has another shape in another view.
        """
        single = not isinstance(renderer, Mapping)
        renderers: Mapping[Any, Any] = renderer if isinstance(renderer, Mapping) else {"": renderer}
        objectives = {"": objective} if single else objective
        if single and isinstance(objective, Mapping):
            msg = "`objective` is a dict, so `renderer` must be one too, with the same names of views"
            raise OptionError(msg)
        if not renderers or not isinstance(objectives, Mapping) or set(objectives) != set(renderers):
            got = sorted(map(str, objectives)) if isinstance(objectives, Mapping) else shown(objective)
            msg = f"`objective` must have one for each view of `renderer`, {sorted(map(str, renderers))}, got {got}"
            raise OptionError(msg)
        for name in () if single else renderers:
            if not isinstance(name, str) or not name:
                msg = f"`renderer` must name its views by non-empty texts, got {shown(name)}"
                raise OptionError(msg)
        for name, entry in objectives.items():
            if not isinstance(entry, Objective) or isinstance(entry, type):
                where = f" of view {name!r}" if name else ""
                msg = f"`objective`{where} must be an Objective, such as LOIObjective(photograph), got {shown(entry)}"
                raise OptionError(msg)
        if len(renderers) > 1 and isinstance(stages, Sequence) and not isinstance(stages, str):
            foreign = next((stage for stage in stages if not isinstance(stage, ScaleSpace)), None)
            if foreign is not None:
                msg = f"`stages` of several views must be scales, as an objective has one image, got {shown(foreign)}"
                raise OptionError(msg)
        staged = {
            name: staged_objectives(objectives[name], stages, polish, exposure_is_free=exposure_is_free)
            for name in renderers
        }
        far_stages = max(len(entry.far) for entry in staged.values())
        finishes = any(entry.finish is not None for entry in staged.values())
        views = {
            name: View(
                entry,
                _aligned(staged[name], far_stages, finishes=finishes),
                tuple(own_parameters(entry)),
                objectives[name],
            )
            for name, entry in renderers.items()
        }
        if single and at_once is not None:
            msg = f"`views_per_step` must be left out unless `renderer` is a dict of views, got {shown(at_once)}"
            raise OptionError(msg)
        rendered = len(views) if at_once is None else whole_number(at_once)
        if rendered is None or not 1 <= rendered <= len(views):
            msg = f"`views_per_step` must be a whole number from 1 to {len(views)}, the views, got {shown(at_once)}"
            raise OptionError(msg)
        grouped = cls(views, single, rendered, finishes)
        grouped.parameters()
        return grouped

    @property
    def stages(self) -> int:
        """Number of objectives of each view, from far to near."""
        return len(next(iter(self.by_name.values())).objectives)

    @property
    def main_stage(self) -> int:
        """Index of the main stage: the last, or the last but one."""
        return self.stages - 1 - self.finishes

    @property
    def polishes(self) -> bool:
        """Whether the last objectives compare pixels."""
        return all(isinstance(view.objectives[-1], PixelL2) for view in self.by_name.values())

    @property
    def all_at_once(self) -> bool:
        """Whether every step renders all views."""
        return self.at_once == len(self.by_name)

    def parameters(self) -> Parameters:
        """Return all parameters; a shared parameter has the value of the first view."""
        return SharedParameters({name: view.renderer for name, view in self.by_name.items()}).parameters()

    def with_free(self, names: Iterable[str]) -> Views:
        """Return the views with these free parameters: each of several views keeps its own values of all others."""
        if self.single:
            return self
        free = set(names)
        changed = {}
        for name, view in self.by_name.items():
            params = own_parameters(view.renderer)
            changed[name] = replace(view, fixed={key: value for key, value in params.items() if key not in free})
        return replace(self, by_name=changed)

    def project(self, params: Parameters) -> Parameters | None:
        """Return the legal parameters nearest to these, by each renderer in turn; None if no renderer projects."""
        legal, projects = dict(params), False
        for view in self.by_name.values():
            project = capabilities_of(view.renderer).project
            if project is not None:
                projected, projects = project(view.select(legal)), True
                if not isinstance(projected, Mapping):
                    return projected
                # A parameter that the renderer leaves out must be missing, so that the caller notices.
                legal = {key: value for key, value in legal.items() if key not in view.names} | dict(projected)
        return legal if projects else None

    def names_at(self, step: int, seed: int) -> tuple[str, ...]:
        """Return the views of a step: all, or some in a random order, each about equally often."""
        names = tuple(self.by_name)
        if self.all_at_once:
            return names
        if len(names) % self.at_once:
            indices = np.random.default_rng([seed, step]).permutation(len(names))[: self.at_once]
        else:  # in rounds of all views
            position = step * self.at_once
            order = np.random.default_rng([seed, position // len(names)]).permutation(len(names))
            indices = order[position % len(names) :][: self.at_once]
        return tuple(names[index] for index in indices)

    def started(self, params: Parameters, free: Iterable[str], seed: int) -> Views:
        """Return the views with renderers that are prepared for a fit of the `free` parameters from `params`."""
        names = tuple(free)

        def started(_: str, view: View) -> Renderer:
            start, optimise = capabilities_of(view.renderer).start, [name for name in names if name in view.names]
            if start is None or not optimise:
                return view.renderer
            cotangent = view.objectives[0].value_and_grad(view.render(params, seed=seed))[1]
            return _renderer("start", view, start(view.select(params), cotangent, optimise=optimise, seed=seed))

        return self._with_renderers(started, list(self.by_name))

    def revisited(
        self,
        step: int,
        steps: int,
        value: float | None,
        params: Parameters,
        cotangents: Mapping[str, Array],
        seed: int,
    ) -> Views:
        """Return the views with the renderers of `step`, given the previous step's value and the views it rendered."""

        def revisited(name: str, view: View) -> Renderer:
            revisit, cotangent = capabilities_of(view.renderer).revisit, cotangents.get(name)
            if revisit is None:
                return view.renderer
            at = None if cotangent is None else view.select(params)
            return _renderer("revisit", view, revisit(step, steps, value, at, cotangent, seed=seed))

        return self._with_renderers(revisited, [*cotangents, *self.by_name])

    def _with_renderers(self, change: Callable[[str, View], Renderer], order: Sequence[str]) -> Views:
        """Return the views with changed renderers; a renderer of several views is changed once, in the first."""
        changed: dict[int, Renderer] = {}
        for name in order:
            view = self.by_name[name]
            if id(view.renderer) not in changed:
                changed[id(view.renderer)] = change(name, view)
        views = {name: replace(view, renderer=changed[id(view.renderer)]) for name, view in self.by_name.items()}
        return replace(self, by_name=views)

    def plans(self) -> dict[str, EffectPlan]:
        """Return the plans of the renderers that plan their effects, by view."""
        planners = {name: capabilities_of(view.renderer).planner for name, view in self.by_name.items()}
        return {name: planner.plan for name, planner in planners.items() if planner is not None}

    def render(self, params: Parameters, seed: int) -> dict[str, Array]:
        """Return the images of all views."""
        return {name: view.render(params, seed=seed) for name, view in self.by_name.items()}

    def values(self, images: Mapping[str, Array], stage: int) -> dict[str, float]:
        """Return the values of the objectives of a stage for images."""
        return {
            name: float(detached(self.by_name[name].objectives[stage].value(image))) for name, image in images.items()
        }

    def value(self, params: Parameters, stage: int, seed: int) -> float:
        """Return the mean over all views of the objectives of a stage."""
        return mean(self.values(self.render(params, seed), stage))

    def at_stage(self, stage: int) -> Views:
        """Return the views with the objectives of one stage, all rendered in every step."""
        changed = {name: replace(view, objectives=(view.objectives[stage],)) for name, view in self.by_name.items()}
        return replace(self, by_name=changed, at_once=len(changed), finishes=False)

    def unabridged(self) -> Views:
        """Return the views with renderers without the approximations that save time."""
        changed = {}
        for name, view in self.by_name.items():
            unabridged = capabilities_of(view.renderer).unabridged
            changed[name] = view if unabridged is None else replace(view, renderer=unabridged())
        return replace(self, by_name=changed)


def _aligned(staged: StagedObjectives, far_stages: int, *, finishes: bool) -> tuple[Objective, ...]:
    """Return the objectives of one view for the stages of all; a view with fewer stages keeps one for longer."""
    far = (*staged.far, staged.main)
    missing = far[:1] * (far_stages - len(staged.far))
    finish = (staged.main if staged.finish is None else staged.finish,)
    return missing + far + (finish if finishes else ())


def _renderer(hook: str, view: View, result: object) -> Renderer:
    """Return the renderer that a hook has returned, checked."""
    if isinstance(result, Renderer):
        return result
    msg = f"`{hook}` of {type(view.renderer).__name__} must return a renderer, got {shown(result)}"
    raise RendererError(msg)


def mean(values: Mapping[str, float]) -> float:
    """Return the mean of values by view."""
    return sum(values.values()) / len(values)
