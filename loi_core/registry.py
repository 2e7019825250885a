"""Which renderers are installed: the entry-point group ``loi.renderers``.

A distribution announces a renderer with an entry point whose name is the renderer's name and whose object is a
factory: called with the options of a scene, it returns something that keeps the contract of
:class:`loi_core.Renderer`. A plugin that cannot be loaded is reported by name and never hides the others.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final, Literal, TypeAlias

from loi_core.errors import RendererNotFoundError
from loi_core.renderer import Renderer

__all__ = ["GROUP", "RendererFactory", "RendererInfo", "available_renderers", "load_renderer"]

GROUP: Final = "loi.renderers"

RendererFactory: TypeAlias = Callable[..., Renderer]


@dataclass(frozen=True)
class RendererInfo:
    """One announced renderer.

    Attributes
    ----------
    name : str
        What scenes call it.
    package, version : str
        The distribution that announces it.
    target : str
        The factory, ``module:object``.
    state : {"ready", "broken", "clash"}
        "broken" if the factory cannot be imported or called; "clash" if several distributions claim the name.
    problem : str
        One line on what is wrong; empty if it is ready.
    """

    name: str
    package: str
    version: str
    target: str
    state: Literal["ready", "broken", "clash"]
    problem: str = ""


def available_renderers() -> list[RendererInfo]:
    """Every announced renderer, sorted by name. Each factory is imported to see whether it can be."""
    listed = []
    for name, points in _announced(entry_points(group=GROUP)).items():
        for point in points:
            package, version = _origin(point)
            if len(points) > 1:
                others = ", ".join(sorted(_origin(other)[0] for other in points))
                listed.append(RendererInfo(name, package, version, point.value, "clash", f"claimed by {others}"))
                continue
            problem = _try(point)[1]
            listed.append(RendererInfo(name, package, version, point.value, "broken" if problem else "ready", problem))
    return listed


def load_renderer(name: str) -> RendererFactory:
    """The factory of the renderer called `name`.

    Raises
    ------
    RendererNotFoundError
        If no distribution, or more than one, announces it, or its factory cannot be imported.
    """
    announced = _announced(entry_points(group=GROUP))
    if name not in announced:
        msg = f"no renderer is called {name!r}; installed are {', '.join(announced) or 'none'}"
        raise RendererNotFoundError(msg)
    points = announced[name]
    if len(points) > 1:
        owners = " and ".join(sorted(f"{_origin(point)[0]} ({point.value})" for point in points))
        msg = f"renderer {name!r} is claimed by {owners}; uninstall all but one"
        raise RendererNotFoundError(msg)
    factory: RendererFactory | None
    factory, problem = _try(points[0])
    if factory is None:
        msg = f"renderer {name!r} of {_origin(points[0])[0]} cannot be loaded: {problem}"
        raise RendererNotFoundError(msg)
    return factory


def _announced(points: Iterable[EntryPoint]) -> dict[str, list[EntryPoint]]:
    """Entry points by name, sorted; the same one seen twice (an editable install on two paths) counts once."""
    by_name: dict[str, dict[tuple[str, str], EntryPoint]] = defaultdict(dict)
    for point in points:
        by_name[point.name].setdefault((_origin(point)[0], point.value), point)
    return {name: list(by_name[name].values()) for name in sorted(by_name)}


def _origin(point: EntryPoint) -> tuple[str, str]:
    return (point.dist.name, point.dist.version) if point.dist is not None else ("unknown", "")


def _try(point: EntryPoint) -> tuple[Any, str]:
    try:
        factory = point.load()
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a plugin may raise anything; the listing must go on
        return None, f"{type(error).__name__}: {error}".splitlines()[0]
    if not callable(factory):
        return None, f"{point.value} is a {type(factory).__name__}, not a factory that can be called"
    return factory, ""
