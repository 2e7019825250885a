"""``loi demo``: scenes that are made here and recovered from their image files; one of them needs Mitsuba."""

from __future__ import annotations

import json
import sys
import tomllib
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.cli.fit import print_summary, run_and_write
from loi_core.errors import RendererNotFoundError
from loi_core.io.files import check_writable, write_text
from loi_core.io.images import FloatImage, read_image, write_png
from loi_core.pixels.encoding import encode_srgb
from loi_core.plugins.registry import load_renderer
from loi_core.renderers import Disks, Warp
from loi_core.report import write_index, write_page
from loi_core.scenes.reading import load_scene
from loi_core.support.wording import printable

__all__ = ["make_ball", "make_disks", "make_photograph", "run_demo"]

NOISE: Final = 0.04
TARGET_SAMPLES: Final = 256  # per pixel, of the scene in Mitsuba; a fit has 8
TARGET_SEED: Final = 1000  # which no step has
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

BALL_SCENE: Final = """\
title = "A ball and its shadow, in Mitsuba"
target = "target.png"
output = "result"

[renderer]
name = "mitsuba"
scene = "scene.xml"
spp = 8

[renderer.parameters]
x = { Translate = "ball", axis = [1, 0, 0] }
z = { Translate = "ball", axis = [0, 0, 1] }

[optimise.x]              # in units of the scene; a pixel is about 0.15
initial = -2
lower = -3
upper = 3
truth = 2

[optimise.z]
initial = 0.9
lower = -3
upper = 2
truth = -1.2

[objective]
name = "loi"
compare = ["pixel_l2", "gaussian_pyramid"]

[fit]
steps = 40
learning_rate = "1.5 px"
"""

BALL_XML: Final = """\
<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0, 5, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="48"/>
        <boolean name="sample_border" value="true"/></film></sensor>
<shape type="sphere" id="ball">
    <transform name="to_world"><scale value="0.6"/><translate x="0" y="0.6" z="0"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.85, 0.25, 0.1"/></bsdf></shape>
<shape type="rectangle" id="floor">
    <transform name="to_world"><rotate x="1" angle="-90"/><scale value="12"/></transform>
    <bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
        <rgb name="color0" value="0.3, 0.34, 0.3"/><rgb name="color1" value="0.5, 0.52, 0.45"/>
        <transform name="to_uv"><scale value="12"/></transform></texture></bsdf></shape>
<shape type="sphere" id="lamp">
    <transform name="to_world"><scale value="0.8"/><translate x="2" y="7" z="1"/></transform>
    <emitter type="area"><rgb name="radiance" value="26, 25, 23"/></emitter></shape>
<emitter type="constant"><rgb name="radiance" value="0.15, 0.16, 0.2"/></emitter>
</scene>
"""


def run_demo(output: Path, *, as_json: bool) -> bool:
    """Make the scenes in `output`, fit them, and write one page of pictures; False if a fit ended early.

    Where Mitsuba is not installed, its scene is left out, and a line says so.
    """
    check_writable("--output", output)
    folders = [output / "disks", output / "photograph"]
    make_disks(folders[0])
    make_photograph(folders[1])
    try:
        make_ball(output / "ball")
    except RendererNotFoundError as error:
        print(f"loi: the scene in Mitsuba is left out; {printable(str(error))}", file=sys.stderr)
    else:
        folders.append(output / "ball")
    results: list[dict[str, Any]] = []
    for folder in folders:
        scene = load_scene(folder / "scene.toml")
        result = run_and_write(scene, command="loi demo")
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


def make_ball(folder: Path) -> None:
    """Write the scene in Mitsuba, and its target with many samples.

    Raises
    ------
    RendererNotFoundError
        If Mitsuba is not installed, or does not work; nothing is written then.
    """
    mitsuba = load_renderer("mitsuba")
    options = tomllib.loads(BALL_SCENE)
    write_text(folder / "scene.xml", BALL_XML)
    write_text(folder / "scene.toml", BALL_SCENE)
    renderer = mitsuba(scene=folder / "scene.xml", parameters=options["renderer"]["parameters"], spp=TARGET_SAMPLES)
    truth = {name: np.asarray(free["truth"], np.float32) for name, free in options["optimise"].items()}
    write_png(folder / "target.png", encode_srgb(np.asarray(renderer.render(truth, seed=TARGET_SEED))))


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
