"""The HTML page around a report: its style, its script, and a policy that loads nothing else."""

from __future__ import annotations

import base64
import hashlib
import json
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

__all__ = ["REPORT", "asset", "data_uri", "document", "embedded_json", "is_made_by", "scrollable"]

REPORT: Final = "loi report"
GENERATOR_BYTES: Final = 4096  # at the beginning of a page: they name the command that made it


def asset(name: str, package: str = "loi_core.report") -> str:
    """Return a file of a package, such as a style sheet or a script, as text."""
    return files(package).joinpath(name).read_text(encoding="utf-8")


def is_made_by(page: Path, command: str) -> bool:
    """Return whether a file is a page that `command` wrote."""
    try:
        with page.open("rb") as stream:
            return _generator(command).encode() in stream.read(GENERATOR_BYTES)
    except OSError:
        return False


def document(title: str, body: str, *, style: str = "", script: str = "", command: str = REPORT) -> str:
    """Return a whole HTML page.

    Parameters
    ----------
    title : str
        As plain text.
    body : str
        As HTML.
    style, script : str
        The style sheet after ``theme.css``, and the script.
    command : str
        The command that makes the page.
    """
    styles = asset("theme.css") + style
    policy = f"default-src 'none'; img-src data:; style-src {_digest(styles)}; "
    policy += f"script-src {_digest(script)}; " if script else ""
    head = (
        '<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" '
        f"content=\"{policy}base-uri 'none'; form-action 'none'\">"
        f'<meta name="viewport" content="width=device-width, initial-scale=1">{_generator(command)}'
        f"<title>{escape(title)}</title><style>{styles}</style>"
    )
    element = f"<script>{script}</script>\n" if script else ""
    return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n{element}</body></html>\n'


def embedded_json(value: Any) -> str:
    """Return `value` as JSON for a script element: no text in it ends the element or begins a comment."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def data_uri(content: bytes, media_type: str = "image/png") -> str:
    """Return a file as a URI that contains it."""
    return f"data:{media_type};base64,{base64.b64encode(content).decode('ascii')}"


def scrollable(label: str, html: str, tag: str = "div") -> str:
    """Return an element that scrolls sideways, by keyboard too, with a name for screen readers."""
    return f'<{tag} class="scroll" role="group" tabindex="0" aria-label="{escape(label)}">{html}</{tag}>'


def _generator(command: str) -> str:
    return f'<meta name="generator" content="{command}">'


def _digest(content: str) -> str:
    digest = hashlib.sha256(content.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
