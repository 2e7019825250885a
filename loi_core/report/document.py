"""A whole page around what it shows: its style, its script, and a policy that lets it load nothing else."""

from __future__ import annotations

import base64
import hashlib
import json
from html import escape
from typing import Any, Final

from loi_core.report.theme import asset

__all__ = ["MADE_BY", "document", "embedded_json"]

MADE_BY: Final = '<meta name="generator" content="loi report">'
"""What tells a page of several runs from somebody's own."""


def document(title: str, body: str, *, style: str = "", script: str = "", served: bool = False) -> str:
    """A whole HTML page around `body`.

    Parameters
    ----------
    title, body : str
        The first is escaped, the second is not.
    style, script : str
        Files of this package that the page needs beside ``theme.css``.
    served : bool
        Whether it may ask its own server for more.
    """
    styles = asset("theme.css") + (asset(style) if style else "")
    code = asset(script) if script else ""
    own = " 'self'" if served else ""
    policy = [f"default-src 'none'; img-src data:{own}; style-src {_digest(styles)}"]
    policy += [f"script-src {_digest(code)}"] if code else []
    policy += ["connect-src 'self'"] if served else []
    policy += ["base-uri 'none'; form-action 'none'"]
    head = (
        f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{"; ".join(policy)}">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">{MADE_BY}'
        f"<title>{escape(title)}</title><style>{styles}</style>"
    )
    end = f"<script>{code}</script>\n" if code else ""
    return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n{end}</body></html>\n'


def embedded_json(value: Any) -> str:
    """`value` as JSON that may stand in a script element: nothing in it ends that, or begins a comment."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _digest(content: str) -> str:
    digest = hashlib.sha256(content.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
