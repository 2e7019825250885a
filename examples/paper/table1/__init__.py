"""Table 1 of the paper: the positions of disks of known colour, fitted to an image."""

from examples.paper.table1.command import main

__all__ = ["main"]
