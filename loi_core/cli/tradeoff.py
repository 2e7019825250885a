"""``loi tradeoff``: what accuracy costs on this machine."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from tqdm import tqdm

from loi_core.cli.bundled import make_disks, make_photograph
from loi_core.errors import OptionError, SceneError
from loi_core.io.files import check_writable
from loi_core.io.images import FloatImage, read_image
from loi_core.method.scales import ScaleSpace
from loi_core.report import tradeoff_lines, write_tradeoff
from loi_core.scenes.experiment import Start
from loi_core.scenes.reading import load_scene
from loi_core.tradeoff import Problem, measure

__all__ = ["BUNDLED", "DEFAULT", "show_tradeoff"]

BUNDLED: Final = {"disks": make_disks, "photograph": make_photograph}
DEFAULT: Final = "photograph"


def show_tradeoff(
    *,
    image: Path | None,
    reference: Path | None,
    scene: str | None,
    backends: Sequence[str],
    output: Path,
    seconds: float,
    as_json: bool,
) -> bool:
    """Measure one problem, print the tables and write them; False if it was interrupted or nothing was measured."""
    if not 0.0 < seconds < math.inf:
        msg = f"`--seconds` must be a finite number, more than 0, got {seconds!r}"
        raise OptionError(msg)
    if (image is None) != (reference is None):
        msg = f"`--image` and `--reference` go together, got only `--{'image' if image else 'reference'}`"
        raise OptionError(msg)
    if image is not None and scene is not None:
        msg = "`--image` and `--scene` exclude each other; give one of them"
        raise OptionError(msg)
    check_writable("--output", output)
    with tempfile.TemporaryDirectory() as folder:  # for a bundled scene
        if image is not None and reference is not None:
            problem = _of_images(image, reference)
        else:
            problem = _of_scene(scene or DEFAULT, Path(folder), output)
        bar = _Bar()
        try:
            found = measure(problem, backends, seconds=seconds, progress=bar.step)
        finally:
            bar.close()
    answer = write_tradeoff(output, found)
    if as_json:
        print(json.dumps(answer, indent=2, allow_nan=False))
    else:
        print("\n".join(tradeoff_lines(found)))
        print(f"\nreport: {answer['report']}")
    return not found.interrupted and any(not row.problem for row in found.rows)


def _of_images(image: Path, reference: Path) -> Problem:
    first, second = _colours(image), _colours(reference)
    if first.shape != second.shape:
        msg = f"`--image` and `--reference` must have the same shape, got {first.shape} and {second.shape}"
        raise OptionError(msg)
    return Problem(f"{image.name} and {reference.name}", first, second, ScaleSpace.for_image(*first.shape[:2]))


def _colours(path: Path) -> FloatImage:
    return read_image(path)[..., :3]


def _of_scene(name: str, folder: Path, output: Path) -> Problem:
    path = Path(name)
    if name in BUNDLED:
        path = folder / name / "scene.toml"
        BUNDLED[name](path.parent)
    elif path.suffix != ".toml":
        msg = f"`--scene` must be a file that ends in .toml, or one of {', '.join(BUNDLED)}, got {name!r}"
        raise SceneError(msg)
    scene = load_scene(path, output=output)
    image, target = Start.of(scene).host.astype("float64"), scene.target
    if scene.tone is not None:
        image, target = scene.tone.apply(image), scene.tone.apply(target)
    return Problem(scene.title, image, target, scene.scales, scene)


class _Bar:
    """A progress bar on standard error; silent where that is not a terminal."""

    def __init__(self) -> None:
        self._bar: tqdm[Any] | None = None

    def step(self, total: int, what: str) -> None:
        """Say what is measured now."""
        if self._bar is None:
            self._bar = tqdm(total=total, disable=None)
        elif self._bar.n < total:
            self._bar.update()
        self._bar.set_postfix_str(what)

    def close(self) -> None:
        """Leave the bar as it is and end its line."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None
