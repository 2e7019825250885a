"""Scene files of any content: real ones that were damaged, and such where any key has any value."""

from __future__ import annotations

import copy
import json
import math
import random
from pathlib import Path
from typing import Any

import numpy as np

from loi_core.cli.bundled import bundled_scene
from loi_core.io.images import write_png
from loi_core.renderers import Disks
from loi_core.scenes.experiment import Start
from loi_core.scenes.reading import FIT_KEYS, FREE_KEYS, OBJECTIVE_KEYS, SCALE_KEYS, SCENE_KEYS, VIEW_KEYS, load_scene
from tests.fuzz.claims import Call
from tests.fuzz.damage import damaged

__all__ = ["SCENE", "VALUES", "damaged_scenes", "lay_out", "nests", "spelled", "values"]

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
    """TOML as it stands."""

    __slots__ = ()


VALUES: tuple[Any, ...] = (
    *(0, 1, -1, 2, 3, 255, 2**31, 2**63 - 1, 2**63, 2**70, -(2**70), 10**400, Raw("0x" + "f" * 9000), Raw("0b1")),
    *(0.0, -0.0, 0.5, 1e-320, 1e-9, 1e300, -1e308, math.inf, -math.inf, math.nan, Raw("1e99999"), Raw("1" * 5000)),
    *(True, False, "", " ", "a", "true", "nan", "1", "x" * 10000, "a\nb", "\x1b[2J", "\u202e", "\u0000", "é" * 90),
    *("\U0001f600", "..", ".", "/", "/dev/null", "/dev/zero", "../../etc/passwd", "a/" * 3000, "n" * 300, "loop"),
    *("target.png", "pixel_l2", "loi", "float64", "reflect", "path", "mask", "fast", "cosine", "sRGB", "linear"),
    *([], [[]], [1], [0, 1], [1, 0], [[1, 2]], [[1, 2], [3]], [1, "a"], [True], [math.nan], [2**70], [[[[1]]]]),
    *([1] * 1000, [{}], {}, {"a": 1}, {"a": {"b": [1]}}, {"name": "disks"}, [1e-300, 1e300], [-1e308, 1e308]),
    *(Raw("1979-05-27"), Raw("07:32:00"), Raw("1979-05-27T07:32:00Z"), Raw("'''\na\n'''"), Raw("99999-99-99")),
)


def spelled(document: dict[str, Any]) -> str:
    """A document as TOML: plain values first, then tables."""
    lines = [f"{_text(key)} = {_value(value)}" for key, value in document.items() if not isinstance(value, dict)]
    for key, value in document.items():
        if isinstance(value, dict):
            lines += [f"[{_text(key)}]", *(f"{_text(name)} = {_value(one)}" for name, one in value.items())]
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
        return "{" + ", ".join(f"{_text(key)} = {_value(one)}" for key, one in value.items()) + "}"
    return repr(value)


def lay_out(folder: Path) -> None:
    """What scenes name: images, a link to itself, and other things that are not files."""
    scene = Disks(10, 12, [[6, 3], [2, 7]], [3.0, 1.5], [[0.9, 0.2, 0.1], [0.1, 0.2, 0.9]])
    write_png(folder / "target.png", scene.render(scene.parameters()))
    write_png(folder / "picture.png", np.full((3, 4, 3), 0.5))
    write_png(folder / "mask.png", np.ones((10, 12, 3)))
    write_png(folder / "background.png", np.full((10, 12, 3), 0.2))
    (folder / "loop").symlink_to("loop")


def loading(path: Path) -> Call:
    def load() -> str:
        Start.of(load_scene(path))
        return "a scene"

    return load


def damaged_scenes(rng: random.Random, folder: Path) -> Call:
    """A real scene file with faults in its bytes."""
    lay_out(folder)
    text = rng.choice((bundled_scene("disks"), bundled_scene("photograph"), spelled(SCENE)))
    (folder / "scene.toml").write_bytes(damaged(rng, text.encode(), 3))
    return loading(folder / "scene.toml")


def values(rng: random.Random, folder: Path) -> Call:
    """A scene in which some keys have other values, or tables other keys."""
    lay_out(folder)
    document = copy.deepcopy(SCENE)
    if rng.random() < 0.3:
        document["renderer"] = {"name": "warp", "images": {"picture": "picture.png", "background": "background.png"}}
        document["optimise"] = {"translation": {"initial": [1, 2]}}
    if rng.random() < 0.3:
        own = {"target": document.pop("target")}
        document["views"] = {"one": own, "two": {**own, "weights": "mask.png", "renderer": {"dtype": "float64"}}}
    for _ in range(rng.randint(1, 3)):
        where, key = _some_key(rng, document)
        value = copy.deepcopy(rng.choice(VALUES))
        if rng.random() < 0.1:
            where.pop(key, None)
        else:
            where[key] = value
    (folder / "scene.toml").write_bytes(spelled(document).encode("utf-8", "surrogatepass"))
    return loading(folder / "scene.toml")


def _some_key(rng: random.Random, document: dict[str, Any]) -> tuple[dict[str, Any], str]:
    """A table, and a key that it has, or could have, or should not have."""
    name = rng.choice(("", "renderer", "images", "optimise", "free", "scales", "objective", "fit", "views", "view"))
    tables: dict[str, tuple[str, ...]] = {
        "": SCENE_KEYS,
        "views": ("one", "two", "three"),
        "view": VIEW_KEYS,
        "scales": SCALE_KEYS,
        "objective": OBJECTIVE_KEYS,
        "fit": FIT_KEYS,
        "free": FREE_KEYS,
        "renderer": (*SCENE["renderer"], "height", "width", "images", "rotation", "scale", "exposure", "translation"),
        "images": ("picture", "background", "positions"),
        "optimise": ("positions", "radii", "colours", "translation", "scale", "exposure"),
    }
    key = rng.choice(tables[name]) if rng.random() < 0.95 else rng.choice(("", "a b", "é", "\x1b", "x" * 5000))
    where: Any = document
    outers = {"images": "renderer", "free": "optimise", "view": "views"}
    if name in outers:
        outer = document.get(outers[name])
        inner = "images" if name == "images" else next(iter(outer), "positions") if isinstance(outer, dict) else ""
        where = outer.setdefault(inner, {}) if isinstance(outer, dict) else None
    elif name:
        where = document.setdefault(name, {})
    return (where, key) if isinstance(where, dict) else (document, key)


def nests(rng: random.Random, folder: Path) -> Call:
    """Nests, keys and files of great size, in every place that a scene has."""
    lay_out(folder)
    depth = rng.choice((5, 31, 40, 100, 300, 1000, 5000, 100_000))
    key = rng.choice(("target", "output", "title", "renderer", "optimise", "scales", "fit", "objective", "x"))
    inner = rng.choice(("", "name", "positions", "compare", "sigma", "initial", "steps"))
    how = rng.randrange(9)
    text, strange = spelled(SCENE), '"=".'
    if how == 0:
        text = f"{key} = " + "[" * depth + "]" * rng.choice((depth, 0)) + "\n" + text
    elif how == 1:
        text = f"{key} = " + "{a=" * depth + "1" + "}" * depth + "\n" + text
    elif how == 2:
        text = f"{key}{'.a' * depth} = 1\n{text}"
    elif how == 3:
        text += f"[{key}{'.a' * depth}]\nb = 1\n"
    elif how == 4:
        text += f"[{key}]\n{inner or 'y'}{'. a' * depth} = 1\n"
    elif how == 5:
        text += f"[{key}]\n{inner or 'y'} = {{ {strange * depth}a = 1 }}\n"
    elif how == 6:
        text += "".join(f"[[{key}.many]]\n" for _ in range(min(depth, 3000)))
    elif how == 7:
        text = "".join(f'"k{number}" = {number}\n' for number in range(depth)) + text
    else:
        text = f'title = "{"." * depth}" # {"a." * depth}=]\n' + text
    (folder / "scene.toml").write_text(text)
    return loading(folder / "scene.toml")
