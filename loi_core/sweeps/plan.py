"""What a sweep is of: its scenes, what varies, and each of its runs with all that it depends on."""

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

__all__ = ["MOST_RUNS", "REPEATS", "START", "Axis", "Sweep", "SweepRun", "dotted", "spelled"]

MOST_RUNS: Final = 100_000
LONGEST: Final = 48  # letters of what a name says, before its digest
LONGEST_PATH: Final = 4096
START: Final = "start"
REPEATS: Final = ("fit.seed", START)
"""What is varied to repeat a setting, and not to compare it with another."""


@dataclass(frozen=True)
class Axis:
    """A key of scene files, and the values that it takes in turn.

    Attributes
    ----------
    key : tuple of str
        Its parts: tables, then the key.
    values : tuple
        Whatever such a key may have.
    """

    key: tuple[str, ...]
    values: tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class SweepRun:
    """One fit of a sweep.

    Attributes
    ----------
    name : str
        Of its folder and its record.
    identity : str
        A digest of all that it depends on.
    label : str
        Its scene file, as the sweep calls it.
    scene : Path
        That file.
    document : dict
        What stands in it, with what varies put in.
    varied : dict
        What varies, by dotted key.
    start : int
        Which of the places within the bounds it starts from; 0 is the scene's own.
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
        Heads the page.
    output : Path
        Folder of the results.
    scenes : dict of dict
        The documents of the scene files, by their paths relative to the sweep's folder.
    axes : tuple of Axis
        What varies.
    starts : int
        From how many places each is fitted, one fit from each.
    timeout : float, optional
        Seconds that a run may take.
    rank : str
        The column by which the page ranks.
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
        if count > MOST_RUNS:
            msg = f"{self.path}: a sweep may have {MOST_RUNS} runs, got {count}"
            raise OptionError(msg)
        ranked = self.rank.removeprefix("error.")
        if ranked != self.rank and ranked not in self._with_truth:
            known = listed(sorted(self._with_truth)) or "none"
            msg = f"{self.path}: `rank` is by the error of {ranked!r}; the scenes have a `truth` of {known}"
            raise OptionError(msg)

    @property
    def _with_truth(self) -> set[str]:
        """The parameters whose truth is in a scene, or varies."""
        found = {axis.key[1] for axis in self.axes if len(axis.key) > 2 and axis.key[::2] == ("optimise", "truth")}
        for document in self.scenes.values():
            table = document.get("optimise")
            for name, entry in table.items() if isinstance(table, Mapping) else ():
                if isinstance(entry, Mapping) and "truth" in entry:
                    found.add(str(name))
        return found

    @cached_property
    def runs(self) -> tuple[SweepRun, ...]:
        """All of them, one repeat of everything before the next; equal ones once."""
        found: dict[str, SweepRun] = {}
        # Axes that only repeat vary slowest, so that early on there is something to compare.
        order = sorted(self.axes, key=lambda axis: dotted(axis.key) not in REPEATS)
        slow = sum(dotted(axis.key) in REPEATS for axis in order)
        first, last = order[:slow], order[slow:]
        for start, repeat in itertools.product(range(self.starts), _product(first)):
            for label, document in self.scenes.items():
                for rest in _product(last):
                    chosen = {**repeat, **rest}
                    run = self._run(label, document, {axis.key: chosen[axis.key] for axis in self.axes}, start)
                    found.setdefault(run.identity, run)
        return tuple(found.values())

    def _run(
        self, label: str, document: Mapping[str, Any], chosen: Mapping[tuple[str, ...], Any], start: int
    ) -> SweepRun:
        scene = self.path.parent / label
        varied = {dotted(key): value for key, value in chosen.items()}
        if self.starts > 1:
            varied[START] = start
        whole = copy.deepcopy(dict(document))
        for key, value in chosen.items():
            try:
                _put(whole, key, value)
            except TypeError:
                msg = f"{self.path}: [vary] `{dotted(key)}` leads through what is no table in {label}"
                raise OptionError(msg) from None
        files = {text: self._digest(scene.parent / text) for text in sorted(set(_texts(whole)))}
        told = [label, whole, {text: one for text, one in files.items() if one}, start]
        identity = hashlib.sha256(json.dumps(told, sort_keys=True, default=str).encode()).hexdigest()
        said = [Path(label).stem] if len(self.scenes) > 1 else []
        said += [f"{key.rsplit('.', 1)[-1]}-{spelled(value)}" for key, value in varied.items()]
        words = re.sub(r"[^a-z0-9.]+", "-", " ".join(said or [Path(label).stem]).lower()).strip("-.")[:LONGEST]
        return SweepRun(f"{words}-{identity[:12]}", identity, label, scene, whole, varied, start)

    def _digest(self, path: Path) -> str:
        """Of what is in a file; empty if there is none of this name: a text may be anything."""
        if path not in self._digests:
            found = ""
            try:
                if len(str(path)) < LONGEST_PATH and path.is_file():
                    with path.open("rb") as stream:
                        found = hashlib.file_digest(stream, "sha256").hexdigest()
            except (OSError, ValueError):
                pass
            self._digests[path] = found
        return self._digests[path]


def dotted(key: tuple[str, ...]) -> str:
    """A key as it is written in TOML."""
    return ".".join(part if re.fullmatch(r"[\w-]+", part, re.ASCII) else json.dumps(part) for part in key)


def spelled(value: object) -> str:
    """A value as a table shows it: texts as they are, numbers as they are typed, all else as JSON."""
    return value if isinstance(value, str) else json.dumps(value, default=str)


def _product(axes: list[Axis]) -> Iterator[dict[tuple[str, ...], Any]]:
    for values in itertools.product(*(axis.values for axis in axes)):
        yield dict(zip((axis.key for axis in axes), values, strict=True))


def _put(table: dict[str, Any], key: tuple[str, ...], value: Any) -> None:
    for part in key[:-1]:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise TypeError(part)
    table[key[-1]] = copy.deepcopy(value)


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list):
        for one in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(one)
