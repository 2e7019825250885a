"""Reading scene files, and making what they name: TOML in, a checked :class:`~loi_core.scenes.scene.Scene` out."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.errors import LoiError, OptionError, ParameterError, RendererError
from loi_core.fitting.loop import check_fit_options
from loi_core.fitting.parameters import (
    Free,
    SharedParameters,
    bounds_of,
    check_rate,
    fills,
    own_parameters,
    starting_parameters,
)
from loi_core.io.images import FloatImage, StoredImage, read_stored
from loi_core.io.toml import read_toml
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import LOIObjective, Objective
from loi_core.objectives.loi import default_scales
from loi_core.pixels.colours import Colours
from loi_core.pixels.tone_curve import LogTone
from loi_core.plugins.baselines import baseline_names, make_baseline
from loi_core.renderers.contract import Renderer, capabilities_of
from loi_core.scenes.making import make_renderer
from loi_core.scenes.scene import FitOptions, Scene, SceneView
from loi_core.scenes.target import BLACK, Target, prepare_target
from loi_core.scenes.where import Where
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import shown

__all__ = ["SCENE_KEYS", "load_scene", "make_scene"]

OURS: Final = "loi"

TARGET_KEYS: Final = ("target", "encoding", "alpha", "weights")
SCENE_KEYS: Final = (*TARGET_KEYS, "output", "title", "renderer", "views", "optimise", "scales", "objective", "fit")
VIEW_KEYS: Final = (*TARGET_KEYS, "renderer")
VIEW_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
MOST_VIEWS: Final = 256
FREE_KEYS: Final = ("initial", "lower", "upper", "learning_rate", "truth")
SCALE_KEYS: Final = ("preset", "sigma", "alpha", "beta", "bounds", "boundary", "p")
OBJECTIVE_KEYS: Final = ("name", "compare", "accuracy", "nan_policy", "tone", "colours")
TONE_KEYS: Final = ("peak", "compression")
FIT_KEYS: Final = ("steps", "learning_rate", "decay", "seed", "stages", "finish", "starts", "views_per_step")


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
    return make_scene(read_toml(path), path, output=output, samples=samples)


def make_scene(
    document: Mapping[str, Any], path: Path, *, output: Path | None = None, samples: int | None = None
) -> Scene:
    """The scene that a document describes, as if it stood in a file; arguments and errors of :func:`load_scene`."""
    where = Where(path)
    where.known("", document, SCENE_KEYS)
    for key in ("views" if "views" in document else "target", "renderer", "optimise"):
        if key not in document:
            raise where.error("", f"`{key}` is missing; a scene needs target, [renderer] and [optimise.NAME]")
    comparison = where.table("", document, "objective")
    tone = _tone(where, comparison)
    views, spp = {}, None
    for view, (heading, table, options) in _view_tables(where, document).items():
        views[view], spp = _view(where, heading, table, options, document, samples)
    optimise, truth = _optimise(where, where.table("", document, "optimise"), views)
    name = where.text("", document, "output") if "output" in document else f"{path.stem}-result"
    results = path.parent / name if output is None else output
    where.check_output(results, own=output is None, of="scene", beside=" and its images")
    return Scene(
        path=path,
        title=where.text("", document, "title") if "title" in document else path.stem,
        output=results,
        views=views,
        optimise=optimise,
        truth=truth,
        fit=_fit_options(where, where.table("", document, "fit"), views),
        samples=spp,
        tone=tone,
    )


def _view_tables(
    where: Where, document: Mapping[str, Any]
) -> dict[str, tuple[str, Mapping[str, Any], Mapping[str, Any]]]:
    """Of each view its heading, its table, and the options of its renderer; one without a name if none are listed."""
    common = where.table("", document, "renderer")
    if "views" not in document:
        return {"": ("", document, common)}
    listed = where.table("", document, "views")
    twice = next((key for key in TARGET_KEYS if key in document), None)
    if twice:
        raise where.error("", f"`{twice}` and [views] exclude each other; each view has its own")
    if not 1 <= len(listed) <= MOST_VIEWS:
        raise where.error("views", f"must list 1 to {MOST_VIEWS} views, got {len(listed)}")
    found: dict[str, tuple[str, Mapping[str, Any], Mapping[str, Any]]] = {}
    for name in listed:
        if not VIEW_NAME.fullmatch(name):
            raise where.error("views", f"views are named by letters, digits, - and _, got {shown(name)}")
        heading, table = f"views.{name}", where.table("views", listed, name)
        where.known(heading, table, VIEW_KEYS)
        if "target" not in table:
            raise where.error(heading, "`target` is missing")
        own = where.table(heading, table, "renderer")
        if "name" in own:
            raise where.error(heading, "`name` of the renderer is the same for all views; give it in [renderer]")
        options = {**common, **own}
        if isinstance(common.get("images"), Mapping) and isinstance(own.get("images"), Mapping):
            options["images"] = {**common["images"], **own["images"]}
        found[name] = heading, table, options
    return found


def _view(
    where: Where,
    heading: str,
    table: Mapping[str, Any],
    options: Mapping[str, Any],
    document: Mapping[str, Any],
    samples: int | None,
) -> tuple[SceneView, int | None]:
    """A view, and the samples per pixel of its renderer if that is an option."""
    path = where.path.parent / where.text(heading, table, "target")
    stored = read_stored(path)
    renderer, spp = make_renderer(
        where,
        f"{heading}.renderer" if heading else "renderer",
        options,
        stored.colours,
        samples=samples,
        moving=where.table("", document, "optimise"),
    )
    target = _target(where, heading, table, path, stored, renderer)
    comparison = where.table("", document, "objective")
    scales = _scales(where, where.table("", document, "scales"), target.image, comparison.get("colours"))
    objectives = _objectives(where, comparison, target, scales)
    return SceneView(renderer, target, scales, objectives), spp


def _target(
    where: Where, heading: str, table: Mapping[str, Any], path: Path, stored: StoredImage, renderer: Renderer
) -> Target:
    """The target as what the renderer makes."""
    encoding, makes = table.get("encoding"), capabilities_of(renderer).encoding
    if makes is None and encoding is not None:
        makes = "linear"  # whoever says what a file holds means it to be told from what is rendered
    weights = where.path.parent / where.text(heading, table, "weights") if "weights" in table else None
    try:
        return prepare_target(
            path, stored, to=makes, encoding=encoding, alpha=table.get("alpha", BLACK), weights=weights
        )
    except OptionError as error:
        raise where.error(heading, str(error)) from error


def _optimise(
    where: Where, table: Mapping[str, Any], views: Mapping[str, SceneView]
) -> tuple[dict[str, Free], dict[str, np.ndarray[Any, Any]]]:
    shared = SharedParameters({name: view.renderer for name, view in views.items()})
    try:
        params = own_parameters(shared)
    except RendererError as error:
        if "" in views:
            raise
        raise where.error("views", str(error)) from error
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
    try:  # a start outside its bounds is told now, not after a render
        bounds_of(starting_parameters(shared, free), free)
    except ParameterError as error:
        raise where.error("optimise", str(error)) from error
    return free, truth


def _numbers(where: Where, heading: str, key: str, value: object, shape: tuple[int, ...]) -> None:
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
    if not fills(array, shape):
        raise where.error(heading, f"`{key}` must be one number or fill shape {shape}, got shape {array.shape}")


def _scales(where: Where, table: Mapping[str, Any], target: FloatImage, colours: object) -> ScaleSpace:
    where.known("scales", table, SCALE_KEYS)
    given = [key for key in ("sigma", "alpha", "beta") if key in table]
    options = {key: value for key, value in table.items() if key not in ("preset", "sigma", "alpha", "beta")}
    try:
        if "preset" in table:
            if given:
                raise where.error("scales", f"`preset` and `{given[0]}` exclude each other; give one of them")
            base = ScaleSpace.paper(table["preset"])
        else:
            height, width = target.shape[:2]
            known: Colours = "differences" if colours == "differences" else "channels"  # others are refused further on
            base = default_scales(height, width, known, bounds=table.get("bounds", (0.0, 1.0)))
        chosen = {key: table.get(key, getattr(base, key)) for key in ("sigma", "alpha", "beta")}
        return ScaleSpace(**chosen, **options)
    except OptionError as error:
        raise where.error("scales", str(error)) from error


def _tone(where: Where, objective: Mapping[str, Any]) -> LogTone | None:
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


def _objectives(where: Where, table: Mapping[str, Any], target: Target, scales: ScaleSpace) -> dict[str, Objective]:
    where.known("objective", table, OBJECTIVE_KEYS)
    compare = table.get("compare", [])
    if not isinstance(compare, list):
        raise where.error("objective", f"`compare` must be a list of names, got {shown(compare)}")
    names = [table.get("name", OURS), *compare]
    for name in names:
        known = (OURS, *baseline_names())
        if name not in known:
            raise where.error("objective", f"objectives are {', '.join(known)}, got {shown(name)}")
    if "colours" in table and OURS not in names:
        raise where.error("objective", f"`colours` is an option of {OURS}, got {', '.join(names)}")
    policy, tone = table.get("nan_policy", "raise"), _tone(where, table)
    accuracy = table.get("accuracy", "exact")
    made: dict[str, Objective] = {}
    try:
        for name in dict.fromkeys(names):
            if name == OURS:
                made[name] = LOIObjective(
                    target.image,
                    scales,
                    accuracy,
                    nan_policy=policy,
                    tone=tone,
                    weights=target.weights,
                    colours=table.get("colours", "channels"),
                )
            else:
                made[name] = make_baseline(name, target.image, nan_policy=policy, tone=tone, weights=target.weights)
    except LoiError as error:
        raise where.error("objective", str(error)) from error
    return made


def _fit_options(where: Where, table: Mapping[str, Any], views: Collection[str]) -> FitOptions:
    where.known("fit", table, FIT_KEYS)
    options = FitOptions(**table)
    try:
        check_fit_options(options.steps, options.learning_rate, options.seed, options.decay, options.starts)
    except OptionError as error:
        raise where.error("fit", str(error)) from error
    if options.stages not in ("auto", "none"):
        raise where.error("fit", f"`stages` must be 'auto' or 'none', got {shown(options.stages)}")
    if options.finish not in ("pixels", "none"):
        raise where.error("fit", f"`finish` must be 'pixels' or 'none', got {shown(options.finish)}")
    at_once = options.views_per_step
    if at_once is not None and "" in views:
        raise where.error("fit", f"`views_per_step` must be left out of a scene without [views], got {shown(at_once)}")
    if at_once is not None and not 1 <= (whole_number(at_once) or 0) <= len(views):
        raise where.error(
            "fit", f"`views_per_step` must be a whole number from 1 to {len(views)}, got {shown(at_once)}"
        )
    return options
