"""``loi renderers``."""

from __future__ import annotations

import json
from dataclasses import asdict

from loi_core.plugins.registry import available_renderers

__all__ = ["list_renderers"]


def list_renderers(*, as_json: bool) -> None:
    """Print every announced renderer, with its package and whether it can be loaded."""
    listed = available_renderers()
    if as_json:
        print(json.dumps([asdict(one) for one in listed], indent=2))
        return
    for one in listed:
        what = f"{one.package} {one.version}  {one.problem or one.target}"
        print(f"{one.name:<16} {one.backend or '-':<8} {one.state:<7} {what}")
        if one.fix:
            print(f"{'':<16} fix: {one.fix}")
