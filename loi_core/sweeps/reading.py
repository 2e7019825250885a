"""Reading sweep files: TOML in, a checked :class:`~loi_core.sweeps.plan.Sweep` out."""

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
from loi_core.scenes.where import Where
from loi_core.support.values import whole_number
from loi_core.support.wording import shown
from loi_core.sweeps.plan import MOST_RUNS, Axis, Sweep, dotted

__all__ = ["read_sweep"]

KEYS: Final = ("scene", "vary", "seeds", "starts", "timeout", "rank", "output", "title")
VARIED: Final = tuple(key for key in SCENE_KEYS if key not in ("output", "title"))
SEED: Final = ("fit", "seed")
APART: Final = 10**6  # between seeds: step k of a fit renders with its seed + k
MOST_STARTS: Final = 4096
RANKS: Final = ("psnr", "value", "seconds")
ERROR: Final = re.compile(r"error\..+")


def read_sweep(path: Path, *, output: Path | None = None) -> Sweep:
    """Read a sweep file and the scene files that it names.

    Parameters
    ----------
    path : Path
        A TOML file; paths in it are relative to its folder.
    output : Path, optional
        Overrides the file's own output folder.

    Raises
    ------
    SceneError
        For a missing or damaged file, an unknown key, or a wrong type or value: one line that names it.
    OptionError
        For a folder of results that cannot be written to.
    """
    path = Path(os.path.abspath(path))  # noqa: PTH100 - `resolve` would follow links, and change what users see
    document = read_toml(path)
    where = Where(path)
    where.known("", document, KEYS)
    scenes = {label: read_toml(path.parent / label) for label in _scenes(where, document)}
    axes = list(_axes(where, where.table("", document, "vary")))
    if "seeds" in document:
        if any(axis.key == SEED for axis in axes):
            raise where.error("", "`seeds` and `fit.seed` of [vary] exclude each other; give one of them")
        axes.append(Axis(SEED, _seeds(where, document["seeds"])))
    name = where.text("", document, "output") if "output" in document else f"{path.stem}-result"
    results = path.parent / name if output is None else Path(os.path.abspath(output))  # noqa: PTH100 - likewise
    where.check_output(results, own=output is None, of="sweep", beside="")
    timeout = document.get("timeout")
    try:
        check_timeout("timeout", timeout)
        return Sweep(
            path=path,
            title=where.text("", document, "title") if "title" in document else path.stem,
            output=results,
            scenes=scenes,
            axes=tuple(axes),
            starts=_starts(where, document.get("starts", 1)),
            timeout=timeout,
            rank=_rank(where, document.get("rank", RANKS[0])),
        )
    except OptionError as error:
        said = str(error)
        raise (where.error("", said) if not said.startswith(str(path)) else SceneError(said)) from error


def _scenes(where: Where, document: Mapping[str, Any]) -> list[str]:
    if "scene" not in document:
        raise where.error("", "`scene` is missing; it names the scene file to fit, or a list of them")
    given = document["scene"]
    listed = given if isinstance(given, list) else [given]
    if not listed or not all(isinstance(one, str) and one and "\0" not in one for one in listed):
        raise where.error("", f"`scene` must be the path of a scene file, or a list of them, got {shown(given)}")
    return list(dict.fromkeys(listed))


def _axes(where: Where, table: Mapping[str, Any], above: tuple[str, ...] = ()) -> Iterator[Axis]:
    for part, value in table.items():
        key = (*above, part)
        if not above and part not in VARIED:
            if "." in part and part.split(".")[0] in VARIED:
                raise where.error("vary", f"`{part}` is one key in quotes; write it without them")
            where.known("vary", {part: value}, VARIED)
        if isinstance(value, Mapping) and value:
            yield from _axes(where, value, key)
        elif isinstance(value, list) and value:
            yield Axis(key, tuple(value))
        else:
            raise where.error("vary", f"`{dotted(key)}` must be a list of values to take in turn, got {shown(value)}")


def _seeds(where: Where, given: Any) -> tuple[int, ...]:
    if isinstance(given, list):
        numbers = [whole_number(one) for one in given]
        if numbers and all(one is not None and one >= 0 for one in numbers):
            return tuple(one for one in numbers if one is not None)
    else:
        count = whole_number(given)
        if count is not None and 1 <= count <= MOST_RUNS:
            return tuple(APART * one for one in range(count))
    raise where.error("", f"`seeds` must be how many, 1 or more, or a list of seeds, got {shown(given)}")


def _starts(where: Where, given: Any) -> int:
    count = whole_number(given)
    if count is None or not 1 <= count <= MOST_STARTS:
        raise where.error("", f"`starts` must be a whole number from 1 to {MOST_STARTS}, got {shown(given)}")
    return count


def _rank(where: Where, given: Any) -> str:
    if not isinstance(given, str) or (given not in RANKS and not ERROR.fullmatch(given)):
        raise where.error("", f"`rank` must be {', '.join(map(repr, RANKS))} or 'error.PARAMETER', got {shown(given)}")
    return given
