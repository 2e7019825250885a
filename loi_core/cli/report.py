"""``loi report``."""

from __future__ import annotations

import argparse
from pathlib import Path

from loi_core.cli.codes import DONE
from loi_core.errors import OptionError
from loi_core.io.result_folder import PAGE_FILE
from loi_core.report import write_index, write_page

__all__ = ["run"]


def run(options: argparse.Namespace) -> int:
    """Write the page of one result folder into it, or one page of several, and print its path."""
    folders = options.folder
    if len(folders) > 1:
        page = write_index(options.output or Path(PAGE_FILE), folders, f"{len(folders)} fits")
    elif options.output is None:
        page = write_page(folders[0])
    else:
        msg = "`--output` goes with several folders; the page of one folder is written into it"
        raise OptionError(msg)
    print(page)
    return DONE
