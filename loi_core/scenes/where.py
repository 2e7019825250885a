"""Values out of a scene's tables, with errors that name the file, the table and the key."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from loi_core.errors import SceneError
from loi_core.io.files import check_writable
from loi_core.support.wording import shown

__all__ = ["Where"]


@dataclass(frozen=True)
class Where:
    """Reads values out of a scene's tables; its errors name the file, the table and the key."""

    path: Path

    def error(self, table: str, message: str) -> SceneError:
        """What is wrong in a table; the document itself has no name."""
        return SceneError(f"{self.path}: {f'[{table}] ' if table else ''}{message}")

    def known(self, name: str, table: Mapping[str, Any], keys: tuple[str, ...]) -> None:
        """Raise :class:`SceneError` if a table has other keys than these."""
        for key in table:
            if key not in keys:
                near = get_close_matches(key, keys, 1)
                hint = f"did you mean `{near[0]}`?" if near else f"known are {', '.join(keys)}"
                raise self.error(name, f"unknown key `{key}`; {hint}")

    def table(self, name: str, parent: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        """The table of this key; an empty one if there is none."""
        value = parent.get(key, {})
        if not isinstance(value, Mapping):
            raise self.error(name, f"`{key}` must be a table, got {shown(value)}")
        return value

    def text(self, name: str, table: Mapping[str, Any], key: str) -> str:
        """The text of this key."""
        value = table[key]
        if not isinstance(value, str) or not value or "\0" in value:
            raise self.error(name, f"`{key}` must be a text that is not empty, got {shown(value)}")
        return value

    def check_output(self, results: Path, *, own: bool, of: str, beside: str) -> None:
        """Check the folder for what comes of a file, which may lie elsewhere if `own` is False: the user has said so.

        Parameters
        ----------
        results : Path
        own : bool
            Whether the file itself names it.
        of, beside : str
            What the file is, "scene" or "sweep"; and what else is in its folder, with a space before.

        Raises
        ------
        OptionError
            If it cannot be written to.
        SceneError
            If it is not a folder of its own, or not within that of the file.
        """
        check_writable("output", results)
        home, there = (os.path.realpath(path) for path in (self.path.parent, results))
        if own and not Path(there).is_relative_to(home):
            got = shown(str(results))
            raise self.error("", f"`output` must lie in the folder of the {of}, got {got}; use --output")
        if home == there:
            raise self.error("", f"`output` must be a folder of its own, not that of the {of}{beside}")
