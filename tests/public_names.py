"""The public names and their arguments: ``python -m tests.public_names > tests/data/public_names.txt``."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator
from typing import Any, Final

PACKAGES: Final = (
    "loi_core",
    "loi_core.objectives",
    "loi_core.runs",
    "loi_core.stability",
    "loi_core.sweeps",
    "loi_core.testing",
    "loi_torch",
    "loi_torch.mesh",
    "loi_torch.vector",
    "loi_jax",
    "loi_mitsuba",
)


def lines() -> Iterator[str]:
    """Functions and classes with their arguments, public methods of classes below them, other names with their type."""
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in sorted(module.__all__):
            yield from _described(f"{package}.{name}", getattr(module, name))


def _described(name: str, thing: Any) -> Iterator[str]:
    if not callable(thing):
        yield f"{name}: {type(thing).__name__}"
        return
    yield f"{name}{_arguments(thing)}"
    if inspect.isclass(thing):
        for method, what in sorted(vars(thing).items()):
            if not method.startswith("_"):
                bound = getattr(thing, method)
                yield f"    .{method}{_arguments(bound) if callable(bound) else ''}" + (
                    " (property)" if isinstance(what, property) else ""
                )


def _arguments(thing: Any) -> str:
    if inspect.isclass(thing) and issubclass(thing, Exception) and "__init__" not in vars(thing):
        return "(...)"  # that of the built-in one, which differs from one Python to the next
    try:
        parameters = inspect.signature(thing).parameters.values()
    except (TypeError, ValueError):
        return "(...)"
    parts = []
    star = False
    for one in parameters:
        if one.kind is one.KEYWORD_ONLY and not star:
            parts.append("*")
        star = star or one.kind in (one.KEYWORD_ONLY, one.VAR_POSITIONAL)
        prefix = "*" if one.kind is one.VAR_POSITIONAL else "**" if one.kind is one.VAR_KEYWORD else ""
        default = "" if one.default is one.empty else "=..."
        parts.append(f"{prefix}{one.name}{default}")
    return f"({', '.join(parts)})"


if __name__ == "__main__":
    print("\n".join(lines()))
