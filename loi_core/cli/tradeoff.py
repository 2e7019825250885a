"""``loi tradeoff``: the cost of accuracy on this machine."""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from pathlib import Path
from typing import Final

from loi_core.cli.bundled import copy_scene
from loi_core.cli.codes import DONE, FAILED
from loi_core.cli.progress import ProgressBar
from loi_core.errors import OptionError, SceneError
from loi_core.io.files import check_writable
from loi_core.io.images import FloatImage, read_image
from loi_core.method.scales import ScaleSpace
from loi_core.report import tradeoff_lines, write_tradeoff
from loi_core.scenes.experiment import Start
from loi_core.scenes.reading import load_scene
from loi_core.tradeoff import Problem, measure

__all__ = ["run"]

SCENES: Final = ("disks", "photograph")
DEFAULT_SCENE: Final = "photograph"


def run(options: argparse.Namespace) -> int:
    """Measure one problem, print the tables and write them; FAILED if it was interrupted or nothing was measured."""
    if not 0.0 < options.seconds < math.inf:
        msg = f"`--seconds` must be a finite number, more than 0, got {options.seconds!r}"
        raise OptionError(msg)
    image, reference = options.image, options.reference
    if (image is None) != (reference is None):
        msg = f"`--image` and `--reference` go together, got only `--{'image' if image else 'reference'}`"
        raise OptionError(msg)
    if image is not None and options.scene is not None:
        msg = "`--image` and `--scene` exclude each other; give one of them"
        raise OptionError(msg)
    check_writable("--output", options.output)
    with tempfile.TemporaryDirectory() as folder, ProgressBar() as bar:  # the folder is for a bundled scene
        if image is not None:
            problem = _image_problem(image, reference)
        else:
            problem = _scene_problem(options.scene or DEFAULT_SCENE, Path(folder), options.output)
        result = measure(problem, options.backend, seconds=options.seconds, progress=bar.begin)
    answer = write_tradeoff(options.output, result)
    if options.json:
        print(json.dumps(answer, indent=2, allow_nan=False))
    else:
        print("\n".join(tradeoff_lines(result)))
        print(f"\nreport: {answer['report']}")
    return FAILED if result.interrupted or all(row.problem for row in result.rows) else DONE


def _image_problem(image: Path, reference: Path) -> Problem:
    first, second = _read_colours(image), _read_colours(reference)
    if first.shape != second.shape:
        msg = f"`--image` and `--reference` must have the same shape, got {first.shape} and {second.shape}"
        raise OptionError(msg)
    return Problem(f"{image.name} and {reference.name}", first, second, ScaleSpace.for_image(*first.shape[:2]))


def _read_colours(path: Path) -> FloatImage:
    return read_image(path)[..., :3]


def _scene_problem(name: str, folder: Path, output: Path) -> Problem:
    path = Path(name)
    if name in SCENES:
        path = copy_scene(name, folder)
    elif path.suffix != ".toml":
        msg = f"`--scene` must be a file that ends in .toml, or one of {', '.join(SCENES)}, got {name!r}"
        raise SceneError(msg)
    scene = load_scene(path, output=output)
    image, target = Start.of(scene).host.astype("float64"), scene.target
    if scene.tone is not None:
        image, target = scene.tone.apply(image), scene.tone.apply(target)
    return Problem(scene.title, image, target, scene.scales, scene)
