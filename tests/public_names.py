"""Public names and their arguments: ``python -m tests.public_names > tests/data/public_names.txt``."""

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
    "loi_torch.kornia",
    "loi_torch.kornia.cameras",
    "loi_torch.mesh",
    "loi_torch.vector",
    "loi_jax",
    "loi_mitsuba",
    "mitsuba_boundaries",
)


def lines() -> Iterator[str]:
    """Yield functions and classes with their arguments, public methods of classes, and other names with their types."""
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
        for method, attribute in sorted(vars(thing).items()):
            if not method.startswith("_"):
                bound = getattr(thing, method)
                yield f"    .{method}{_arguments(bound) if callable(bound) else ''}" + (
                    " (property)" if isinstance(attribute, property) else ""
                )


def _arguments(thing: Any) -> str:
    if inspect.isclass(thing) and issubclass(thing, Exception) and "__init__" not in vars(thing):
        return "(...)"  # the signature of built-in exceptions depends on the version of Python
    try:
        parameters = inspect.signature(thing).parameters.values()
    except (TypeError, ValueError):
        return "(...)"
    arguments = []
    star = False
    for parameter in parameters:
        passing = parameter.kind
        if passing is parameter.KEYWORD_ONLY and not star:
            arguments.append("*")
        star = star or passing in (parameter.KEYWORD_ONLY, parameter.VAR_POSITIONAL)
        prefix = "*" if passing is parameter.VAR_POSITIONAL else "**" if passing is parameter.VAR_KEYWORD else ""
        default = "" if parameter.default is parameter.empty else "=..."
        arguments.append(f"{prefix}{parameter.name}{default}")
    return f"({', '.join(arguments)})"


if __name__ == "__main__":
    print("\n".join(lines()))
