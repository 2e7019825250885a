"""Reading a TOML file that may hold anything: it comes as plain values, in time proportional to its size, or not."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, Final

from loi_core.errors import SceneError
from loi_core.io.files import read_bytes
from loi_core.support.wording import described, shown

__all__ = ["read_toml"]

MOST_BYTES: Final = 8 * 2**20  # images and meshes lie in files of their own
MOST_PARTS: Final = 32  # of a dotted key; for thousands, `tomllib` takes time that grows with their square

# Texts and comments, whole or cut off by the end; nothing in them is a key. Never backtracks.
TEXTS: Final = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"""|\Z)'
    r"|'''(?:[^']|'(?!''))*+(?:'''|\Z)"
    r'|"(?:[^"\\\n]|\\.)*+(?:"|$)'
    r"|'[^'\n]*+(?:'|$)"
    r"|#[^\n]*+",
    re.DOTALL | re.MULTILINE,
)
LONG_KEY: Final = re.compile(rf"[\w-]*\.(?:[\w \t-]*+\.){{{MOST_PARTS - 1}}}")


def read_toml(path: Path) -> dict[str, Any]:
    """The document in a TOML file.

    Raises
    ------
    SceneError
        If it is missing, not a regular file, larger than 8 MiB, not UTF-8 or not TOML, or has a key of more than 32
        parts or a nest of some hundred levels.
    """
    try:
        text = read_bytes(path, MOST_BYTES).decode("utf-8")
        long = LONG_KEY.search(TEXTS.sub("", text)) if text.count(".") >= MOST_PARTS else None
        if long is None:
            return tomllib.loads(text)
    except FileNotFoundError:
        msg = f"{path}: no such scene file"
        raise SceneError(msg) from None
    except (OSError, ValueError, RecursionError) as error:  # damage in the file, its UTF-8 or its TOML
        hint = '; texts stand in quotes, name = "text"' if "Invalid value" in str(error) else ""
        msg = f"{path}: not a readable TOML file ({described(error)}){hint}"
        raise SceneError(msg) from error
    msg = f"{path}: keys may have at most {MOST_PARTS} parts, got {shown(long[0])}"
    raise SceneError(msg)
