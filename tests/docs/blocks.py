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
        What stands behind the fence; "" for none.
    text : str
    line : int
        Of the fence, from 1.
    """

    language: str
    text: str
    line: int


def blocks_of(page: Path) -> list[Block]:
    """All fenced blocks of a Markdown page, in order."""
    text = page.read_text(encoding="utf-8")
    return [
        Block(found[1].strip(), found[2], text.count("\n", 0, found.start()) + 1)
        for found in re.finditer(r"^```([^\n]*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    ]


def run_python(page: Path, namespace: dict[str, Any], *, shortened: bool = False) -> int:
    """Run the Python blocks of a page one after another, as a reader would; how many there were.

    A block of ``text`` right behind one is what that prints. With `shortened`, fits take three steps.
    """
    blocks, count = blocks_of(page), 0
    for block, after in zip(blocks, [*blocks[1:], Block("", "", 0)], strict=True):
        if block.language.split(" ")[0] != "python":
            continue
        count += 1
        text = re.sub(r"(?<=steps=)\d+|(?<=range\()\d+", "3", block.text) if shortened else block.text
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            # The lines of the page, so that a traceback shows where in it.
            exec(compile("\n" * block.line + text, str(page), "exec"), namespace)  # noqa: S102
        if after.language == "text":
            assert printed.getvalue() == after.text, f"{page.name}, line {block.line}, prints\n{printed.getvalue()}"
    return count
