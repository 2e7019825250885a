"""Scenes that are fitted in a tenth of a second."""

from __future__ import annotations

from pathlib import Path

from tests.one_disk import DISK, DISK_TO_FIND, lay_out_disk

__all__ = ["SCENES", "lay_out"]

ONE_VIEW = f"""\
target = "target.png"
output = "result"

{DISK_TO_FIND}
[objective]
compare = ["pixel_l2"]

[fit]
steps = 40
starts = 2
"""

VIEWS = f"""\
output = "result"

{DISK}
[views.front]
target = "target.png"

[views.dark]
target = "target.png"
renderer = {{ colours = [[0.8, 0.3, 0.1]] }}

[optimise.positions]
initial = [[8, 9]]
lower = 0
upper = 16

[fit]
steps = 40
views_per_step = 1
"""

SCENES = {
    "disks": ONE_VIEW,
    "views": VIEWS,
    "torch": ONE_VIEW.replace('"disks"', '"disks-torch"'),
    "JAX": ONE_VIEW.replace('"disks"', '"disks-jax"')
    .replace("starts = 2", "starts = 1")
    .replace("= 40", "= 60")
    .replace("confine = true", 'dtype = "float32"'),
}


def lay_out(folder: Path, scene: str) -> Path:
    """The scene file, beside its target."""
    return lay_out_disk(folder, SCENES[scene])
