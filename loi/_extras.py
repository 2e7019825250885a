"""The error of a module whose extra is not installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from loi_core.support.installed import how_to_install


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Raise a ModuleNotFoundError with the extra to install if an import misses a package."""
    try:
        yield
    except ModuleNotFoundError as error:
        msg = f"the package {error.name} is not installed: {how_to_install(name)}"
        raise ModuleNotFoundError(msg, name=error.name) from error
