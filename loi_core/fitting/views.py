"""What a fit compares: one render, or several that have parameters in common, each with an image of its own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from loi_core.errors import OptionError
from loi_core.fitting.parameters import SharedParameters, own_parameters
from loi_core.fitting.stages import finish_of, objectives_of
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import Objective
from loi_core.renderers.contract import LossPullback, Parameters, Renderer, capabilities_of, render_loss_vjp
from loi_core.support.arrays import Array, detached
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["Images", "View", "Views", "as_given", "by_view", "mean"]

Images: TypeAlias = Any
"""An image, shape (H, W, C), or, of several views, a dict of images by the names of the views."""


def as_given(each: Mapping[str, Any]) -> Any:
    """What belongs to each view, by name, or alone if the only view has none."""
    return each[""] if "" in each else dict(each)


def by_view(given: Any) -> dict[str, Any]:
    """What :func:`as_given` has given, by name again."""
    return given if isinstance(given, dict) else {"": given}


@dataclass(frozen=True)
class View:
    """One render, and what it is compared by.

    Attributes
    ----------
    renderer : Renderer
    objectives : tuple of Objective
        From far to near.
    names : tuple of str
        The parameters that it has.
    fixed : dict of arrays
        Those that do not move, and are its own.
    """

    renderer: Renderer
    objectives: tuple[Objective, ...]
    names: tuple[str, ...]
    fixed: Parameters = field(default_factory=dict)

    def own(self, params: Parameters) -> Parameters:
        """Those of the parameters that this view has."""
        if self.fixed:
            return {name: self.fixed[name] if name in self.fixed else params[name] for name in self.names}
        return (
            params if len(params) == len(self.names) else {name: params[name] for name in params if name in self.names}
        )

    def render(self, params: Parameters, *, seed: int = 0) -> Array:
        """The image, detached."""
        return detached(self.renderer.render(self.own(params), seed=seed))

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, LossPullback]:
        """The image, detached, and its pullback."""
        image, pullback = render_loss_vjp(self.renderer, self.own(params), seed=seed)
        return detached(image), pullback


@dataclass(frozen=True)
class Views:
    """Views by name.

    Attributes
    ----------
    each : dict of View
    single : bool
        Whether there is one that has no name.
    at_once : int
        How many are rendered in a step.
    finish : bool
        Whether the last objectives only finish what those before have placed.
    """

    each: Mapping[str, View]
    single: bool
    at_once: int
    finish: bool = False

    @classmethod
    def of(cls, renderer: object, objective: object, stages: object, at_once: object, finish: object = None) -> Views:
        """The views that arguments of :func:`loi_core.fit` stand for.

        Raises
        ------
        OptionError
            If names, stages, `views_per_step` or `finish` do not fit.
        RendererError
            If a parameter differs in shape from view to view.
        """
        single = not isinstance(renderer, Mapping)
        renderers: Mapping[Any, Any] = renderer if isinstance(renderer, Mapping) else {"": renderer}
        compared = {"": objective} if single else objective
        if single and isinstance(objective, Mapping):
            msg = "`objective` is a dict, so `renderer` must be one too, with the same names of views"
            raise OptionError(msg)
        if not renderers or not isinstance(compared, Mapping) or set(compared) != set(renderers):
            given = sorted(map(str, compared)) if isinstance(compared, Mapping) else shown(objective)
            msg = f"`objective` must have one for each view of `renderer`, {sorted(map(str, renderers))}, got {given}"
            raise OptionError(msg)
        for name in () if single else renderers:
            if not isinstance(name, str) or not name:
                msg = f"`renderer` must name its views by texts that are not empty, got {shown(name)}"
                raise OptionError(msg)
        for name, one in compared.items():
            if not isinstance(one, Objective) or isinstance(one, type):
                where = f" of view {name!r}" if name else ""
                msg = f"`objective`{where} must be an Objective, such as LOIObjective(photograph), got {shown(one)}"
                raise OptionError(msg)
        if len(renderers) > 1 and isinstance(stages, Sequence) and not isinstance(stages, str):
            strange = next((one for one in stages if not isinstance(one, ScaleSpace)), None)
            if strange is not None:
                msg = (
                    f"`stages` of several views must be scales, as objectives belong to one view, got {shown(strange)}"
                )
                raise OptionError(msg)
        views = {
            name: View(one, objectives_of(compared[name], stages), tuple(own_parameters(one)))
            for name, one in renderers.items()
        }
        most = max(len(one.objectives) for one in views.values())
        for name, one in views.items():  # a view without far scales has its objective in all stages
            same = one.objectives[:1] * (most - len(one.objectives))
            views[name] = replace(one, objectives=same + one.objectives + finish_of(compared[name], finish))
        if single and at_once is not None:
            msg = f"`views_per_step` must be left out unless `renderer` is a dict of views, got {shown(at_once)}"
            raise OptionError(msg)
        count = len(views) if at_once is None else whole_number(at_once)
        if count is None or not 1 <= count <= len(views):
            msg = f"`views_per_step` must be a whole number from 1 to {len(views)}, the views, got {shown(at_once)}"
            raise OptionError(msg)
        made = cls(views, single, count, finish is not None)
        made.parameters()
        return made

    @property
    def stages(self) -> int:
        """How many objectives there are, from far to near."""
        return len(next(iter(self.each.values())).objectives)

    @property
    def placing(self) -> int:
        """The stage of the objectives that were asked for: the last, but for a finish."""
        return self.stages - 1 - self.finish

    @property
    def all_at_once(self) -> bool:
        """Whether every step renders all views."""
        return self.at_once == len(self.each)

    def parameters(self) -> Parameters:
        """All parameters; one that several views have is that of the first."""
        return SharedParameters({name: view.renderer for name, view in self.each.items()}).parameters()

    def moving(self, names: Iterable[str]) -> Views:
        """The same views if only these parameters move: those of several views keep their own values of all others."""
        if self.single:
            return self
        free = set(names)
        each = {}
        for name, view in self.each.items():
            own = own_parameters(view.renderer)
            each[name] = replace(view, fixed={key: value for key, value in own.items() if key not in free})
        return replace(self, each=each)

    def project(self, params: Parameters) -> Parameters | None:
        """The parameters as the renderers make them legal, in turn; None if none of them does."""
        legal, known = dict(params), False
        for view in self.each.values():
            project = capabilities_of(view.renderer).project
            if project is not None:
                given, known = project(view.own(legal)), True
                if not isinstance(given, Mapping):
                    return given
                # What it has left out is missed by whoever asked, and not what it was before.
                legal = {key: value for key, value in legal.items() if key not in view.names} | dict(given)
        return legal if known else None

    def turn(self, step: int, seed: int) -> tuple[str, ...]:
        """The views of a step: all, or some in an order that is random, and in which all come about equally often."""
        names = tuple(self.each)
        if self.all_at_once:
            return names
        if len(names) % self.at_once:
            drawn = np.random.default_rng([seed, step]).permutation(len(names))[: self.at_once]
        else:  # in rounds, each of which has all of them
            place = step * self.at_once
            order = np.random.default_rng([seed, place // len(names)]).permutation(len(names))
            drawn = order[place % len(names) :][: self.at_once]
        return tuple(names[index] for index in drawn)

    def at_step(self, step: int, steps: int, value: float | None) -> None:
        """Tell the renderers that ask for it how far the fit has come; one that serves several views hears it once."""
        renderers = {id(view.renderer): view.renderer for view in self.each.values()}
        for renderer in renderers.values():
            at_step = capabilities_of(renderer).at_step
            if at_step is not None:
                at_step(step, steps, value)

    def render(self, params: Parameters, seed: int) -> dict[str, Array]:
        """The images of all views."""
        return {name: view.render(params, seed=seed) for name, view in self.each.items()}

    def values(self, images: Mapping[str, Array], stage: int) -> dict[str, float]:
        """What the objectives of a stage say of images."""
        return {name: float(detached(self.each[name].objectives[stage].value(image))) for name, image in images.items()}

    def value(self, params: Parameters, stage: int, seed: int) -> float:
        """The mean over all views of what the objectives of a stage say of parameters."""
        return mean(self.values(self.render(params, seed), stage))

    def at(self, stage: int) -> Views:
        """The same views with the objectives of one stage alone, all at once."""
        each = {name: replace(view, objectives=(view.objectives[stage],)) for name, view in self.each.items()}
        return replace(self, each=each, at_once=len(each), finish=False)

    def unabridged(self) -> Views:
        """The same views, rendered whole."""
        whole = {}
        for name, view in self.each.items():
            unabridged = capabilities_of(view.renderer).unabridged
            whole[name] = view if unabridged is None else replace(view, renderer=unabridged())
        return replace(self, each=whole)


def mean(values: Mapping[str, float]) -> float:
    """The mean of values by view."""
    return sum(values.values()) / len(values)
