"""The command ``loi``."""

from loi_core.cli.main import main

__all__ = ["main"]
