"""``loi completion``: a script that lets a shell complete commands, options and files."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import shtab

from loi_core.cli.codes import DONE

__all__ = ["completion_script", "run"]


def run(options: argparse.Namespace) -> int:
    """Print the script for a shell."""
    print(completion_script(options.root, options.shell))
    return DONE


def completion_script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Return the script that completes the arguments of a parser in a shell, "bash", "zsh" or "fish"."""
    for action in _actions(parser):
        if action.type is Path:
            action.complete = shtab.FILE  # type: ignore[attr-defined]  # shtab looks for it there
    script: str = shtab.complete(parser, shell)
    return script


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the actions of a parser and of its subparsers."""
    for action in parser._actions:  # argparse has no public way to them
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _actions(command)
