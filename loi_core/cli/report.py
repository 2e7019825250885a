"""``loi report``."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from loi_core.errors import OptionError
from loi_core.report import write_index, write_page

__all__ = ["make_report"]

PAGE: Final = "report.html"


def make_report(folders: list[Path], output: Path | None) -> None:
    """Make the page of a result folder in it, or one page of several, and print where it is."""
    if len(folders) > 1:
        page = write_index(Path(PAGE) if output is None else output, folders, f"{len(folders)} fits")
    elif output is None:
        page = write_page(folders[0])
    else:
        msg = "`--output` goes with several folders; the page of one lies in it"
        raise OptionError(msg)
    print(page)
