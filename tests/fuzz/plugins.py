"""Plugins as they are found in the wild: odd names and values, modules that raise anything, metadata in pieces."""

from __future__ import annotations

import importlib
import itertools
import random
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from loi_core.errors import LoiError
from loi_core.plugins import registry
from loi_core.scenes.experiment import Start
from loi_core.scenes.reading import load_scene
from tests.fuzz.claims import Call, fail
from tests.fuzz.damage import damaged
from tests.fuzz.scenes import SCENE, lay_out, spelled

__all__ = ["entry_points", "factories", "metadata"]

NAMES = (
    "good",
    "",
    " ",
    "a b",
    "disks",
    "\x1b[2J",
    "\n",
    "é" * 50,
    "x" * 3000,
    "\u202e",
    "[",
    "=",
    "🙂",
    "../x",
    "\ud800",
)
VALUES = (
    *("loi_core.renderers:Disks", "odd_plugin:make", "odd_plugin", "odd_plugin:", ":", "", "not a value!!", "a:b:c"),
    *("odd_plugin:make.deep", "odd_plugin:make [x]", "odd_plugin:make []", "odd_plugin:make [a,b]", "math:pi", "..:x"),
    *("no_such_module:x", "no_such_module:x [gpu]", "odd_plugin:nothing", "\x00:x", "é:é", "os:abort.__doc__"),
)
RAISED = (
    *("RuntimeError('no licence\\nsecond line')", "SystemExit(0)", "SystemExit('gone')", "MemoryError()", "Own()"),
    *(
        "KeyboardInterrupt()",
        "OwnInterrupt()",
        "GeneratorExit()",
        "StopIteration()",
        "Mute()",
        "UnicodeError('\\ud800')",
    ),
    *(
        "ImportError('libx.so')",
        "ModuleNotFoundError(name='x')",
        "RecursionError()",
        "OSError(28, 'full')",
        "BrokenPipeError()",
    ),
)
CLASSES = """
class Own(BaseException): pass
class OwnInterrupt(KeyboardInterrupt): pass
class Mute(Exception):
    def __str__(self): raise RuntimeError('mute')
    __repr__ = __str__
class Touchy:
    def __getattr__(self, name): raise RuntimeError(name)
    def __call__(self, **options): return None
class Signed:
    __signature__ = 3
    def __call__(self, **options): return None
class Worse:
    @property
    def __signature__(self): raise OSError('no')
    backend = Touchy()
    def __call__(self, **options): return None
"""
BODIES = (
    *(
        "import no_such_module",
        "def make(",
        "make = 3",
        "make = None",
        "make = Touchy()",
        "make = Signed()",
        "make = Worse()",
    ),
    *("make = print", "make = object", "make = type", "make = dict", "make = lambda *a, **k: None", "print('banner')"),
    *("def make(a, /): ...", "def make(*, height, width): ...", "def make(x: 1 / 2 = 0): ...", "make = make"),
    *(
        "import warnings\nmake = dict",
        "make = Own",
        "make = classmethod(1)",
        "import sys\nsys.modules.pop(__name__)\nmake = dict",
    ),
)
numbers = itertools.count()


def entry_points(rng: random.Random, folder: Path) -> Call:
    """A listing of announced renderers and the loading of each by name."""
    module = f"odd_plugin_{next(numbers)}"
    body = f"raise {rng.choice(RAISED)}" if rng.random() < 0.5 else rng.choice(BODIES)
    (folder / f"{module}.py").write_text(CLASSES + body + "\n", encoding="utf-8", errors="surrogatepass")
    points = [
        EntryPoint(rng.choice(NAMES), rng.choice(VALUES).replace("odd_plugin", module), registry.RENDERERS.name)
        for _ in range(rng.randint(1, 5))
    ]

    def look() -> str:
        with _Importing(folder), mock.patch.object(registry, "entry_points", return_value=points):
            try:
                listed = registry.available_renderers()
            except KeyboardInterrupt as stop:  # a plugin that raises it cannot be told from Ctrl-C
                return _stopped(stop, body)
            if len(listed) < len({point.name for point in points}):
                fail("a plugin is not listed")
            for point in points:
                try:
                    registry.load_renderer(point.name)
                except LoiError:
                    continue
                except KeyboardInterrupt as stop:
                    return _stopped(stop, body)
        return "a listing"

    return look


def _stopped(stop: KeyboardInterrupt, body: str) -> str:
    if type(stop) is not KeyboardInterrupt or "KeyboardInterrupt()" not in body:
        fail("a plugin passes for Ctrl-C")
    return "interrupted"


class _Importing:
    """Modules of a folder can be imported, and are forgotten afterwards."""

    def __init__(self, folder: Path) -> None:
        self.folder = str(folder)

    def __enter__(self) -> None:
        self.before = set(sys.modules)
        self.writes, sys.dont_write_bytecode = sys.dont_write_bytecode, True
        sys.path.insert(0, self.folder)
        importlib.invalidate_caches()

    def __exit__(self, *_: object) -> None:
        sys.path.remove(self.folder)
        sys.dont_write_bytecode = self.writes
        for name in set(sys.modules) - self.before:
            if name.startswith("odd_plugin"):
                del sys.modules[name]


class Foreign:
    """A renderer of which any part may be broken."""

    def __init__(self, rng: random.Random, folder: Path) -> None:
        self.answers: dict[str, Any] = {
            "parameters": {"positions": np.zeros((2, 2))},
            "render": np.zeros((10, 12, 3)),
            "render_vjp": (np.zeros((10, 12, 3)), lambda cotangent: {"positions": np.zeros((2, 2))}),
        }
        odd: tuple[Any, ...] = (
            *(None, 3, "text", [], {}, np.zeros(3), np.array(["a"]), np.full((10, 12, 3), np.nan), {"positions": None}),
            *({1: np.zeros(2)}, {"positions": np.zeros(3)}, {"positions": [1.0]}, (1, 2, 3), np.ma.zeros((10, 12, 3))),
            *(RuntimeError("no"), SystemExit(0), MemoryError(), _Own(), _OwnInterrupt(), object()),
        )
        for name in rng.sample(sorted(self.answers), rng.randint(0, 2)):
            self.answers[name] = rng.choice(odd)

    def _give(self, name: str) -> Any:
        if isinstance(self.answers[name], BaseException):
            raise self.answers[name]
        return self.answers[name]

    def parameters(self) -> Any:
        return self._give("parameters")

    def render(self, params: Any, *, seed: int = 0) -> Any:
        return self._give("render")

    def render_vjp(self, params: Any, *, seed: int = 0) -> Any:
        return self._give("render_vjp")


class _Own(BaseException):
    pass


class _OwnInterrupt(KeyboardInterrupt):
    pass


def factories(rng: random.Random, folder: Path) -> Call:
    """A scene with a renderer of somebody else."""
    lay_out(folder)
    document = {**SCENE, "renderer": {"name": "foreign", **({"spp": 3} if rng.random() < 0.3 else {})}}
    document["optimise"] = {rng.choice(("positions", "radii", "1")): {}}
    (folder / "scene.toml").write_text(spelled(document))
    made: Any = Foreign(rng, folder)
    if rng.random() < 0.2:
        made = rng.choice((None, 3, object(), Foreign, _Own(), SystemExit(0), _OwnInterrupt(), RuntimeError("no")))

    def factory(spp: "no such type" = 1, **options: Any) -> Any:  # type: ignore[valid-type]  # noqa: F722
        if isinstance(made, BaseException):
            raise made
        return made

    def load() -> str:
        with mock.patch("loi_core.scenes.making.load_renderer", return_value=factory):
            try:
                Start.of(load_scene(folder / "scene.toml"))
            except MemoryError:
                return "MemoryError"  # of which the command says what to do
        return "a scene"

    return load


ENTRY_POINTS = (
    b"[console_scripts]\na = b:c\n\n[loi.renderers]\ngood = loi_core.renderers:Disks\nbad = nowhere:x [gpu]\n"
)
METADATA = b"Metadata-Version: 2.1\nName: other\nVersion: 1.0\n"


def metadata(rng: random.Random, folder: Path) -> Call:
    """Distributions whose files of metadata are damaged."""
    for number in range(rng.randint(1, 3)):
        place = folder / rng.choice((f"other{number}-1.0.dist-info", f"other{number}.egg-info", "-.dist-info"))
        place.mkdir(exist_ok=True)
        for name, content in (("entry_points.txt", ENTRY_POINTS), ("METADATA", METADATA)):
            if (place / name).exists():
                continue
            if rng.random() < 0.8:
                (place / name).write_bytes(damaged(rng, content, 2))
            elif rng.random() < 0.3:
                (place / name).mkdir()

    def look() -> str:
        standard = [one for one in sys.path if "site-packages" not in one]
        with mock.patch.object(sys, "path", [str(folder), *standard]):
            importlib.invalidate_caches()
            registry.available_renderers()
            try:
                registry.load_renderer("good")
            except LoiError:
                return "a listing without it"
        return "a listing"

    return look
