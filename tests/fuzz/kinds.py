"""Every kind of input."""

from __future__ import annotations

from typing import Final

from tests.fuzz import commands, images, plugins, results, scenes, vectors
from tests.fuzz.claims import Kind

__all__ = ["KINDS"]

# Images may be of up to 64 megapixels, and a damaged header may say so: decoders take a gigabyte before they see that
# the rest is missing.
PIXELS: Final = 1280

FRAMEWORKS: Final = 1024  # `loi renderers` imports every framework, once

KINDS: Final = (
    Kind("PNG", images.pngs, weight=6, megabytes=PIXELS),
    Kind("JPEG", images.jpegs, weight=5, megabytes=PIXELS),
    Kind("EXR", images.exrs, weight=1, megabytes=PIXELS),
    Kind("NPY", images.npys, weight=6),
    Kind("bombs", images.bombs, megabytes=PIXELS),
    Kind("SVG, damaged", vectors.damaged_svgs, weight=3),
    Kind("SVG, any value", vectors.svg_values, weight=4),
    Kind("scene files, damaged", scenes.damaged_scenes, weight=4),
    Kind("scene files, any value", scenes.values, weight=8),
    Kind("scene files, nests", scenes.nests),
    Kind("checkpoints", results.checkpoints, weight=3, writes=True),
    Kind("result folders", results.reports, writes=True),
    Kind("command lines", commands.command_lines, weight=2, writes=True, megabytes=FRAMEWORKS),
    Kind("places", commands.places, writes=True),
    Kind("plugins", plugins.entry_points, weight=4),
    Kind("renderers of others", plugins.factories),
    Kind("metadata of packages", plugins.metadata),
)
