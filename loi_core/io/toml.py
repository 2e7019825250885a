"""Read TOML files of bounded size."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, Final

from loi_core.errors import SceneError
from loi_core.io.files import read_bytes
from loi_core.support.wording import described, shown

__all__ = ["read_toml"]

MAX_BYTES: Final = 8 * 2**20  # images and meshes lie in files of their own
MAX_KEY_PARTS: Final = 32  # `tomllib` takes quadratic time for the parts of a dotted key

# Strings and comments, complete or cut off by the end of the file. The possessive quantifiers never backtrack.
STRING_OR_COMMENT: Final = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"""|\Z)'
    r"|'''(?:[^']|'(?!''))*+(?:'''|\Z)"
    r'|"(?:[^"\\\n]|\\.)*+(?:"|$)'
    r"|'[^'\n]*+(?:'|$)"
    r"|#[^\n]*+",
    re.DOTALL | re.MULTILINE,
)
LONG_KEY: Final = re.compile(rf"[\w-]*\.(?:[\w \t-]*+\.){{{MAX_KEY_PARTS - 1}}}")


def read_toml(path: Path) -> dict[str, Any]:
    """Return the document in a TOML file.

    Raises
    ------
    SceneError
        If the file is missing, not a regular file, larger than 8 MiB, not UTF-8 or not TOML, or has a key of more than
        32 parts.
    """
    try:
        text = read_bytes(path, MAX_BYTES).decode("utf-8")
        long_key = LONG_KEY.search(STRING_OR_COMMENT.sub("", text)) if text.count(".") >= MAX_KEY_PARTS else None
        if long_key is None:
            return tomllib.loads(text)
    except FileNotFoundError:
        msg = f"{path}: no such scene file"
        raise SceneError(msg) from None
    except (OSError, ValueError, RecursionError) as error:  # damage in the file, its UTF-8 or its TOML
        hint = '; texts stand in quotes, name = "text"' if "Invalid value" in str(error) else ""
        msg = f"{path}: not a readable TOML file ({described(error)}){hint}"
        raise SceneError(msg) from error
    msg = f"{path}: keys may have at most {MAX_KEY_PARTS} parts, got {shown(long_key[0])}"
    raise SceneError(msg)
