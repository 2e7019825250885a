"""The plan of a sweep: its scenes, its varied keys, and its runs with everything that they depend on."""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from loi_core.errors import OptionError
from loi_core.support.wording import listed

__all__ = ["MAX_RUNS", "REPEATS", "START", "Axis", "Sweep", "SweepRun", "dotted", "format_value"]

MAX_RUNS: Final = 100_000
MAX_NAME_LENGTH: Final = 48  # characters of a run's name before its digest
MAX_PATH_LENGTH: Final = 4096
START: Final = "start"
REPEATS: Final = ("fit.seed", START)
"""Keys that repeat a setting; they do not distinguish settings."""


@dataclass(frozen=True)
class Axis:
    """A varied key of scene files and its values.

    Attributes
    ----------
    key : tuple of str
        The tables that contain the key, then the key.
    values : tuple
        Values of any type that the key allows.
    """

    key: tuple[str, ...]
    values: tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class SweepRun:
    """One fit of a sweep.

    Attributes
    ----------
    name : str
        Name of its folder and its record.
    identity : str
        Digest of everything that it depends on.
    label : str
        Its scene file, as written in the sweep file.
    scene : Path
        The scene file.
    document : dict
        Content of the scene file, with the varied values in place.
    varied : dict
        Varied values by dotted key.
    start : int
        Index of the starting point within the bounds; 0 is the scene's own.
    """

    name: str
    identity: str
    label: str
    scene: Path
    document: Mapping[str, Any]
    varied: Mapping[str, Any]
    start: int


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep file, read and checked.

    Attributes
    ----------
    path : Path
        The file.
    title : str
        Heading of the page.
    output : Path
        Folder of the results.
    scenes : dict of dict
        Contents of the scene files by their paths, relative to the folder of the sweep file.
    axes : tuple of Axis
        Varied keys.
    starts : int
        Number of starting points of each setting.
    timeout : float, optional
        Time limit of a run in seconds.
    rank : str
        Column for the ranking of settings.
    """

    path: Path
    title: str
    output: Path
    scenes: Mapping[str, Mapping[str, Any]]
    axes: tuple[Axis, ...] = ()
    starts: int = 1
    timeout: float | None = None
    rank: str = "psnr"
    _digests: dict[Path, str] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        count = len(self.scenes) * self.starts * math.prod(len(axis.values) for axis in self.axes)
        if count > MAX_RUNS:
            msg = f"{self.path}: a sweep may have {MAX_RUNS} runs, got {count}"
            raise OptionError(msg)
        ranked = self.rank.removeprefix("error.")
        if ranked != self.rank and ranked not in self._with_truth:
            names = listed(sorted(self._with_truth)) or "none"
            msg = f"{self.path}: `rank` is by the error of {ranked!r}; the scenes have a `truth` of {names}"
            raise OptionError(msg)

    @property
    def _with_truth(self) -> set[str]:
        """Parameters whose true value is in a scene, or varies."""
        names = {axis.key[1] for axis in self.axes if len(axis.key) > 2 and axis.key[::2] == ("optimise", "truth")}
        for document in self.scenes.values():
            table = document.get("optimise")
            for name, entry in table.items() if isinstance(table, Mapping) else ():
                if isinstance(entry, Mapping) and "truth" in entry:
                    names.add(str(name))
        return names

    @cached_property
    def runs(self) -> tuple[SweepRun, ...]:
        """All distinct runs, one repetition of all settings after another, so that early results compare settings."""
        runs: dict[str, SweepRun] = {}
        repeats = [axis for axis in self.axes if dotted(axis.key) in REPEATS]
        settings = [axis for axis in self.axes if dotted(axis.key) not in REPEATS]
        for start, repeat in itertools.product(range(self.starts), _combinations(repeats)):
            for label, document in self.scenes.items():
                for setting in _combinations(settings):
                    values = {**repeat, **setting}
                    run = self._run(label, document, {axis.key: values[axis.key] for axis in self.axes}, start)
                    runs.setdefault(run.identity, run)
        return tuple(runs.values())

    def _run(
        self, label: str, document: Mapping[str, Any], values: Mapping[tuple[str, ...], Any], start: int
    ) -> SweepRun:
        scene = self.path.parent / label
        varied = {dotted(key): value for key, value in values.items()}
        if self.starts > 1:
            varied[START] = start
        varied_document = copy.deepcopy(dict(document))
        for key, value in values.items():
            try:
                _put(varied_document, key, value)
            except TypeError:
                msg = f"{self.path}: [vary] `{dotted(key)}` leads through a value that is not a table in {label}"
                raise OptionError(msg) from None
        files = {text: self._digest(scene.parent / text) for text in sorted(set(_texts(varied_document)))}
        content = [label, varied_document, {text: digest for text, digest in files.items() if digest}, start]
        identity = hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()
        words = [Path(label).stem] if len(self.scenes) > 1 else []
        words += [f"{key.rsplit('.', 1)[-1]}-{format_value(value)}" for key, value in varied.items()]
        text = " ".join(words or [Path(label).stem]).lower()
        name = re.sub(r"[^a-z0-9.]+", "-", text).strip("-.")[:MAX_NAME_LENGTH]
        return SweepRun(f"{name}-{identity[:12]}", identity, label, scene, varied_document, varied, start)

    def _digest(self, path: Path) -> str:
        """Return the digest of a file's content; empty if `path`, which may be any text, is not a file."""
        if path not in self._digests:
            digest = ""
            try:
                if len(str(path)) < MAX_PATH_LENGTH and path.is_file():
                    with path.open("rb") as stream:
                        digest = hashlib.file_digest(stream, "sha256").hexdigest()
            except (OSError, ValueError):
                pass
            self._digests[path] = digest
        return self._digests[path]


def dotted(key: tuple[str, ...]) -> str:
    """Return a key as it is written in TOML."""
    return ".".join(name if re.fullmatch(r"[\w-]+", name, re.ASCII) else json.dumps(name) for name in key)


def format_value(value: object) -> str:
    """Return a value as a table shows it: text unchanged, everything else as JSON."""
    return value if isinstance(value, str) else json.dumps(value, default=str)


def _combinations(axes: list[Axis]) -> Iterator[dict[tuple[str, ...], Any]]:
    for values in itertools.product(*(axis.values for axis in axes)):
        yield dict(zip((axis.key for axis in axes), values, strict=True))


def _put(table: dict[str, Any], key: tuple[str, ...], value: Any) -> None:
    for name in key[:-1]:
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            raise TypeError(name)
    table[key[-1]] = copy.deepcopy(value)


def _texts(value: Any) -> Iterator[str]:
    """Yield all strings in a document; any string may name a file."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list):
        for item in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(item)
