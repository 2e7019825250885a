"""Libraries that may be missing, and the command that installs them."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import json
import shlex
from pathlib import Path
from types import ModuleType

__all__ = ["how_to_install", "import_library"]


def import_library(name: str) -> ModuleType:
    """Import a library, and take a mere folder of that name for a missing library.

    Python imports any folder on its path as an empty package, such as a folder `torch` beside a program.

    Raises
    ------
    ModuleNotFoundError
        If there is no such library.
    """
    spec = importlib.util.find_spec(name)
    if spec is None or spec.origin is None:
        msg = f"No module named {name!r}"
        raise ModuleNotFoundError(msg, name=name)
    return importlib.import_module(name)


def how_to_install(extra: str, package: str = "loi") -> str:
    """Return the command that installs an extra of a package, from the package's clone if it was installed from one."""
    clone = _clone(package)
    if clone is None:
        return f"pip install '{package}[{extra}]'"
    constraints = clone / "constraints.txt"
    option = f"-c {shlex.quote(str(constraints))} " if constraints.is_file() else ""
    return f"pip install {option}-e {shlex.quote(f'{clone}[{extra}]')}"


def _clone(package: str) -> Path | None:
    """Return the folder of the sources of a package that was installed with ``pip install -e``, or None."""
    # Imported here, since sockets and encryption take a tenth of the time to import loi.
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    try:
        text = importlib.metadata.distribution(package).read_text("direct_url.json")
        origin = json.loads(text) if text else {}
        if not origin.get("dir_info", {}).get("editable", False):
            return None
        folder = Path(url2pathname(urlsplit(origin["url"]).path))
    except (importlib.metadata.PackageNotFoundError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return folder if folder.is_dir() else None
