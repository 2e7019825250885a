"""Registry of installed renderers, objectives and measurement backends.

They are announced by entry points in the groups ``loi.renderers``, ``loi.objectives`` and ``loi.backends``. The name of
an entry point is the name of the plugin, and its object is a factory. The factory of a renderer takes the options of a
scene and returns a :class:`loi_core.Renderer`. The factory of an objective takes the reference, ``nan_policy`` and
``tone``, like :class:`loi_core.PixelL2`. The factory of a backend takes no arguments and returns a
:class:`loi_core.plugins.measurement_backends.MeasurementBackend`. A plugin that
cannot be loaded is reported by name and hides no other.
``LOI_PLUGINS=0`` leaves out the plugins of other distributions.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import Distribution, EntryPoint, distributions, entry_points
from inspect import Parameter, signature
from typing import Any, Final, Generic, Literal, TypeAlias, TypeVar, cast

from loi_core.errors import BackendNotFoundError, ObjectiveNotFoundError, RendererNotFoundError
from loi_core.objectives import Objective
from loi_core.plugins.measurement_backends import MeasurementBackend
from loi_core.renderers.contract import Renderer
from loi_core.support.guards import is_ctrl_c
from loi_core.support.installed import how_to_install
from loi_core.support.wording import described, shown

__all__ = [
    "BACKENDS",
    "OBJECTIVES",
    "RENDERERS",
    "BackendFactory",
    "ObjectiveFactory",
    "PluginGroup",
    "PluginInfo",
    "RendererFactory",
    "available_renderers",
    "load_renderer",
]

SWITCH: Final = "LOI_PLUGINS"
"""Environment variable; 0 ignores the plugins of other distributions."""

OWN_DISTRIBUTION: Final = "loi"

RendererFactory: TypeAlias = Callable[..., Renderer]
ObjectiveFactory: TypeAlias = Callable[..., Objective]
BackendFactory: TypeAlias = Callable[[], MeasurementBackend]
FactoryT = TypeVar("FactoryT")


@dataclass(frozen=True)
class PluginInfo:
    """One announced renderer, objective or backend.

    Attributes
    ----------
    name : str
        Name in scenes and commands.
    package, version : str
        The distribution that announces it.
    backend : str
        Its array library: the attribute ``backend`` of the factory, or else the extra of its entry point; empty
        without either.
    target : str
        The factory, ``module:object``.
    state : {"ready", "missing", "broken", "clash"}
        "missing" if a package of an extra is not installed; "broken" if the factory cannot be imported or called for
        another reason; "clash" if several distributions use the name.
    problem : str
        The problem on one line; empty if it is ready.
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


@dataclass(frozen=True)
class PluginGroup(Generic[FactoryT]):
    """One group of entry points.

    Attributes
    ----------
    name : str
        Name of the group.
    plugin : str
        Kind of its plugins, for messages.
    failure : type of LookupError
        Error for a plugin that cannot be loaded.
    """

    name: str
    plugin: str
    failure: type[LookupError]

    def available(self) -> list[PluginInfo]:
        """Return all announced plugins, sorted by name. Each factory is imported to test it."""
        points, broken = _points(self.name)
        listed = [
            _examine(point, [_origin(namesake)[0] for namesake in namesakes])[1]
            for namesakes in _announced(points).values()
            for point in namesakes
        ]
        return sorted([*listed, *broken], key=lambda info: info.name) if broken else listed

    def names(self) -> list[str]:
        """Return all announced names, sorted, without imports."""
        return list(_announced(_points(self.name)[0]))

    def load(self, name: str) -> FactoryT:
        """Return the factory of the plugin called `name`.

        Raises
        ------
        LookupError
            Of type `failure`, with the fix: if no distribution, or more than one, announces the name, or the factory
            cannot be imported.
        """
        announced = _announced(_points(self.name)[0])
        if name not in announced:
            msg = f"no {self.plugin} is called {name!r}; installed are {', '.join(announced) or 'none'}"
            raise self.failure(msg)
        points = announced[name]
        factory, info = _examine(points[0], [_origin(point)[0] for point in points])
        if factory is None:
            msg = f"{self.plugin} {name!r} of {info.package} cannot be used: {info.problem}; {info.fix}"
            raise self.failure(msg)
        return cast("FactoryT", factory)


RENDERERS: Final = PluginGroup[RendererFactory]("loi.renderers", "renderer", RendererNotFoundError)
OBJECTIVES: Final = PluginGroup[ObjectiveFactory]("loi.objectives", "objective", ObjectiveNotFoundError)
BACKENDS: Final = PluginGroup[BackendFactory]("loi.backends", "backend", BackendNotFoundError)


def available_renderers() -> list[PluginInfo]:
    """Return all announced renderers, sorted by name. Each factory is imported to test it."""
    return RENDERERS.available()


def load_renderer(name: str) -> RendererFactory:
    """Return the factory of the renderer called `name`.

    Raises
    ------
    RendererNotFoundError
        If no distribution, or more than one, announces it, or its factory cannot be imported; with the fix.
    """
    return RENDERERS.load(name)


def _examine(point: EntryPoint, claims: list[str]) -> tuple[Callable[..., Any] | None, PluginInfo]:
    """Return the factory of an entry point, or None, and its information."""
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
        with contextlib.redirect_stdout(sys.stderr):  # output of plugins must not mix with output for programs
            factory = point.load()
            problem = _unusable(factory, target)
            backend = str(getattr(factory, "backend", extra))
    except BaseException as error:  # a plugin may raise anything, SystemExit too; the listing must go on
        if is_ctrl_c(error):
            raise
        problem = described(error)
        if extra and isinstance(error, ModuleNotFoundError):
            fix = how_to_install(extra, package)
            return None, PluginInfo(point.name, package, version, extra, target, "missing", problem, fix)
    else:
        if not problem:
            return factory, PluginInfo(point.name, package, version, backend, target, "ready")
    return None, PluginInfo(point.name, package, version, extra, target, "broken", problem, _reinstall(package))


def _reinstall(package: str) -> str:
    return f"pip install --upgrade --force-reinstall {package}"


def _unusable(factory: object, target: str) -> str:
    """Return the reason why a factory cannot be called with keyword arguments; empty if it can."""
    if not callable(factory):
        return f"{target} is a {type(factory).__name__}, not a factory that can be called"
    try:
        parameters = signature(factory).parameters.values()
    except (TypeError, ValueError):  # compiled factories may have no signature
        return ""
    for parameter in parameters:
        if parameter.kind is Parameter.POSITIONAL_ONLY and parameter.default is Parameter.empty:
            return f"{target} takes `{parameter.name}` by position only; the options of a scene come by keyword"
    return ""


def _points(group: str) -> tuple[list[EntryPoint], list[PluginInfo]]:
    """Return the entry points of a group, and the distributions whose entry points cannot be read."""
    try:
        points, broken = list(entry_points(group=group)), list[PluginInfo]()
    except Exception:  # noqa: BLE001 - damaged metadata of one distribution ends the search; search them one by one
        points, broken = _points_one_by_one(group)
    if os.environ.get(SWITCH) == "0":
        return [point for point in points if _origin(point)[0] == OWN_DISTRIBUTION], []
    return points, broken


def _points_one_by_one(group: str) -> tuple[list[EntryPoint], list[PluginInfo]]:
    points: list[EntryPoint] = []
    broken: list[PluginInfo] = []
    visited: set[str] = set()
    for distribution in distributions():
        package = _described(distribution)[0]
        if package in visited:  # shadowed by an earlier entry of the path
            continue
        visited.add(package)
        try:
            points += [point for point in distribution.entry_points if point.group == group]
        except Exception as error:  # noqa: BLE001 - likewise
            problem = f"its entry points cannot be read: {described(error)}"
            broken.append(PluginInfo(package, package, "", "", "", "broken", problem, _reinstall(package)))
    return points, broken


def _announced(points: Iterable[EntryPoint]) -> dict[str, list[EntryPoint]]:
    """Return entry points by name, sorted, without duplicates (such as an editable install on two paths)."""
    by_name: dict[str, dict[tuple[str, str], EntryPoint]] = defaultdict(dict)
    for point in points:
        by_name[point.name].setdefault((_origin(point)[0], point.value), point)
    return {name: list(by_name[name].values()) for name in sorted(by_name)}


def _origin(point: EntryPoint) -> tuple[str, str]:
    return ("unknown", "") if point.dist is None else _described(point.dist)


def _described(distribution: Distribution) -> tuple[str, str]:
    """Return the name and the version of a distribution, whose metadata may be damaged."""
    try:
        metadata = distribution.metadata
        name, version = (metadata[key] or "" if key in metadata else "" for key in ("Name", "Version"))
        return name or "unknown", version
    except Exception:  # noqa: BLE001 - metadata that cannot be read at all
        return "unknown", ""
