"""The downloads of a page: tables, numbers, pictures and an animation, all inside the page itself."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any, Final

from loi_core.io.result_folder import HISTORY_FILE, RESULT_FILE, SCALES_FILE
from loi_core.report.animation import animation
from loi_core.report.document import data_uri
from loi_core.report.pictures import Pictures
from loi_core.report.viewer import frame_files

__all__ = ["downloads"]

MAX_TEXT_BYTES: Final = 2**23  # of a table inside a page
TABLES: Final = {HISTORY_FILE: "text/csv", SCALES_FILE: "text/csv", "parameters.json": "application/json"}
PICTURES: Final = {"initial": "initial.png", "target": "target.png", "final-0": "final.png", "error-0": "error.png"}


def downloads(pictures: Pictures, folder: Path, result: Mapping[str, Any]) -> str:
    """Return the section of links; the script fills in the links to pictures, which are in the page already."""
    stem = re.sub(r"[^A-Za-z0-9]+", "-", result["title"])[:40].strip("-").lower() or "fit"
    links, too_large = [], []
    for name, media_type in TABLES.items():
        text = pictures.text(name, MAX_TEXT_BYTES)
        if text:
            links.append(_link(stem, name, media_type, text.encode("utf-8")))
        elif pictures.size(name):
            too_large.append(name)
    content = json.dumps(result, indent=2).encode("utf-8", errors="replace")
    links.append(_link(stem, RESULT_FILE, "application/json", content))
    links += [
        f'<a class="save" hidden data-of="{key}" download="{escape(stem)}-{file}">{file}</a>'
        for key, file in PICTURES.items()
    ]
    frames = [png for png in map(pictures.read, frame_files(pictures, folder).values()) if png is not None]
    animated = animation(frames)
    if animated:
        links.append(_link(stem, "fit.webp", "image/webp", animated))
    note = f"<p>Too large for a page, and in its folder: {escape(', '.join(too_large))}.</p>" if too_large else ""
    items = "".join(f"<li>{link}</li>" for link in links)
    return f'<h2>Downloads</h2><ul class="downloads">{items}</ul>{note}'


def _link(stem: str, name: str, media_type: str, content: bytes) -> str:
    return f'<a download="{escape(stem)}-{escape(name)}" href="{data_uri(content, media_type)}">{escape(name)}</a>'
