"""Checkpoints and result folders of earlier runs, damaged since."""

from __future__ import annotations

import functools
import io
import json
import pickle
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
from tests.fuzz.claims import Call, marked
from tests.fuzz.damage import damaged

__all__ = ["checkpoints", "reports"]

RENDERER = Disks(6, 6, [[2.0, 3.0]], [1.5], [[0.9, 0.2, 0.1]])
TARGET = np.full((6, 6, 3), 0.25)
STEPS = 3


def _whole() -> bytes:
    """The checkpoint of a fit that was stopped after its first step."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "state.npz"
        fit(RENDERER, PixelL2(TARGET), steps=STEPS, learning_rate=0.1, checkpoint=path, callback=lambda *_: True)
        return path.read_bytes()


WHOLE = _whole()

ARRAYS: tuple[Any, ...] = (
    *(np.zeros(()), np.zeros(0), np.full((1, 2), np.nan), np.full((1, 2), np.inf), np.full((1, 2), -1.0)),
    *(np.full((1, 2), 1e300), np.zeros((1, 2), dtype=">f8"), np.zeros((1, 2), dtype="f2"), np.zeros((1, 2), "c16")),
    *(np.zeros((1, 2), dtype="i8"), np.array("text"), np.array([["a", "b"]]), np.zeros((1, 2), dtype=[("a", "f8")])),
    *(
        np.array(-1),
        np.array(2**62),
        np.array(1.5),
        np.array(True),
        np.array(b"\xff"),
        np.zeros((4, 5)),
        np.ones((1, 6)),
    ),
    *(np.full((1, 6), np.nan), np.array("{}"), np.array("[1]"), np.array("[" * 5000), np.array('{"steps": [3]}')),
    *(np.array("NaT", dtype="M8[s]"), np.zeros((1, 2), dtype="f16")),
)


def checkpoints(rng: random.Random, folder: Path) -> Call:
    """A fit that is to go on from a checkpoint."""
    path = folder / "state.npz"
    path.write_bytes(_checkpoint(rng, folder))

    def resume() -> str:
        try:
            fit(RENDERER, PixelL2(TARGET), steps=STEPS, learning_rate=0.1, checkpoint=path, resume=True)
        except FitError:
            return "a failed fit"
        return "a fit"

    return resume


def _checkpoint(rng: random.Random, folder: Path) -> bytes:
    how = rng.random()
    if how < 0.35:
        return damaged(rng, WHOLE)
    stored = np.load(io.BytesIO(WHOLE), allow_pickle=False)
    arrays: dict[str, Any] = {name: stored[name] for name in stored.files}
    raw: dict[str, bytes] = {}
    for _ in range(rng.randint(1, 3)):
        name = rng.choice((*arrays, "params/other", "params/", "foreign", "first"))
        if rng.random() < 0.15:
            arrays.pop(name, None)
        elif rng.random() < 0.2:
            arrays.pop(name, None)
            raw[name] = rng.choice((b"", b"raw", rng.randbytes(99), b"\x93NUMPY\x01\x00", pickle.dumps(marked(folder))))
        elif rng.random() < 0.2:
            arrays[name] = np.array([marked(folder)], dtype=object)
        elif name in arrays and rng.random() < 0.5 and arrays[name].size and arrays[name].dtype.kind == "f":
            arrays[name] = arrays[name].copy()
            arrays[name].reshape(-1)[rng.randrange(arrays[name].size)] = rng.choice((np.nan, np.inf, -1.0, 1e308, 0.0))
        else:
            arrays[name] = rng.choice(ARRAYS)
    stream = io.BytesIO()
    with zipfile.ZipFile(
        stream, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    ) as file:
        for name, value in arrays.items():
            member = io.BytesIO()
            np.save(member, value, allow_pickle=True)
            file.writestr(f"{name}.npy", member.getvalue())
        for name, content in raw.items():
            file.writestr(name if rng.random() < 0.5 else f"{name}.npy", content)
        if rng.random() < 0.01:  # a bomb: megabytes of nothing
            file.writestr("bomb.npy", _zeros(2**28), zipfile.ZIP_DEFLATED)
    content = stream.getvalue()
    return damaged(rng, content, 1) if rng.random() < 0.2 else content


@functools.cache
def _zeros(size: int) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "|u1", "fortran_order": False, "shape": (size,)})
    return stream.getvalue() + bytes(size)


TEXTS = ("", "loi", "pixel_l2", "../x", "a\nb", "\ud800", "<b>", "é", "x" * 5000, "\x00")
PLAIN: tuple[Any, ...] = (None, True, 0, -1, 10**400, 1e308, float("nan"), float("inf"), [], {}, *TEXTS)


def reports(rng: random.Random, folder: Path) -> Call:
    """A page from a result folder."""
    errors: dict[str, Any] = {"a": 0.5}
    trial: dict[str, Any] = {"objective": "loi", "error": None, "psnr": 20.0, "best_step": 1}
    trial["parameter_errors"] = errors
    result: Any = {"title": "t", "scene": "s.toml", "steps": 3, "trials": [trial, dict(trial, objective="pixel_l2")]}
    for _ in range(rng.randint(0, 3)):
        where: Any = rng.choice((result, trial, errors))
        where[rng.choice((*where, "a"))] = rng.choice(PLAIN)
    text = json.dumps(result)
    content = damaged(rng, text.encode(), 2) if rng.random() < 0.4 else text.encode()
    if rng.random() < 0.05:
        content = rng.choice((b"[" * 10**5, b"{}", b"\xff\xfe", b"1" * 5000, b'{"a":' * 2000))
    (folder / "result.json").write_bytes(content)
    for name in rng.sample(("final.png", "initial.png", "frames", "target.png"), 2):
        if rng.random() < 0.5:
            (folder / name).mkdir()
        else:
            (folder / name).write_bytes(rng.randbytes(20))

    def write() -> str:
        write_page(folder)
        return "a page"

    return write
