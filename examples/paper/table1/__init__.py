"""Table 1 of the paper: the places of disks of known colour, found from an image."""

from examples.paper.table1.command import main

__all__ = ["main"]
