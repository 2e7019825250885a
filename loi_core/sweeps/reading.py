"""Reading of sweep files: TOML in, a checked :class:`~loi_core.sweeps.plan.Sweep` out."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from loi_core.errors import OptionError, SceneError
from loi_core.io.toml import read_toml
from loi_core.runs.workers import check_timeout
from loi_core.scenes.reading import SCENE_KEYS
from loi_core.scenes.tables import TableReader
from loi_core.support.values import whole_number
from loi_core.support.wording import shown
from loi_core.sweeps.plan import MAX_RUNS, Axis, Sweep, dotted

__all__ = ["read_sweep"]

KEYS: Final = ("scene", "vary", "seeds", "starts", "timeout", "rank", "output", "title")
VARIED: Final = tuple(key for key in SCENE_KEYS if key not in ("output", "title"))
SEED: Final = ("fit", "seed")
SEED_STRIDE: Final = 10**6  # between seeds, since step k of a fit renders with its seed + k
MAX_STARTS: Final = 4096
RANKS: Final = ("psnr", "value", "seconds")
ERROR: Final = re.compile(r"error\..+")


def read_sweep(path: Path, *, output: Path | None = None) -> Sweep:
    """Read a sweep file and the scene files that it names.

    Parameters
    ----------
    path : Path
        A TOML file; paths in it are relative to its folder.
    output : Path, optional
        Overrides the output folder of the file.

    Raises
    ------
    SceneError
        For a missing or damaged file, an unknown key, or a wrong type or value: one line that names it.
    OptionError
        If the output folder is not writable.
    """
    path = Path(os.path.abspath(path))  # noqa: PTH100 - `resolve` would follow links, and change the path that users see
    document = read_toml(path)
    reader = TableReader(path)
    reader.check_keys("", document, KEYS)
    scenes = {label: read_toml(path.parent / label) for label in _scenes(reader, document)}
    axes = list(_axes(reader, reader.table("", document, "vary")))
    if "seeds" in document:
        if any(axis.key == SEED for axis in axes):
            raise reader.error("", "`seeds` and `fit.seed` of [vary] exclude each other; give one of them")
        axes.append(Axis(SEED, _seeds(reader, document["seeds"])))
    name = reader.text("", document, "output") if "output" in document else f"{path.stem}-result"
    results = path.parent / name if output is None else Path(os.path.abspath(output))  # noqa: PTH100 - likewise
    reader.check_output(results, from_file=output is None, file_type="sweep")
    timeout = document.get("timeout")
    try:
        check_timeout("timeout", timeout)
        return Sweep(
            path=path,
            title=reader.text("", document, "title") if "title" in document else path.stem,
            output=results,
            scenes=scenes,
            axes=tuple(axes),
            starts=_starts(reader, document.get("starts", 1)),
            timeout=timeout,
            rank=_rank(reader, document.get("rank", RANKS[0])),
        )
    except OptionError as error:
        message = str(error)
        raise (reader.error("", message) if not message.startswith(str(path)) else SceneError(message)) from error


def _scenes(reader: TableReader, document: Mapping[str, Any]) -> list[str]:
    if "scene" not in document:
        raise reader.error("", "`scene` is missing; it names the scene file to fit, or a list of them")
    value = document["scene"]
    labels = value if isinstance(value, list) else [value]
    if not labels or not all(isinstance(label, str) and label and "\0" not in label for label in labels):
        raise reader.error("", f"`scene` must be the path of a scene file, or a list of them, got {shown(value)}")
    return list(dict.fromkeys(labels))


def _axes(reader: TableReader, table: Mapping[str, Any], parents: tuple[str, ...] = ()) -> Iterator[Axis]:
    for name, value in table.items():
        key = (*parents, name)
        if not parents and name not in VARIED:
            if "." in name and name.split(".")[0] in VARIED:
                raise reader.error("vary", f"`{name}` is one key in quotes; write it without them")
            reader.check_keys("vary", {name: value}, VARIED)
        if isinstance(value, Mapping) and value:
            yield from _axes(reader, value, key)
        elif isinstance(value, list) and value:
            yield Axis(key, tuple(value))
        else:
            raise reader.error("vary", f"`{dotted(key)}` must be a list of values to take in turn, got {shown(value)}")


def _seeds(reader: TableReader, value: Any) -> tuple[int, ...]:
    if isinstance(value, list):
        numbers = [whole_number(item) for item in value]
        seeds = tuple(number for number in numbers if number is not None and number >= 0)
        if numbers and len(seeds) == len(numbers):
            return seeds
    else:
        count = whole_number(value)
        if count is not None and 1 <= count <= MAX_RUNS:
            return tuple(SEED_STRIDE * index for index in range(count))
    raise reader.error("", f"`seeds` must be their number, 1 or more, or a list of seeds, got {shown(value)}")


def _starts(reader: TableReader, value: Any) -> int:
    count = whole_number(value)
    if count is None or not 1 <= count <= MAX_STARTS:
        raise reader.error("", f"`starts` must be a whole number from 1 to {MAX_STARTS}, got {shown(value)}")
    return count


def _rank(reader: TableReader, value: Any) -> str:
    if not isinstance(value, str) or (value not in RANKS and not ERROR.fullmatch(value)):
        raise reader.error("", f"`rank` must be {', '.join(map(repr, RANKS))} or 'error.PARAMETER', got {shown(value)}")
    return value
