"""``loi demo``: two scenes, made here and recovered from their image files."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.cli.fit import print_summary, run_and_write
from loi_core.io.files import check_writable, write_text
from loi_core.io.images import FloatImage, read_image, write_png
from loi_core.renderers import Disks, Warp
from loi_core.report import write_index, write_page
from loi_core.scenes.reading import load_scene

__all__ = ["make_disks", "make_photograph", "run_demo"]

NOISE: Final = 0.04
EXPOSURE: Final = -0.4  # stops; the target is darker than the picture it shows

DISKS_SCENE: Final = """\
title = "Three disks"
target = "target.png"
output = "result"

[renderer]
name = "disks"
dtype = "float32"
positions = [[20, 20], [76, 30], [40, 78]]
radii = [9, 12, 15]
colours = [[0.95, 0.05, 0.05], [0.05, 0.85, 0.05], [0.05, 0.05, 1.0]]
background = [0.05, 0.05, 0.05]
confine = true

[optimise.positions]      # in pixels, (x, y)
initial = [[70, 76], [18, 74], [72, 16]]
lower = 0
upper = 96
truth = [[20, 20], [76, 30], [40, 78]]

[objective]
name = "loi"
compare = ["pixel_l2", "gaussian_pyramid"]

[fit]
steps = 120
learning_rate = 2
"""

PHOTOGRAPH_SCENE: Final = """\
title = "A photograph, darker and noisy"
target = "target.png"
output = "result"

[renderer]
name = "warp"
dtype = "float32"

[renderer.images]
picture = "picture.png"
background = "background.png"

[optimise.translation]    # in pixels, from the centre
initial = [-34, 18]
lower = -60
upper = 60
learning_rate = 2
truth = [32, -14]

[optimise.rotation]       # in degrees, clockwise
initial = 0
lower = -180
upper = 180
learning_rate = 2
truth = -24

[optimise.scale]
initial = 1.2
lower = 0.5
upper = 2
learning_rate = 0.02
truth = 0.9

[optimise.exposure]       # in stops
initial = 0
lower = -2
upper = 2
learning_rate = 0.03
truth = -0.4

[objective]
name = "loi"
compare = ["pixel_l2", "gaussian_pyramid"]

[fit]
steps = 200
"""


def run_demo(output: Path, *, as_json: bool) -> bool:
    """Make both scenes in `output`, fit them, and write one page of pictures; False if a fit ended early."""
    check_writable("--output", output)
    folders = [output / "disks", output / "photograph"]
    make_disks(folders[0])
    make_photograph(folders[1])
    results: list[dict[str, Any]] = []
    for folder in folders:
        scene = load_scene(folder / "scene.toml")
        result = run_and_write(scene)
        write_page(scene.output)
        results.append(result)
        if not as_json:
            print_summary(result)
            print()
    page = write_index(output / "index.html", [folder / "result" for folder in folders], "loi demo")
    if as_json:
        print(json.dumps({"scenes": results, "report": str(page)}, indent=2))
    else:
        print(f"open {page} in a browser; change and rerun a scene with `loi fit {folders[0] / 'scene.toml'}`")
    return not any(trial["error"] for result in results for trial in result["trials"])


def make_disks(folder: Path) -> None:
    """Write the scene of disks and its target."""
    write_text(folder / "scene.toml", DISKS_SCENE)
    options = tomllib.loads(DISKS_SCENE)["renderer"]  # the scene itself is in the true state; a fit starts elsewhere
    del options["name"]
    disks = Disks(96, 96, **options)
    write_png(folder / "target.png", disks.render(disks.parameters()))


def make_photograph(folder: Path) -> None:
    """Write the scene of the photograph: its picture, background, and a darker, noisy target.

    The picture is the portrait of Grace Hopper (James S. Davis, U.S. Navy, public domain) that Matplotlib ships.
    """
    folder.mkdir(parents=True, exist_ok=True)
    picture = _portrait(folder / "picture.png")
    background = _background(96, 128)
    write_png(folder / "background.png", background)
    background = read_image(folder / "background.png")  # as the scene will see it, in 8 bits
    warp = Warp(picture, background, (32.0, -14.0), -24.0, 0.9, EXPOSURE)
    target = warp.render(warp.parameters())
    noise = np.random.default_rng(7).normal(0.0, NOISE, target.shape)
    write_png(folder / "target.png", target + noise)
    write_text(folder / "scene.toml", PHOTOGRAPH_SCENE)


def _portrait(path: Path) -> FloatImage:
    from matplotlib import get_data_path
    from PIL import Image

    source = Path(get_data_path()) / "sample_data" / "grace_hopper.jpg"
    with Image.open(source) as portrait:
        small = portrait.convert("RGB").resize((40, 48), Image.Resampling.LANCZOS)
    write_png(path, np.asarray(small, dtype=np.float64) / 255.0)
    return read_image(path)


def _background(height: int, width: int) -> FloatImage:
    rows, columns = np.mgrid[:height, :width]
    across, down = columns / width, rows / height
    return np.stack([0.33 + 0.15 * across, 0.36 - 0.12 * down, 0.27 + 0.06 * (across + down)], axis=-1)
