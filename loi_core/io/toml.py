"""Read TOML files of bounded size."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Final

from loi_core.errors import SceneError
from loi_core.io.files import read_bytes
from loi_core.support.wording import described

__all__ = ["read_toml"]

MAX_BYTES: Final = 8 * 2**20  # images and meshes lie in files of their own


def read_toml(path: Path) -> dict[str, Any]:
    """Return the document in a TOML file.

    Raises
    ------
    SceneError
        If the file is missing, not a regular file, larger than 8 MiB, not UTF-8 or not TOML.
    """
    try:
        return tomllib.loads(read_bytes(path, MAX_BYTES).decode("utf-8"))
    except FileNotFoundError:
        msg = f"{path}: no such scene file"
        raise SceneError(msg) from None
    except (OSError, ValueError, RecursionError) as error:  # damage in the file, its UTF-8 or its TOML
        hint = '; texts stand in quotes, name = "text"' if "Invalid value" in str(error) else ""
        msg = f"{path}: not a readable TOML file ({described(error)}){hint}"
        raise SceneError(msg) from error
