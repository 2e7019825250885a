"""Damaged scene files, and scene files with any value for any key."""

from __future__ import annotations

import copy
import json
import math
import random
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from loi_core.io.images import write_png
from loi_core.renderers import Disks
from loi_core.scenes.experiment import Start
from loi_core.scenes.reading import FIT_KEYS, FREE_KEYS, OBJECTIVE_KEYS, SCALE_KEYS, SCENE_KEYS, VIEW_KEYS, load_scene
from tests.fuzz.claims import Call
from tests.fuzz.damage import damaged

__all__ = ["SCENE", "damaged_scenes", "lay_out", "to_toml", "values"]

BUNDLED = [
    files("loi_core.cli").joinpath("demo_scenes", name, "scene.toml").read_text(encoding="utf-8")
    for name in ("disks", "photograph")
]
SCENE: dict[str, Any] = {
    "target": "target.png",
    "renderer": {
        "name": "disks",
        "positions": [[6, 3], [2, 7]],
        "radii": [3, 1.5],
        "colours": [[0.9, 0.2, 0.1], [0.1, 0.2, 0.9]],
        "background": [0.1, 0.1, 0.1],
        "confine": True,
        "dtype": "float32",
    },
    "optimise": {"positions": {"initial": [[2, 3], [4, 4]], "lower": 0, "upper": 10, "truth": [[6, 3], [2, 7]]}},
    "scales": {"sigma": 1, "alpha": [2, 6], "beta": 0.25},
    "objective": {"compare": ["pixel_l2"]},
    "fit": {"steps": 2, "learning_rate": 1},
}


class Raw(str):
    """TOML text that is written as it is."""

    __slots__ = ()


VALUES: tuple[Any, ...] = (
    *(0, 1, -1, 2, 3, 255, 2**31, 2**63 - 1, 2**63, 2**70, -(2**70), 10**400, Raw("0x" + "f" * 9000), Raw("0b1")),
    *(0.0, -0.0, 0.5, 1e-320, 1e-9, 1e300, -1e308, math.inf, -math.inf, math.nan, Raw("1e99999"), Raw("1" * 5000)),
    *(True, False, "", " ", "a", "true", "nan", "1", "x" * 10000, "a\nb", "\x1b[2J", "\u202e", "\u0000", "é" * 90),
    *("\U0001f600", "..", ".", "/", "/dev/null", "/dev/zero", "../../etc/passwd", "a/" * 3000, "n" * 300, "loop"),
    *("target.png", "pixel_l2", "loi", "float64", "reflect", "path", "mask", "fast", "cosine", "sRGB", "linear"),
    *([], [[]], [1], [0, 1], [1, 0], [[1, 2]], [[1, 2], [3]], [1, "a"], [True], [math.nan], [2**70], [[[[1]]]]),
    *([1] * 1000, [{}], {}, {"a": 1}, {"a": {"b": [1]}}, {"name": "disks"}, [1e-300, 1e300], [-1e308, 1e308]),
    *(Raw("1979-05-27"), Raw("'''\na\n'''"), Raw("99999-99-99"), Raw("[" * 5000), Raw("{a=" * 300)),
)


def to_toml(document: dict[str, Any]) -> str:
    """Return a document as TOML: plain values first, then tables."""
    lines = [f"{_text(key)} = {_value(value)}" for key, value in document.items() if not isinstance(value, dict)]
    for key, table in document.items():
        if isinstance(table, dict):
            lines += [f"[{_text(key)}]", *(f"{_text(name)} = {_value(value)}" for name, value in table.items())]
    return "\n".join(lines) + "\n"


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, Raw):
        return str(value)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_text(name)} = {_value(entry)}" for name, entry in value.items()) + "}"
    return repr(value)


def lay_out(folder: Path) -> None:
    """Write the images that scenes name, and a link to itself."""
    scene = Disks(10, 12, [[6, 3], [2, 7]], [3.0, 1.5], [[0.9, 0.2, 0.1], [0.1, 0.2, 0.9]])
    write_png(folder / "target.png", scene.render(scene.parameters()))
    write_png(folder / "picture.png", np.full((3, 4, 3), 0.5))
    write_png(folder / "background.png", np.full((10, 12, 3), 0.2))
    (folder / "loop").symlink_to("loop")


def _loading(path: Path, content: bytes) -> Call:
    path.write_bytes(content)

    def load() -> str:
        Start.of(load_scene(path))
        return "a scene"

    return load


def damaged_scenes(rng: random.Random, folder: Path) -> Call:
    """Scene files with faults in their bytes."""
    lay_out(folder)
    text = rng.choice((*BUNDLED, to_toml(SCENE)))
    return _loading(folder / "scene.toml", damaged(rng, text.encode(), 3))


def values(rng: random.Random, folder: Path) -> Call:
    """Scenes with other values for some keys, or other keys in some tables."""
    lay_out(folder)
    document = copy.deepcopy(SCENE)
    if rng.random() < 0.3:
        document["renderer"] = {"name": "warp", "images": {"picture": "picture.png", "background": "background.png"}}
        document["optimise"] = {"translation": {"initial": [1, 2]}}
    if rng.random() < 0.3:
        view = {"target": document.pop("target")}
        document["views"] = {"first": view, "second": {**view, "renderer": {"dtype": "float64"}}}
    free, view_tables = document["optimise"], document.get("views", {})
    tables: tuple[tuple[dict[str, Any], tuple[str, ...]], ...] = (
        (document, (*SCENE_KEYS, "a b", "\x1b", "x" * 5000)),
        (document["renderer"], (*document["renderer"], "height", "width", "images", "rotation", "scale")),
        (free, ("positions", "radii", "translation", "exposure")),
        *((entry, FREE_KEYS) for entry in free.values()),
        *((entry, VIEW_KEYS) for entry in view_tables.values()),
        (document["scales"], SCALE_KEYS),
        (document["objective"], OBJECTIVE_KEYS),
        (document["fit"], FIT_KEYS),
    )
    for _ in range(rng.randint(1, 3)):
        table, keys = rng.choice(tables)
        key = rng.choice(keys)
        if rng.random() < 0.1:
            table.pop(key, None)
        else:
            table[key] = copy.deepcopy(rng.choice(VALUES))
    return _loading(folder / "scene.toml", to_toml(document).encode("utf-8", "surrogatepass"))
