"""Command lines of any words, in process; only what would run for long is replaced."""

from __future__ import annotations

import contextlib
import copy
import io
import os
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

from loi_core.cli import main
from loi_core.cli.doctor import Finding
from loi_core.tradeoff import Row, Tradeoff, settings_of
from tests.fuzz.claims import Call, fail
from tests.fuzz.scenes import SCENE, VALUES, lay_out, spelled

__all__ = ["command_lines", "places"]

COMMANDS = ("fit", "sweep", "demo", "tradeoff", "renderers", "doctor", "report")
OPTIONS = (
    *("--help", "--version", "--json", "--resume", "--output", "--image", "--reference", "--scene", "--backend"),
    *("--seconds", "-h", "--outp", "--", "-", "-x", "--json=1", "--output=", "--seconds=nan", "--x\x1b[2J"),
)
WORDS = (
    *(
        "scene.toml",
        "target.png",
        "out",
        "out/deep/er",
        "file",
        "file/below",
        "loop",
        "loop/x",
        "gone",
        "",
        " ",
        ".",
        "é",
    ),
    *("n" * 300, "a\0b", "\udcff", "\ud800.toml", "a\nb", "0", "1e-3", "nan", "inf", "-1", "1e999", "numpy", "disks"),
    *(
        "photograph",
        "pipe",
        "pipe.toml",
        "pipe.png",
        "scene\udcff.toml",
        "a/" * 3000,
        "/dev/null",
        "/dev/full",
        "target.npy",
    ),
)


def command_lines(rng: random.Random, folder: Path) -> Call:
    """Mostly a command with some of its words, now and then anything."""
    _lay_out_all(rng, folder)
    arguments = [rng.choice((*COMMANDS, *COMMANDS, *COMMANDS, *OPTIONS, *WORDS))]
    arguments += [
        rng.choice((*OPTIONS, *WORDS, "scene.toml", "out", "scene.toml"))
        for _ in range(rng.choice((0, 1, 1, 2, 2, 3, 5)))
    ]
    if arguments[0] == "fit" and rng.random() < 0.5:
        arguments[1:1] = ["scene.toml"]
    encoding = rng.choice(("utf-8", "ascii", "cp1252"))

    def call() -> str:
        return run(arguments, folder, encoding)

    return call


def places(rng: random.Random, folder: Path) -> Call:
    """What is neither a file nor missing, wherever a path can be given."""
    _lay_out_all(rng, folder)
    word = rng.choice(("loop", "loop.png", "pipe", "pipe.toml", "pipe.png", "folder.png", "gone.png", "gone", *WORDS))
    document = copy.deepcopy(SCENE)
    how = rng.randrange(6)
    if how == 0:
        document["target"] = word
    elif how == 1:
        document["output"] = word
    elif how == 2:
        document["renderer"] = {"name": "warp", "images": {"picture": word, "background": "background.png"}}
    (folder / "other.toml").write_bytes(spelled(document).encode("utf-8", "surrogatepass"))
    out = folder / "out"
    out.mkdir()
    for name in rng.sample(("checkpoint.npz", "history.csv", "result.json", "report.html", "frames"), 2):
        make = rng.choice(
            (lambda path: os.mkfifo(path), lambda path: path.mkdir(), lambda path: path.symlink_to(path.name))
        )
        make(out / name)
    calls = [
        *(
            ["fit", "other.toml"],
            ["fit", "other.toml", "--output", "out", "--resume"],
            ["report", "out"],
            ["report", word],
        ),
        *(["fit", word], ["tradeoff", "--image", word, "--reference", "target.png"], ["demo", "--output", word]),
        *(["tradeoff", "--scene", word], ["fit", "other.toml", "--output", word]),
    ]
    arguments = calls[how] if how < 2 else rng.choice(calls)

    def call() -> str:
        return run(arguments, folder, "utf-8")

    return call


def _lay_out_all(rng: random.Random, folder: Path) -> None:
    lay_out(folder)
    document = copy.deepcopy(SCENE)
    document["title"] = rng.choice(("plain", "é 🙂", "a\nb", "\x1b[2J"))
    if rng.random() < 0.3:
        document["fit"][rng.choice(("steps", "learning_rate", "seed"))] = rng.choice(VALUES)
        if isinstance(document["fit"].get("steps"), int):
            document["fit"]["steps"] = min(document["fit"]["steps"], 3)
    (folder / "scene.toml").write_bytes(spelled(document).encode("utf-8", "surrogatepass"))
    with contextlib.suppress(OSError):  # not every file system takes such a name
        os.link(folder / "scene.toml", os.fsencode(folder) + b"/scene\xff.toml")
    (folder / "file").write_text("a file")
    (folder / "gone").symlink_to("nowhere")
    (folder / "gone.png").symlink_to("nowhere.png")
    (folder / "loop.png").symlink_to("loop.png")
    (folder / "folder.png").mkdir()
    for name in ("pipe", "pipe.toml", "pipe.png"):
        os.mkfifo(folder / name)


class _Terminal(io.TextIOWrapper):
    """Standard output of some encoding."""

    def __init__(self, encoding: str, errors: str) -> None:
        super().__init__(io.BytesIO(), encoding=encoding, errors=errors)

    def said(self) -> str:
        self.flush()
        buffer: Any = self.buffer
        return str(buffer.getvalue().decode(self.encoding))


def run(arguments: list[str], folder: Path, encoding: str) -> str:
    """Run one command and see that it ends as every command ends."""
    out, err = _Terminal(encoding, "strict"), _Terminal(encoding, "backslashreplace")
    with _light(), contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(arguments)
        except BaseException as error:
            error.add_note(f"called with {arguments!r}")
            raise
    said = err.said().splitlines()
    if code not in (0, 1, 2, 3):
        fail(f"{arguments!r} exits with {code}")
    if any(not line.startswith("loi: ") for line in said) or (code == 2 and len(said) != 1) or (code == 1 and not said):
        fail(f"{arguments!r} exits with {code} and says {said}")
    if code == 2 and out.said():
        fail(f"{arguments!r} fails and answers all the same: {out.said()!r:.200}")
    if any(not one.isprintable() for line in said for one in line):
        fail(f"{arguments!r} says what cannot be printed: {said}")
    return f"exit {code}"


@contextlib.contextmanager
def _light() -> Iterator[None]:
    """Without what takes long: plots, measurements, the demo's fits, the frameworks that the doctor looks at."""

    def measured(problem: Any, backends: Any, *, seconds: float, progress: Callable[..., None]) -> Tradeoff:
        setting = settings_of("numpy", ("float32",), problem.scales)[0]
        return Tradeoff(problem, rows=(Row(setting, "cpu", 1e-3, 1, 0, 0.0),))

    def shown(page: Path, *_: object) -> Path:
        return page

    with contextlib.ExitStack() as stack:
        for name, value in {
            "loi_core.cli.tradeoff.measure": measured,
            "loi_core.cli.demo.REQUIREMENTS": {"disks": "NumPy", "photograph": "NumPy"},
            "loi_core.cli.demo.run_and_write": lambda scene, **_: {"title": scene.title, "trials": []},
            "loi_core.cli.demo.write_page": shown,
            "loi_core.cli.demo.write_index": shown,
            "loi_core.cli.doctor.findings": lambda: [Finding("a", "ok", "b"), Finding("c", "missing", "d", "e")],
        }.items():
            stack.enter_context(mock.patch(name, value))
        yield
