"""A whole page around what it shows: its style, its script, and a policy that lets it load nothing else."""

from __future__ import annotations

import base64
import hashlib
import json
from html import escape
from pathlib import Path
from typing import Any, Final

from loi_core.report.theme import asset

__all__ = ["REPORT", "document", "embedded_json", "is_made_by"]

REPORT: Final = "loi report"
LOOKED_FOR: Final = 4096  # bytes at the beginning of a page that say what made it


def is_made_by(page: Path, command: str) -> bool:
    """Whether a file is a page that `command` made, and not somebody's own."""
    try:
        with page.open("rb") as stream:
            return _mark(command).encode() in stream.read(LOOKED_FOR)
    except OSError:
        return False


def document(
    title: str, body: str, *, style: str = "", script: str = "", served: bool = False, command: str = REPORT
) -> str:
    """A whole HTML page around `body`.

    Parameters
    ----------
    title, body : str
        The first is escaped, the second is not.
    style, script : str
        What the page needs beside ``theme.css``, as text.
    served : bool
        Whether it may ask its own server for more.
    command : str
        What made it.
    """
    styles = asset("theme.css") + style
    own = " 'self'" if served else ""
    policy = [f"default-src 'none'; img-src data:{own}; style-src {_digest(styles)}"]
    policy += [f"script-src {_digest(script)}"] if script else []
    policy += ["connect-src 'self'"] if served else []
    policy += ["base-uri 'none'; form-action 'none'"]
    head = (
        f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{"; ".join(policy)}">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">{_mark(command)}'
        f"<title>{escape(title)}</title><style>{styles}</style>"
    )
    end = f"<script>{script}</script>\n" if script else ""
    return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n{end}</body></html>\n'


def embedded_json(value: Any) -> str:
    """`value` as JSON that may stand in a script element: nothing in it ends that, or begins a comment."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _mark(command: str) -> str:
    return f'<meta name="generator" content="{command}">'


def _digest(content: str) -> str:
    digest = hashlib.sha256(content.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
