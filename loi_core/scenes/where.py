"""Values out of a scene's tables, with errors that name the file, the table and the key."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from loi_core.errors import SceneError
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
