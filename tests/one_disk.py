"""A scene file with one disk on 16 x 16 pixels: its renderer, its start, and its target."""

from __future__ import annotations

from pathlib import Path

from loi_core.io.images import write_png
from loi_core.renderers import Disks

__all__ = ["DISK", "DISK_TO_FIND", "START", "lay_out_disk"]

DISK = """\
[renderer]
name = "disks"
positions = [[10, 6]]
radii = [3]
colours = [[0.9, 0.2, 0.1]]
"""
START = """\
[optimise.positions]
initial = [[4, 12]]
lower = 0
upper = 16
"""
DISK_TO_FIND = f"""\
{DISK}confine = true

{START}truth = [[10, 6]]

[scales]
sigma = 1
alpha = [2, 6]
beta = 0.125
"""


def lay_out_disk(folder: Path, scene: str) -> Path:
    """Write the target, ``target.png``, and a scene file beside it; return the path of the scene file."""
    disk = Disks(16, 16, [[10, 6]], 3.0, [[0.9, 0.2, 0.1]])
    write_png(folder / "target.png", disk.render(disk.parameters()))
    path = folder / "scene.toml"
    path.write_text(scene)
    return path
