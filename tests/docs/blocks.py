"""The code blocks of a page, and what becomes of them here."""

from __future__ import annotations

import contextlib
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Block", "blocks_of", "run_python"]


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes
    ----------
    language : str
        The word after the fence, or "".
    text : str
    line : int
        The line of the fence, from 1.
    """

    language: str
    text: str
    line: int


def blocks_of(page: Path) -> list[Block]:
    """All fenced blocks of a Markdown page, in order."""
    text = page.read_text(encoding="utf-8")
    return [
        Block(match[1].strip(), match[2], text.count("\n", 0, match.start()) + 1)
        for match in re.finditer(r"^```([^\n]*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    ]


def run_python(page: Path, namespace: dict[str, Any], *, shortened: bool = False) -> int:
    """Run the Python blocks of a page one after another, as a reader would; how many there were.

    A block of ``text`` right behind one is what that prints. With `shortened`, fits take three steps.
    """
    blocks, count = blocks_of(page), 0
    for block, following in zip(blocks, [*blocks[1:], Block("", "", 0)], strict=True):
        if block.language.split(" ")[0] != "python":
            continue
        count += 1
        text = re.sub(r"(?<=steps=)\d+|(?<=range\()\d+", "3", block.text) if shortened else block.text
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            # The lines of the page, so that a traceback shows where in it.
            exec(compile("\n" * block.line + text, str(page), "exec"), namespace)  # noqa: S102
        if following.language == "text":
            assert printed.getvalue() == following.text, f"{page.name}, line {block.line}, prints\n{printed.getvalue()}"
    return count
