"""Which renderers, objectives and backends are installed: three groups of entry points.

They are ``loi.renderers``, ``loi.objectives`` and ``loi.backends``.

A distribution announces one with an entry point whose name is what it is called by and whose object is a factory. A
renderer's is called with the options of a scene and returns something that keeps the contract of
:class:`loi_core.Renderer`; an objective's with the reference, ``nan_policy`` and ``tone``, as
:class:`loi_core.PixelL2` is; a backend's is called without arguments and returns a
:class:`loi_core.plugins.backends.Backend`. A plugin that cannot be loaded is reported by name and hides no other.
"""

from __future__ import annotations

import contextlib
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import Distribution, EntryPoint, distributions, entry_points
from inspect import Parameter, signature
from typing import Any, Final, Literal, TypeAlias

from loi_core.errors import BackendNotFoundError, ObjectiveNotFoundError, RendererNotFoundError
from loi_core.objectives import Objective
from loi_core.plugins.backends import Backend
from loi_core.renderers.contract import Renderer
from loi_core.support.guards import is_ctrl_c
from loi_core.support.wording import described, shown

__all__ = [
    "BACKEND_GROUP",
    "GROUP",
    "OBJECTIVE_GROUP",
    "BackendFactory",
    "ObjectiveFactory",
    "PluginInfo",
    "RendererFactory",
    "available_backends",
    "available_objectives",
    "available_renderers",
    "load_backend",
    "load_objective",
    "load_renderer",
    "objective_names",
]

GROUP: Final = "loi.renderers"
OBJECTIVE_GROUP: Final = "loi.objectives"
BACKEND_GROUP: Final = "loi.backends"

RendererFactory: TypeAlias = Callable[..., Renderer]
ObjectiveFactory: TypeAlias = Callable[..., Objective]
BackendFactory: TypeAlias = Callable[[], Backend]


@dataclass(frozen=True)
class PluginInfo:
    """One announced renderer, objective or backend.

    Attributes
    ----------
    name : str
        What scenes and commands call it.
    package, version : str
        The distribution that announces it.
    backend : str
        What it computes with: the factory's attribute ``backend``, or else the extra that its entry point asks for;
        empty if neither says.
    target : str
        The factory, ``module:object``.
    state : {"ready", "missing", "broken", "clash"}
        "missing" if a package is not there that an extra would install; "broken" if the factory cannot be imported
        or called for another reason; "clash" if several distributions claim the name.
    problem : str
        One line on what is wrong; empty if it is ready.
    fix : str
        The command that fixes it; empty if it is ready.
    """

    name: str
    package: str
    version: str
    backend: str
    target: str
    state: Literal["ready", "missing", "broken", "clash"]
    problem: str = ""
    fix: str = ""


def available_renderers() -> list[PluginInfo]:
    """Every announced renderer, sorted by name. Each factory is imported to see whether it can be."""
    return _available(GROUP)


def available_objectives() -> list[PluginInfo]:
    """Every announced objective, sorted by name. Each factory is imported to see whether it can be."""
    return _available(OBJECTIVE_GROUP)


def objective_names() -> list[str]:
    """The names of all announced objectives, sorted; nothing is imported."""
    return list(_announced(_points(OBJECTIVE_GROUP)[0]))


def available_backends() -> list[PluginInfo]:
    """Every announced backend, sorted by name. Each factory is imported to see whether it can be."""
    return _available(BACKEND_GROUP)


def load_renderer(name: str) -> RendererFactory:
    """The factory of the renderer called `name`.

    Raises
    ------
    RendererNotFoundError
        If no distribution, or more than one, announces it, or its factory cannot be imported; with the fix.
    """
    factory: RendererFactory = _load(GROUP, "renderer", name, RendererNotFoundError)
    return factory


def load_objective(name: str) -> ObjectiveFactory:
    """The factory of the objective called `name`.

    Raises
    ------
    ObjectiveNotFoundError
        If no distribution, or more than one, announces it, or its factory cannot be imported; with the fix.
    """
    factory: ObjectiveFactory = _load(OBJECTIVE_GROUP, "objective", name, ObjectiveNotFoundError)
    return factory


def load_backend(name: str) -> BackendFactory:
    """The factory of the backend called `name`.

    Raises
    ------
    BackendNotFoundError
        If no distribution, or more than one, announces it, or its factory cannot be imported; with the fix.
    """
    factory: BackendFactory = _load(BACKEND_GROUP, "backend", name, BackendNotFoundError)
    return factory


def _available(group: str) -> list[PluginInfo]:
    points, broken = _points(group)
    listed = [
        _examine(point, [_origin(other)[0] for other in same])[1]
        for same in _announced(points).values()
        for point in same
    ]
    return sorted([*listed, *broken], key=lambda one: one.name) if broken else listed


def _load(group: str, kind: str, name: str, failure: type[LookupError]) -> Any:
    announced = _announced(_points(group)[0])
    if name not in announced:
        msg = f"no {kind} is called {name!r}; installed are {', '.join(announced) or 'none'}"
        raise failure(msg)
    points = announced[name]
    factory, info = _examine(points[0], [_origin(point)[0] for point in points])
    if factory is None:
        msg = f"{kind} {name!r} of {info.package} cannot be used: {info.problem}; {info.fix}"
        raise failure(msg)
    return factory


def _examine(point: EntryPoint, claims: list[str]) -> tuple[Callable[..., Any] | None, PluginInfo]:
    """The factory of one entry point, or None, and what there is to say about it."""
    package, version = _origin(point)
    if EntryPoint.pattern.match(point.value) is None:
        fix = _reinstall(package)
        problem = f"{shown(point.value)} is not a module and an object in it"
        return None, PluginInfo(point.name, package, version, "", point.value, "broken", problem, fix)
    extra = point.extras[0] if point.extras else ""
    target = f"{point.module}:{point.attr}"
    if len(claims) > 1:
        fix = f"pip uninstall all but one of {', '.join(sorted(claims))}"
        info = PluginInfo(point.name, package, version, extra, target, "clash", f"{len(claims)} claim it", fix)
        return None, info
    try:
        with contextlib.redirect_stdout(sys.stderr):  # what a plugin prints is not part of our answer
            factory = point.load()
            problem = _unusable(factory, target)
            backend = str(getattr(factory, "backend", extra))
    except BaseException as error:  # a plugin may raise anything, SystemExit too; the listing must go on
        if is_ctrl_c(error):
            raise
        problem = described(error)
        if extra and isinstance(error, ModuleNotFoundError):
            fix = f"pip install '{package}[{extra}]'"
            return None, PluginInfo(point.name, package, version, extra, target, "missing", problem, fix)
    else:
        if not problem:
            return factory, PluginInfo(point.name, package, version, backend, target, "ready")
    return None, PluginInfo(point.name, package, version, extra, target, "broken", problem, _reinstall(package))


def _reinstall(package: str) -> str:
    return f"pip install --upgrade --force-reinstall {package}"


def _unusable(factory: object, target: str) -> str:
    """Why this cannot be called, which happens with options by keyword if at all; empty if it can."""
    if not callable(factory):
        return f"{target} is a {type(factory).__name__}, not a factory that can be called"
    try:
        parameters = signature(factory).parameters.values()
    except (TypeError, ValueError):  # compiled factories need not say what they take
        return ""
    for one in parameters:
        if one.kind is Parameter.POSITIONAL_ONLY and one.default is Parameter.empty:
            return f"{target} takes `{one.name}` by position only; the options of a scene come by keyword"
    return ""


def _points(group: str) -> tuple[list[EntryPoint], list[PluginInfo]]:
    """The entry points of a group, and the distributions whose entry points cannot be read."""
    try:
        return list(entry_points(group=group)), []
    except Exception:  # noqa: BLE001 - one distribution with damaged metadata ends the search; so they are asked one by one
        return _points_one_by_one(group)


def _points_one_by_one(group: str) -> tuple[list[EntryPoint], list[PluginInfo]]:
    points: list[EntryPoint] = []
    broken: list[PluginInfo] = []
    seen: set[str] = set()
    for distribution in distributions():
        package = _described(distribution)[0]
        if package in seen:  # hidden by one that is earlier on the path
            continue
        seen.add(package)
        try:
            points += [point for point in distribution.entry_points if point.group == group]
        except Exception as error:  # noqa: BLE001 - likewise
            problem = f"its entry points cannot be read: {described(error)}"
            broken.append(PluginInfo(package, package, "", "", "", "broken", problem, _reinstall(package)))
    return points, broken


def _announced(points: Iterable[EntryPoint]) -> dict[str, list[EntryPoint]]:
    """Entry points by name, sorted; the same one seen twice (an editable install on two paths) counts once."""
    by_name: dict[str, dict[tuple[str, str], EntryPoint]] = defaultdict(dict)
    for point in points:
        by_name[point.name].setdefault((_origin(point)[0], point.value), point)
    return {name: list(by_name[name].values()) for name in sorted(by_name)}


def _origin(point: EntryPoint) -> tuple[str, str]:
    return ("unknown", "") if point.dist is None else _described(point.dist)


def _described(distribution: Distribution) -> tuple[str, str]:
    """Name and version, which damaged metadata may lack."""
    try:
        metadata = distribution.metadata
        name, version = (metadata[key] or "" if key in metadata else "" for key in ("Name", "Version"))
        return name or "unknown", version
    except Exception:  # noqa: BLE001 - metadata that cannot be read at all
        return "unknown", ""
