"""What a page hands out: tables, numbers, pictures and an animation, all within the page itself."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any, Final

from loi_core.io.result_folder import HISTORY_FILE, RESULT_FILE, SCALES_FILE
from loi_core.report.animation import animation
from loi_core.report.kept import Pictures
from loi_core.report.viewer import frame_files

__all__ = ["downloads"]

MOST_TEXT: Final = 2**23  # bytes of a table that a page carries
TABLES: Final = {HISTORY_FILE: "text/csv", SCALES_FILE: "text/csv", "parameters.json": "application/json"}
PICTURES: Final = {"initial": "initial.png", "target": "target.png", "final-0": "final.png", "error-0": "error.png"}


def downloads(pictures: Pictures, folder: Path, result: Mapping[str, Any]) -> str:
    """Links to all of it. Those to pictures take them from the page, and so need its script."""
    stem = re.sub(r"[^A-Za-z0-9]+", "-", result["title"])[:40].strip("-").lower() or "fit"
    links, large = [], []
    for name, kind in TABLES.items():
        text = pictures.text(name, MOST_TEXT)
        if text:
            links.append(_link(stem, name, kind, text.encode("utf-8")))
        elif pictures.size(name):
            large.append(name)
    told = json.dumps(result, indent=2).encode("utf-8", errors="replace")
    links.append(_link(stem, RESULT_FILE, "application/json", told))
    links += [
        f'<a class="save" hidden data-of="{key}" download="{escape(stem)}-{file}">{file}</a>'
        for key, file in PICTURES.items()
    ]
    frames = [one for one in map(pictures.read, frame_files(pictures, folder).values()) if one is not None]
    moving = animation(frames)
    if moving:
        links.append(_link(stem, "fit.webp", "image/webp", moving))
    note = f"<p>Too large for a page, and in its folder: {escape(', '.join(large))}.</p>" if large else ""
    items = "".join(f"<li>{link}</li>" for link in links)
    return f'<h2>Downloads</h2><ul class="downloads">{items}</ul>{note}'


def _link(stem: str, name: str, kind: str, content: bytes) -> str:
    data = base64.b64encode(content).decode("ascii")
    return f'<a download="{escape(stem)}-{escape(name)}" href="data:{kind};base64,{data}">{escape(name)}</a>'
