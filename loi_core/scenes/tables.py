"""Values from the tables of a TOML file, with errors that name the file, the table and the key."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from loi_core.errors import SceneError
from loi_core.io.files import check_writable
from loi_core.support.keywords import guess
from loi_core.support.wording import shown

__all__ = ["TableReader"]


@dataclass(frozen=True)
class TableReader:
    """Reads and checks values from the tables of one file.

    Attributes
    ----------
    path : Path
        The file, for error messages.
    """

    path: Path

    def error(self, heading: str, message: str) -> SceneError:
        """Return an error in the table with this heading, which is empty for the document itself."""
        return SceneError(f"{self.path}: {f'[{heading}] ' if heading else ''}{message}")

    def check_keys(self, heading: str, table: Mapping[str, Any], keys: tuple[str, ...]) -> None:
        """Raise :class:`SceneError` if a table has any other key than `keys`."""
        for key in table:
            if key not in keys:
                raise self.error(heading, f"unknown key `{key}`; {guess(key, keys)}")

    def table(self, heading: str, parent: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        """Return the table at `key`; an empty one if the key is missing."""
        value = parent.get(key, {})
        if not isinstance(value, Mapping):
            raise self.error(heading, f"`{key}` must be a table, got {shown(value)}")
        return value

    def text(self, heading: str, table: Mapping[str, Any], key: str) -> str:
        """Return the text at `key`, which must not be empty."""
        value = table[key]
        if not isinstance(value, str) or not value or "\0" in value:
            raise self.error(heading, f"`{key}` must be a text that is not empty, got {shown(value)}")
        return value

    def check_output(self, results: Path, *, from_file: bool, file_type: Literal["scene", "sweep"]) -> None:
        """Check the output folder of a scene or sweep file.

        Parameters
        ----------
        results : Path
        from_file : bool
            Whether the file names the folder, which then must lie within the folder of the file.
        file_type : {"scene", "sweep"}

        Raises
        ------
        OptionError
            If it is not writable.
        SceneError
            If it is the folder of the file itself, or lies outside without the user's consent.
        """
        check_writable("output", results)
        home, output = (os.path.realpath(path) for path in (self.path.parent, results))
        if from_file and not Path(output).is_relative_to(home):
            raise self.error(
                "", f"`output` must lie in the folder of the {file_type}, got {shown(str(results))}; use --output"
            )
        if home == output:
            contents = " and its images" if file_type == "scene" else ""
            raise self.error("", f"`output` must be a folder of its own, not that of the {file_type}{contents}")
