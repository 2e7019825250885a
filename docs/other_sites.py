"""Check the links to other sites: ``python docs/other_sites.py``. Without a network it exits with 0."""

from __future__ import annotations

import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import Final

from sphinx.cmd.build import main as sphinx

DOCS: Final = Path(__file__).parent
PROBE_SITES: Final = ("https://toml.io", "https://www.python.org")  # without an answer from either, there is no network


def main() -> int:
    """Return the exit status of the check, 0 without a network."""
    if not any(_answers(site) for site in PROBE_SITES):
        print("no network: links to other sites were NOT checked; all links within this site were, by the build")
        return 0
    build = DOCS / "_build"
    status: int = sphinx(["-b", "linkcheck", "-q", "-d", str(build / "doctrees"), str(DOCS), str(build / "linkcheck")])
    return status


def _answers(address: str) -> bool:
    try:
        with urllib.request.urlopen(address, timeout=10):  # noqa: S310 - an address of ours
            return True
    except urllib.error.HTTPError:
        return True
    except OSError:
        return False


if __name__ == "__main__":
    sys.exit(main())
