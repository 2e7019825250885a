"""The scenes that come with loi: made here, each in a folder of its own, with the image file it is recovered from."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.io.files import write_text
from loi_core.io.images import FloatImage, read_image, write_png
from loi_core.pixels.encoding import encode_srgb
from loi_core.plugins.registry import load_renderer
from loi_core.renderers import Disks, Warp
from loi_core.support.arrays import from_numpy, to_numpy

__all__ = ["DISKS_SCENE", "PHOTOGRAPH_SCENE", "make_ball", "make_crate", "make_disks", "make_photograph"]

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

CRATE_SCENE: Final = """\
title = "A crate, on torch"
target = "target.png"
output = "result"

[renderer]
name = "mesh-torch"
dtype = "float32"
meshes = { crate = "crate.ply" }
camera = { position = [0, 2, 8], fov = 40 }
lights = { sun = { direction = [-1, -2, -3] } }
background = [0.08, 0.1, 0.12]

[renderer.parameters]
place = { Translate = "crate" }
turn = { Rotate = "crate", axis = [0, 1, 0] }

[optimise.place]          # in units of the scene; a pixel is about 0.09
initial = [-2.4, 0.9, 0]
lower = [-3, -2, -3]
upper = [3, 2, 2]
truth = [2, -0.8, -1]

[optimise.turn]           # in degrees
initial = 40
lower = 0
upper = 60
truth = 20

[objective]
name = "loi"
compare = ["pixel_l2", "gaussian_pyramid"]

[fit]
steps = 200
learning_rate = "1.5 px"
"""

# A cube of six colours as a PLY file has it: the corners of each side, seen from outside, then its colour, 0 to 255.
SIDES: Final = (
    ((0, 1, 3, 2), (214, 96, 44)),
    ((4, 6, 7, 5), (236, 178, 60)),
    ((0, 4, 5, 1), (88, 140, 92)),
    ((2, 3, 7, 6), (196, 60, 66)),
    ((0, 2, 6, 4), (120, 84, 150)),
    ((1, 5, 7, 3), (58, 128, 178)),
)


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
    write_png(folder / "target.png", encode_srgb(np.asarray(renderer.render(_truth(options), seed=TARGET_SEED))))


def make_crate(folder: Path) -> None:
    """Write the mesh on torch, its scene, and its target.

    Raises
    ------
    RendererNotFoundError
        If torch is not installed; nothing is written then.
    """
    mesh_renderer = load_renderer("mesh-torch")
    options = tomllib.loads(CRATE_SCENE)
    write_text(folder / "crate.ply", _cube())
    write_text(folder / "scene.toml", CRATE_SCENE)
    given = {name: value for name, value in options["renderer"].items() if name not in ("name", "meshes")}
    renderer = mesh_renderer(height=64, width=96, meshes={"crate": folder / "crate.ply"}, **given)
    like = renderer.parameters()
    image = renderer.render({name: from_numpy(value, like[name]) for name, value in _truth(options).items()})
    write_png(folder / "target.png", encode_srgb(to_numpy(image)))


def _truth(options: Mapping[str, Any]) -> dict[str, Any]:
    """What a scene file says its parameters are."""
    return {name: np.asarray(free["truth"], np.float32) for name, free in options["optimise"].items()}


def _cube() -> str:
    """A PLY file, with the vertices of each side for itself, so that sides keep their colours."""
    head = "ply\nformat ascii 1.0\nelement vertex 24\n"
    head += "".join(f"property float {letter}\n" for letter in "xyz")
    head += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    head += "element face 6\nproperty list uchar int vertex_indices\nend_header\n"
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    vertices = [(*corners[corner], *colour) for side, colour in SIDES for corner in side]
    faces = [(4, *range(4 * side, 4 * side + 4)) for side in range(len(SIDES))]
    return head + "".join(" ".join(map(str, row)) + "\n" for row in (*vertices, *faces))


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
