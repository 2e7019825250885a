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
from inspect import Parameter, signature
from typing import Final, Literal, TypeAlias

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
    mend : str
        The command that mends it; empty if it is ready.
    """

    name: str
    package: str
    version: str
    backend: str
    target: str
    state: Literal["ready", "missing", "broken", "clash"]
    problem: str = ""
    mend: str = ""


def available_renderers() -> list[RendererInfo]:
    """Every announced renderer, sorted by name. Each factory is imported to see whether it can be."""
    return [
        _examine(point, [_origin(other)[0] for other in points])[1]
        for points in _announced(entry_points(group=GROUP)).values()
        for point in points
    ]


def load_renderer(name: str) -> RendererFactory:
    """The factory of the renderer called `name`.

    Raises
    ------
    RendererNotFoundError
        If no distribution, or more than one, announces it, or its factory cannot be imported; with the mend.
    """
    announced = _announced(entry_points(group=GROUP))
    if name not in announced:
        msg = f"no renderer is called {name!r}; installed are {', '.join(announced) or 'none'}"
        raise RendererNotFoundError(msg)
    points = announced[name]
    factory, info = _examine(points[0], [_origin(point)[0] for point in points])
    if factory is None:
        msg = f"renderer {name!r} of {info.package} cannot be used: {info.problem}; {info.mend}"
        raise RendererNotFoundError(msg)
    return factory


def _examine(point: EntryPoint, claims: list[str]) -> tuple[RendererFactory | None, RendererInfo]:
    """The factory of one entry point, or None, and what there is to say about it."""
    package, version = _origin(point)
    extra = point.extras[0] if point.extras else ""
    target = f"{point.module}:{point.attr}"
    if len(claims) > 1:
        mend = f"pip uninstall all but one of {', '.join(sorted(claims))}"
        info = RendererInfo(point.name, package, version, extra, target, "clash", f"{len(claims)} claim it", mend)
        return None, info
    try:
        factory = point.load()
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a plugin may raise anything; the listing must go on
        problem = " ".join(f"{type(error).__name__}: {error}".split())
        if extra and isinstance(error, ModuleNotFoundError):
            mend = f"pip install '{package}[{extra}]'"
            return None, RendererInfo(point.name, package, version, extra, target, "missing", problem, mend)
    else:
        problem = _unusable(factory, target)
        if not problem:
            backend = getattr(factory, "backend", extra)
            return factory, RendererInfo(point.name, package, version, str(backend), target, "ready")
    mend = f"pip install --upgrade --force-reinstall {package}"
    return None, RendererInfo(point.name, package, version, extra, target, "broken", problem, mend)


def _unusable(factory: object, target: str) -> str:
    """Why scenes cannot call this, which they do with options by keyword; empty if they can."""
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


def _announced(points: Iterable[EntryPoint]) -> dict[str, list[EntryPoint]]:
    """Entry points by name, sorted; the same one seen twice (an editable install on two paths) counts once."""
    by_name: dict[str, dict[tuple[str, str], EntryPoint]] = defaultdict(dict)
    for point in points:
        by_name[point.name].setdefault((_origin(point)[0], point.value), point)
    return {name: list(by_name[name].values()) for name in sorted(by_name)}


def _origin(point: EntryPoint) -> tuple[str, str]:
    return (point.dist.name, point.dist.version) if point.dist is not None else ("unknown", "")
