"""``loi renderers``."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict

from loi_core.cli.codes import DONE
from loi_core.plugins.registry import available_renderers

__all__ = ["run"]


def run(options: argparse.Namespace) -> int:
    """Print every registered renderer, its package, and whether it can be loaded."""
    renderers = available_renderers()
    if options.json:
        print(json.dumps([asdict(info) for info in renderers], indent=2))
        return DONE
    for info in renderers:
        detail = f"{info.package} {info.version}  {info.problem or info.target}"
        print(f"{info.name:<16} {info.backend or '-':<8} {info.state:<7} {detail}")
        if info.fix:
            print(f"{'':<16} fix: {info.fix}")
    return DONE
