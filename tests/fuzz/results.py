"""Checkpoints and result folders of earlier runs, damaged or with other content."""

from __future__ import annotations

import io
import json
import random
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from loi_core import PixelL2, fit
from loi_core.errors import FitError
from loi_core.renderers import Disks
from loi_core.report import write_page
from tests.fuzz.claims import Call, Marked
from tests.fuzz.damage import damaged

__all__ = ["RENDERER", "STEPS", "TARGET", "checkpoints", "reports", "resume_from", "rewritten", "whole_checkpoint"]

RENDERER = Disks(6, 6, [[2.0, 3.0]], [1.5], [[0.9, 0.2, 0.1]])
TARGET = np.full((6, 6, 3), 0.25)
STEPS = 3
ARRAYS: tuple[Any, ...] = (
    *(np.zeros(()), np.zeros(0), np.full((1, 2), np.nan), np.full((1, 2), np.inf), np.full((1, 2), -1.0)),
    *(np.full((1, 2), 1e300), np.zeros((1, 2), "f2"), np.zeros((1, 2), "c16"), np.zeros((1, 2), "i8")),
    *(
        np.array("text"),
        np.array([["a", "b"]]),
        np.zeros((1, 2), dtype=[("a", "f8")]),
        np.array(2**62),
        np.zeros((4, 5)),
    ),
    *(np.array("{}"), np.array("[1]"), np.array("[" * 5000), np.array('{"steps": [3]}')),
)
TEXTS = ("", "loi", "pixel_l2", "../x", "a\nb", "\ud800", "<b>", "é", "x" * 5000, "\x00")
PLAIN: tuple[Any, ...] = (None, True, 0, -1, 10**400, 1e308, float("nan"), float("inf"), [], {}, *TEXTS)


def whole_checkpoint() -> bytes:
    """Return the checkpoint of a fit that was stopped after its first step."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "state.npz"
        fit(RENDERER, PixelL2(TARGET), steps=STEPS, learning_rate=0.1, checkpoint=path, callback=lambda *_: True)
        return path.read_bytes()


WHOLE = whole_checkpoint()


def rewritten(**members: Any) -> bytes:
    """Return that checkpoint with other members: arrays, bytes as they are, or None for no such member."""
    with np.load(io.BytesIO(WHOLE)) as stored:
        arrays = {name.replace("/", "__"): stored[name] for name in stored.files} | members
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        for name, value in arrays.items():
            member = io.BytesIO()
            np.save(member, value, allow_pickle=True)
            if value is not None:
                content = value if isinstance(value, bytes) else member.getvalue()
                file.writestr(f"{name.replace('__', '/')}.npy", content)
    return stream.getvalue()


def resume_from(path: Path) -> Any:
    """Resume the fit from a checkpoint."""
    return fit(RENDERER, PixelL2(TARGET), steps=STEPS, learning_rate=0.1, checkpoint=path, resume=True)


def checkpoints(rng: random.Random, folder: Path) -> Call:
    """Fits that resume from a damaged checkpoint."""
    path = folder / "state.npz"
    names = ("state", "history", "params__positions", "memory__count", "best_params__radii", "params__other", "foreign")
    members = {rng.choice(names): rng.choice((*ARRAYS, None, b"raw", np.array([Marked(folder)]))) for _ in range(2)}
    path.write_bytes(damaged(rng, WHOLE) if rng.random() < 0.4 else rewritten(**members))

    def resume() -> str:
        try:
            resume_from(path)
        except FitError:
            return "a failed fit"
        return "a fit"

    return resume


def reports(rng: random.Random, folder: Path) -> Call:
    """Pages made from damaged result folders."""
    errors: dict[str, Any] = {"a": 0.5}
    trial: dict[str, Any] = {
        "objective": "loi",
        "error": None,
        "psnr": 20.0,
        "best_step": 1,
        "parameter_errors": errors,
    }
    result: Any = {"title": "t", "scene": "s.toml", "steps": 3, "trials": [trial, dict(trial, objective="pixel_l2")]}
    for _ in range(rng.randint(0, 3)):
        table: Any = rng.choice((result, trial, errors))
        table[rng.choice((*table, "a"))] = rng.choice(PLAIN)
    content = json.dumps(result).encode()
    (folder / "result.json").write_bytes(damaged(rng, content, 2) if rng.random() < 0.4 else content)
    for name in rng.sample(("final.png", "initial.png", "frames"), 2):
        if rng.random() < 0.5:
            (folder / name).mkdir()
        else:
            (folder / name).write_bytes(rng.randbytes(20))

    def write() -> str:
        write_page(folder)
        return "a page"

    return write
