"""The scenes that come with loi: files of this package, which commands copy to a folder of the user's."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Final

from loi_core.io.files import write_bytes
from loi_core.plugins.registry import load_renderer

__all__ = ["BUNDLED_SCENES", "copy_scene"]

BUNDLED_SCENES: Final = {
    "disks": "disks",
    "photograph": "warp",
    "ball": "mitsuba",
    "crate": "mesh-torch",
}
"""Each scene's renderer, by the name of the scene.

The targets are stored and not rendered anew. The photograph is the portrait of Grace Hopper (James S. Davis, U.S. Navy,
public domain), moved, turned, darker and with noise. The ball is rendered with 256 samples per pixel; its fit has 8.
"""


def copy_scene(name: str, folder: Path) -> Path:
    """Copy a scene of :data:`BUNDLED_SCENES` and the files it needs to `folder`; return the path of its scene file.

    Raises
    ------
    RendererNotFoundError
        If the scene's renderer is not installed, or does not work; nothing is written then.
    """
    load_renderer(BUNDLED_SCENES[name])
    for source in files("loi_core.cli").joinpath("demo_scenes", name).iterdir():
        write_bytes(folder / source.name, source.read_bytes())
    return folder / "scene.toml"
