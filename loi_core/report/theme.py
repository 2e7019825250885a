"""The style that all pages share."""

from __future__ import annotations

from importlib.resources import files

__all__ = ["asset"]


def asset(name: str) -> str:
    """A file of this package that goes into pages, such as ``theme.css``, as text."""
    return files("loi_core.report").joinpath(name).read_text(encoding="utf-8")
