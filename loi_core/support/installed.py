"""How to install what is missing."""

from __future__ import annotations

import importlib.metadata
import json
import shlex
from pathlib import Path

__all__ = ["how_to_install"]


def how_to_install(extra: str, package: str = "loi") -> str:
    """The command that brings an extra of a package: from its clone if it was installed from one, or from an index."""
    clone = _clone(package)
    if clone is None:
        return f"pip install '{package}[{extra}]'"
    pinned = clone / "constraints.txt"
    held = f"-c {shlex.quote(str(pinned))} " if pinned.is_file() else ""
    return f"pip install {held}-e {shlex.quote(f'{clone}[{extra}]')}"


def _clone(package: str) -> Path | None:
    """The folder of a package that is used from where its sources are (``pip install -e``), or None."""
    # Here, for they load what makes up a tenth of the time to import loi: sockets and encryption.
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    try:
        said = importlib.metadata.distribution(package).read_text("direct_url.json")
        origin = json.loads(said) if said else {}
        if not origin.get("dir_info", {}).get("editable", False):
            return None
        folder = Path(url2pathname(urlsplit(origin["url"]).path))
    except (importlib.metadata.PackageNotFoundError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return folder if folder.is_dir() else None
