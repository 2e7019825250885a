"""Checks the links to other sites: ``python docs/other_sites.py``. Without a network it says so, and is done."""

from __future__ import annotations

import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import Final

from sphinx.cmd.build import main as sphinx

HERE: Final = Path(__file__).parent
ASKED: Final = ("https://toml.io", "https://www.python.org")  # if neither answers, nothing will


def main() -> int:
    """The exit status of the check, 0 where there is no network."""
    if not any(_answers(one) for one in ASKED):
        print("no network: links to other sites were NOT checked; all links within this site were, by the build")
        return 0
    build = HERE / "_build"
    status: int = sphinx(["-b", "linkcheck", "-q", "-d", str(build / "doctrees"), str(HERE), str(build / "linkcheck")])
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
