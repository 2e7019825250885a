"""Reading scene files, and making what they name: TOML in, a checked :class:`~loi_core.scenes.scene.Scene` out."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from inspect import Parameter, formatannotation, signature
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.errors import LoiError, OptionError, SceneError
from loi_core.fitting.loop import check_fit_options
from loi_core.fitting.parameters import Free, bounds_of, check_rate, own_parameters, starting_parameters
from loi_core.io.files import check_writable
from loi_core.io.images import FloatImage, read_image
from loi_core.io.toml import read_toml
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import LOIObjective, Objective
from loi_core.pixels.tone_curve import LogTone
from loi_core.plugins.baselines import baseline_names, make_baseline
from loi_core.plugins.registry import RendererFactory, load_renderer
from loi_core.renderers.contract import Renderer
from loi_core.scenes.scene import FitOptions, Scene
from loi_core.support.guards import is_ctrl_c
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import described, shown

__all__ = ["load_scene"]

OURS: Final = "loi"

TOP_KEYS: Final = ("target", "output", "title", "renderer", "optimise", "scales", "objective", "fit")
FREE_KEYS: Final = ("initial", "lower", "upper", "learning_rate", "truth")
SCALE_KEYS: Final = ("preset", "sigma", "alpha", "beta", "bounds", "boundary", "p")
OBJECTIVE_KEYS: Final = ("name", "compare", "accuracy", "nan_policy", "tone")
TONE_KEYS: Final = ("peak", "compression")
FIT_KEYS: Final = ("steps", "learning_rate", "decay", "seed", "stages", "starts")


def load_scene(path: Path, *, output: Path | None = None, samples: int | None = None) -> Scene:
    """Read a scene file and everything that it names.

    Parameters
    ----------
    path : Path
        A TOML file; paths in it are relative to its folder.
    output : Path, optional
        Overrides the file's own output folder.
    samples : int, optional
        Overrides the renderer's samples per pixel; only for a scene whose own ``samples`` is not None.

    Raises
    ------
    SceneError
        For a missing or damaged file, an unknown key, or a wrong type or value: one line that names it.
    LoiError
        For what it names: an image that cannot be read, a renderer that is not installed, a scale out of range.
    """
    document = read_toml(path)
    where = _Where(path)
    where.known("", document, TOP_KEYS)
    for key in ("target", "renderer", "optimise"):
        if key not in document:
            raise where.error("", f"`{key}` is missing; a scene needs target, [renderer] and [optimise.NAME]")
    folder = path.parent
    target = read_image(folder / where.text("", document, "target"))[..., :3]
    renderer, spp = _renderer(where, where.table("", document, "renderer"), folder, target, samples)
    optimise, truth = _optimise(where, where.table("", document, "optimise"), renderer)
    scales = _scales(where, where.table("", document, "scales"), target)
    comparison = where.table("", document, "objective")
    tone = _tone(where, comparison)
    objectives = _objectives(where, comparison, target, scales, tone)
    name = where.text("", document, "output") if "output" in document else f"{path.stem}-result"
    results = folder / name if output is None else output
    _check_output(where, results, own=output is None)
    return Scene(
        path=path,
        title=where.text("", document, "title") if "title" in document else path.stem,
        output=results,
        renderer=renderer,
        target=target,
        scales=scales,
        objectives=objectives,
        optimise=optimise,
        truth=truth,
        fit=_fit_options(where, where.table("", document, "fit")),
        samples=spp,
        tone=tone,
    )


@dataclass(frozen=True)
class _Where:
    """Reads values out of a scene's tables; its errors name the file, the table and the key."""

    path: Path

    def error(self, table: str, message: str) -> SceneError:
        return SceneError(f"{self.path}: {f'[{table}] ' if table else ''}{message}")

    def known(self, name: str, table: Mapping[str, Any], keys: tuple[str, ...]) -> None:
        for key in table:
            if key not in keys:
                near = get_close_matches(key, keys, 1)
                hint = f"did you mean `{near[0]}`?" if near else f"known are {', '.join(keys)}"
                raise self.error(name, f"unknown key `{key}`; {hint}")

    def table(self, name: str, parent: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        value = parent.get(key, {})
        if not isinstance(value, Mapping):
            raise self.error(name, f"`{key}` must be a table, got {shown(value)}")
        return value

    def text(self, name: str, table: Mapping[str, Any], key: str) -> str:
        value = table[key]
        if not isinstance(value, str) or not value or "\0" in value:
            raise self.error(name, f"`{key}` must be a text that is not empty, got {shown(value)}")
        return value


def _check_output(where: _Where, results: Path, *, own: bool) -> None:
    check_writable("output", results)
    home, there = (os.path.realpath(path) for path in (where.path.parent, results))
    if own and not Path(there).is_relative_to(home):
        raise where.error("", f"`output` must lie in the folder of the scene, got {shown(str(results))}; use --output")
    if home == there:
        raise where.error("", "`output` must be a folder of its own, not that of the scene and its images")


def _renderer(
    where: _Where, table: Mapping[str, Any], folder: Path, target: FloatImage, samples: int | None
) -> tuple[Renderer, int | None]:
    """The renderer of a scene, and its samples per pixel if that is an option."""
    if "name" not in table:
        raise where.error("renderer", "`name` is missing")
    name = where.text("renderer", table, "name")
    factory = load_renderer(name)
    options = {key: value for key, value in table.items() if key not in ("name", "images")}
    images = where.table("renderer", table, "images")
    for key in images:
        if key in options:
            raise where.error("renderer.images", f"`{key}` is given in [renderer] as well")
        options[key] = read_image(folder / where.text("renderer.images", images, key))
    accepted = _accepted(factory)
    for key, argument in (accepted or {}).items():
        if isinstance(options.get(key), str) and _is_path(argument):
            options[key] = folder / where.text("renderer", options, key)
    if accepted is not None and not any(one.kind is Parameter.VAR_KEYWORD for one in accepted.values()):
        where.known("renderer", options, tuple(accepted))
    for key, size in (("height", target.shape[0]), ("width", target.shape[1])):
        if accepted is None or key not in accepted:
            continue
        if options.setdefault(key, size) != size:  # a renderer that has to be told its size gets the target's
            raise where.error("renderer", f"`{key}` must be that of the target, {size}, got {shown(options[key])}")
    if samples is not None:
        options["spp"] = samples
    for key, argument in (accepted or {}).items():
        named = argument.kind in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
        if named and argument.default is Parameter.empty and key not in options:
            raise where.error("renderer", f"`{key}` is missing; {name} needs it")
    try:
        renderer = factory(**options)
        usable = isinstance(renderer, Renderer)
    except BaseException as error:  # a third party may raise anything, SystemExit too
        if is_ctrl_c(error):
            raise
        said = str(error) if isinstance(error, LoiError) else f"{name} refused: {described(error)}"
        raise where.error("renderer", said) from error
    if not usable:
        raise where.error("renderer", f"{name} made a {type(renderer).__name__}, which is not a renderer")
    declared = (accepted or {}).get("spp")
    return renderer, whole_number(options.get("spp", declared.default if declared else None))


def _accepted(factory: RendererFactory) -> Mapping[str, Parameter] | None:
    """The arguments that a factory declares; None for compiled ones that declare nothing."""
    try:
        return signature(factory).parameters
    except Exception:  # compiled ones declare nothing, and a third party may declare anything
        return None


def _is_path(argument: Parameter) -> bool:
    """Whether a factory says that this argument is, or may be, a path."""
    # By the annotation's text: often it is one, and may name what only type checkers import.
    try:
        spelled = formatannotation(argument.annotation)
    except Exception:  # a third party may annotate with anything
        return False
    return re.search(r"\bPath\b", spelled) is not None


def _optimise(
    where: _Where, table: Mapping[str, Any], renderer: Renderer
) -> tuple[dict[str, Free], dict[str, np.ndarray[Any, Any]]]:
    params = own_parameters(renderer)
    if not table:
        raise where.error("optimise", f"must name at least one parameter of {', '.join(params)}")
    where.known("optimise", table, tuple(params))
    free, truth = {}, {}
    for name in table:
        entry = where.table("optimise", table, name)
        heading = f"optimise.{name}"
        where.known(heading, entry, FREE_KEYS)
        for key in ("initial", "lower", "upper", "truth"):
            if key in entry:
                _numbers(where, heading, key, entry[key], tuple(params[name].shape))
        rate = entry.get("learning_rate")
        if rate is not None:
            try:
                check_rate("learning_rate", rate)
            except OptionError as error:
                raise where.error(heading, str(error)) from error
        free[name] = Free(entry.get("initial"), entry.get("lower"), entry.get("upper"), rate)
        if "truth" in entry:
            truth[name] = np.broadcast_to(np.asarray(entry["truth"], dtype=np.float64), tuple(params[name].shape))
    bounds_of(starting_parameters(renderer, free), free)  # a start outside its bounds is told now, not after a render
    return free, truth


def _numbers(where: _Where, heading: str, key: str, value: object, shape: tuple[int, ...]) -> None:
    flat: list[Any] = [value]
    while any(isinstance(one, list) for one in flat):
        flat = [inner for one in flat for inner in (one if isinstance(one, list) else [one])]
    if not flat or any(isinstance(one, bool) or not isinstance(one, int | float) for one in flat):
        raise where.error(heading, f"`{key}` must be numbers, got {shown(value)}")
    if any(np.isnan(real_number(one)) for one in flat) or (
        key == "truth" and not all(math.isfinite(one) for one in flat)
    ):
        raise where.error(heading, f"`{key}` must be {'finite' if key == 'truth' else 'numbers'}, got {shown(value)}")
    try:
        array = np.asarray(value, dtype=np.float64)
    except ValueError:
        raise where.error(heading, f"`{key}` must have shape {shape}, got rows of different lengths") from None
    if array.shape not in ((), shape):
        raise where.error(heading, f"`{key}` must be one number or have shape {shape}, got shape {array.shape}")


def _scales(where: _Where, table: Mapping[str, Any], target: FloatImage) -> ScaleSpace:
    where.known("scales", table, SCALE_KEYS)
    given = [key for key in ("sigma", "alpha", "beta") if key in table]
    options = {key: value for key, value in table.items() if key not in ("preset", "sigma", "alpha", "beta")}
    try:
        if "preset" in table:
            if given:
                raise where.error("scales", f"`preset` and `{given[0]}` exclude each other; give one of them")
            base = ScaleSpace.paper(table["preset"])
        else:
            base = ScaleSpace.for_image(*target.shape[:2])
        chosen = {key: table.get(key, getattr(base, key)) for key in ("sigma", "alpha", "beta")}
        return ScaleSpace(**chosen, **options)
    except OptionError as error:
        raise where.error("scales", str(error)) from error


def _tone(where: _Where, objective: Mapping[str, Any]) -> LogTone | None:
    if "tone" not in objective:
        return None
    table = where.table("objective", objective, "tone")
    where.known("objective.tone", table, TONE_KEYS)
    if "peak" not in table:
        raise where.error("objective.tone", "`peak` is missing; it is the radiance that becomes 1")
    try:
        return LogTone(**table)
    except OptionError as error:
        raise where.error("objective.tone", str(error)) from error


def _objectives(
    where: _Where, table: Mapping[str, Any], target: FloatImage, scales: ScaleSpace, tone: LogTone | None
) -> dict[str, Objective]:
    where.known("objective", table, OBJECTIVE_KEYS)
    compare = table.get("compare", [])
    if not isinstance(compare, list):
        raise where.error("objective", f"`compare` must be a list of names, got {shown(compare)}")
    names = [table.get("name", OURS), *compare]
    for name in names:
        known = (OURS, *baseline_names())
        if name not in known:
            raise where.error("objective", f"objectives are {', '.join(known)}, got {shown(name)}")
    policy = table.get("nan_policy", "raise")
    accuracy = table.get("accuracy", "exact")
    made: dict[str, Objective] = {}
    try:
        for name in dict.fromkeys(names):
            if name == OURS:
                made[name] = LOIObjective(target, scales, accuracy, nan_policy=policy, tone=tone)
            else:
                made[name] = make_baseline(name, target, nan_policy=policy, tone=tone)
    except LoiError as error:
        raise where.error("objective", str(error)) from error
    return made


def _fit_options(where: _Where, table: Mapping[str, Any]) -> FitOptions:
    where.known("fit", table, FIT_KEYS)
    options = FitOptions(**table)
    try:
        check_fit_options(options.steps, options.learning_rate, options.seed, options.decay, options.starts)
    except OptionError as error:
        raise where.error("fit", str(error)) from error
    if options.stages not in ("auto", "none"):
        raise where.error("fit", f"`stages` must be 'auto' or 'none', got {shown(options.stages)}")
    return options
