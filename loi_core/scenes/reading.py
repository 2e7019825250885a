"""Reading of scene files: TOML in, a checked :class:`~loi_core.scenes.scene.Scene` out."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
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
from loi_core.scenes.renderers import make_renderer
from loi_core.scenes.scene import FitOptions, Scene, SceneView
from loi_core.scenes.tables import TableReader
from loi_core.scenes.target import BLACK, Target, prepare_target
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import shown

__all__ = ["SCENE_KEYS", "load_scene", "make_scene"]

LOI: Final = "loi"
"""Name of :class:`LOIObjective` in scene files."""

TARGET_KEYS: Final = ("target", "encoding", "alpha", "weights")
SCENE_KEYS: Final = (*TARGET_KEYS, "output", "title", "renderer", "views", "optimise", "scales", "objective", "fit")
VIEW_KEYS: Final = (*TARGET_KEYS, "renderer")
VIEW_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
MAX_VIEWS: Final = 256
FREE_KEYS: Final = ("initial", "lower", "upper", "learning_rate", "truth")
SCALE_KEYS: Final = ("preset", "sigma", "alpha", "beta", "bounds", "boundary", "p")
OBJECTIVE_KEYS: Final = ("name", "compare", "accuracy", "nan_policy", "tone", "exposure", "colours")
TONE_KEYS: Final = ("peak", "compression")
FIT_KEYS: Final = ("steps", "learning_rate", "decay", "seed", "stages", "polish", "starts", "views_per_step")


def load_scene(path: Path, *, output: Path | None = None, samples: int | None = None) -> Scene:
    """Read a scene file and the files and plugins that it names.

    Parameters
    ----------
    path : Path
        A TOML file; paths in it are relative to its folder.
    output : Path, optional
        Overrides the output folder of the file.
    samples : int, optional
        Overrides the renderer's samples per pixel; only for a scene whose own ``samples`` is not None.

    Raises
    ------
    SceneError
        For a missing or damaged file, an unknown key, or a wrong type or value: one line that names it.
    LoiError
        For an image that cannot be read, a renderer that is not installed, or a scale out of range.
    """
    return make_scene(read_toml(path), path, output=output, samples=samples)


def make_scene(
    document: Mapping[str, Any], path: Path, *, output: Path | None = None, samples: int | None = None
) -> Scene:
    """Return the scene of a document, as if it were the content of the file at `path`.

    Other arguments and errors: see :func:`load_scene`.
    """
    reader = TableReader(path)
    reader.check_keys("", document, SCENE_KEYS)
    for key in ("views" if "views" in document else "target", "renderer", "optimise"):
        if key not in document:
            raise reader.error("", f"`{key}` is missing; a scene needs target, [renderer] and [optimise.NAME]")
    tone = _tone(reader, reader.table("", document, "objective"))
    views, spp = {}, None
    for name, table in _view_tables(reader, document).items():
        views[name], spp = _view(reader, table, document, samples)
    optimise, truth = _optimise(reader, reader.table("", document, "optimise"), views)
    folder = reader.text("", document, "output") if "output" in document else f"{path.stem}-result"
    results = path.parent / folder if output is None else output
    reader.check_output(results, from_file=output is None, file_type="scene")
    return Scene(
        path=path,
        title=reader.text("", document, "title") if "title" in document else path.stem,
        output=results,
        views=views,
        optimise=optimise,
        truth=truth,
        fit=_fit_options(reader, reader.table("", document, "fit"), views),
        samples=spp,
        tone=tone,
    )


@dataclass(frozen=True)
class _ViewTable:
    """The heading of a view in the file, its table, and the options of its renderer."""

    heading: str
    table: Mapping[str, Any]
    options: Mapping[str, Any]


def _view_tables(reader: TableReader, document: Mapping[str, Any]) -> dict[str, _ViewTable]:
    """Return the views by name; one with an empty name for a document without ``[views]``."""
    shared = reader.table("", document, "renderer")
    if "views" not in document:
        return {"": _ViewTable("", document, shared)}
    tables = reader.table("", document, "views")
    duplicate = next((key for key in TARGET_KEYS if key in document), None)
    if duplicate:
        raise reader.error("", f"`{duplicate}` and [views] exclude each other; each view has its own")
    if not 1 <= len(tables) <= MAX_VIEWS:
        raise reader.error("views", f"must list 1 to {MAX_VIEWS} views, got {len(tables)}")
    views: dict[str, _ViewTable] = {}
    for name in tables:
        if not VIEW_NAME.fullmatch(name):
            raise reader.error("views", f"views are named by letters, digits, - and _, got {shown(name)}")
        heading, table = f"views.{name}", reader.table("views", tables, name)
        reader.check_keys(heading, table, VIEW_KEYS)
        if "target" not in table:
            raise reader.error(heading, "`target` is missing")
        overrides = reader.table(heading, table, "renderer")
        if "name" in overrides:
            raise reader.error(heading, "`name` of the renderer is the same for all views; give it in [renderer]")
        options = {**shared, **overrides}
        if isinstance(shared.get("images"), Mapping) and isinstance(overrides.get("images"), Mapping):
            options["images"] = {**shared["images"], **overrides["images"]}
        views[name] = _ViewTable(heading, table, options)
    return views


def _view(
    reader: TableReader, view: _ViewTable, document: Mapping[str, Any], samples: int | None
) -> tuple[SceneView, int | None]:
    """Return a view, and the samples per pixel of its renderer; None without that option."""
    path = reader.path.parent / reader.text(view.heading, view.table, "target")
    stored = read_stored(path)
    renderer, spp = make_renderer(
        reader,
        f"{view.heading}.renderer" if view.heading else "renderer",
        view.options,
        stored.colours,
        samples=samples,
        optimised=reader.table("", document, "optimise"),
    )
    target = _target(reader, view, path, stored, renderer)
    objective = reader.table("", document, "objective")
    scales = _scales(reader, reader.table("", document, "scales"), target.image, objective.get("colours"))
    return SceneView(renderer, target, scales, _objectives(reader, objective, target, scales)), spp


def _target(reader: TableReader, view: _ViewTable, path: Path, stored: StoredImage, renderer: Renderer) -> Target:
    """Return the target in the encoding of the renderer's images."""
    table = view.table
    encoding, rendered = table.get("encoding"), capabilities_of(renderer).encoding
    if rendered is None and encoding is not None:
        rendered = "linear"  # an explicit encoding of the file implies a conversion to the renderer's
    weights = reader.path.parent / reader.text(view.heading, table, "weights") if "weights" in table else None
    try:
        return prepare_target(
            path, stored, to=rendered, encoding=encoding, alpha=table.get("alpha", BLACK), weights=weights
        )
    except OptionError as error:
        raise reader.error(view.heading, str(error)) from error


def _optimise(
    reader: TableReader, table: Mapping[str, Any], views: Mapping[str, SceneView]
) -> tuple[dict[str, Free], dict[str, np.ndarray[Any, Any]]]:
    """Return the free parameters and the true values that the file gives."""
    shared = SharedParameters({name: view.renderer for name, view in views.items()})
    try:
        params = own_parameters(shared)
    except RendererError as error:
        if "" in views:
            raise
        raise reader.error("views", str(error)) from error
    if not table:
        raise reader.error("optimise", f"must name at least one parameter of {', '.join(params)}")
    reader.check_keys("optimise", table, tuple(params))
    free, truth = {}, {}
    for name in table:
        entry = reader.table("optimise", table, name)
        heading = f"optimise.{name}"
        reader.check_keys(heading, entry, FREE_KEYS)
        for key in ("initial", "lower", "upper", "truth"):
            if key in entry:
                _check_numbers(reader, heading, key, entry[key], tuple(params[name].shape))
        rate = entry.get("learning_rate")
        if rate is not None:
            try:
                check_rate("learning_rate", rate)
            except OptionError as error:
                raise reader.error(heading, str(error)) from error
        free[name] = Free(entry.get("initial"), entry.get("lower"), entry.get("upper"), rate)
        if "truth" in entry:
            truth[name] = np.broadcast_to(np.asarray(entry["truth"], dtype=np.float64), tuple(params[name].shape))
    try:  # an error in the bounds is reported before the first render
        bounds_of(starting_parameters(shared, free), free)
    except ParameterError as error:
        raise reader.error("optimise", str(error)) from error
    return free, truth


def _check_numbers(reader: TableReader, heading: str, key: str, value: object, shape: tuple[int, ...]) -> None:
    flat: list[Any] = [value]
    while any(isinstance(item, list) for item in flat):
        flat = [inner for item in flat for inner in (item if isinstance(item, list) else [item])]
    if not flat or any(isinstance(item, bool) or not isinstance(item, int | float) for item in flat):
        raise reader.error(heading, f"`{key}` must be numbers, got {shown(value)}")
    if any(np.isnan(real_number(item)) for item in flat) or (
        key == "truth" and not all(math.isfinite(item) for item in flat)
    ):
        raise reader.error(heading, f"`{key}` must be {'finite' if key == 'truth' else 'numbers'}, got {shown(value)}")
    try:
        array = np.asarray(value, dtype=np.float64)
    except ValueError:
        raise reader.error(heading, f"`{key}` must have shape {shape}, got rows of different lengths") from None
    if not fills(array, shape):
        raise reader.error(heading, f"`{key}` must be one number or fill shape {shape}, got shape {array.shape}")


def _scales(reader: TableReader, table: Mapping[str, Any], target: FloatImage, colours: object) -> ScaleSpace:
    reader.check_keys("scales", table, SCALE_KEYS)
    overrides = [key for key in ("sigma", "alpha", "beta") if key in table]
    options = {key: value for key, value in table.items() if key not in ("preset", "sigma", "alpha", "beta")}
    try:
        if "preset" in table:
            if overrides:
                raise reader.error("scales", f"`preset` and `{overrides[0]}` exclude each other; give one of them")
            base = ScaleSpace.paper(table["preset"])
        else:
            height, width = target.shape[:2]
            # `_objectives` rejects any other value.
            valid: Colours = "differences" if colours == "differences" else "channels"
            base = default_scales(height, width, valid, bounds=table.get("bounds", (0.0, 1.0)))
        values = {key: table.get(key, getattr(base, key)) for key in ("sigma", "alpha", "beta")}
        return ScaleSpace(**values, **options)
    except OptionError as error:
        raise reader.error("scales", str(error)) from error


def _tone(reader: TableReader, objective: Mapping[str, Any]) -> LogTone | None:
    if "tone" not in objective:
        return None
    table = reader.table("objective", objective, "tone")
    reader.check_keys("objective.tone", table, TONE_KEYS)
    if "peak" not in table:
        raise reader.error("objective.tone", "`peak` is missing; it is the radiance that becomes 1")
    try:
        return LogTone(**table)
    except OptionError as error:
        raise reader.error("objective.tone", str(error)) from error


def _objectives(
    reader: TableReader, table: Mapping[str, Any], target: Target, scales: ScaleSpace
) -> dict[str, Objective]:
    reader.check_keys("objective", table, OBJECTIVE_KEYS)
    compare = table.get("compare", [])
    if not isinstance(compare, list):
        raise reader.error("objective", f"`compare` must be a list of names, got {shown(compare)}")
    names = [table.get("name", LOI), *compare]
    for name in names:
        available = (LOI, *baseline_names())
        if name not in available:
            raise reader.error("objective", f"objectives are {', '.join(available)}, got {shown(name)}")
    for option in ("exposure", "colours"):
        if option in table and LOI not in names:
            raise reader.error("objective", f"`{option}` is an option of {LOI}, got {', '.join(names)}")
    policy, tone = table.get("nan_policy", "raise"), _tone(reader, table)
    objectives: dict[str, Objective] = {}
    try:
        for name in dict.fromkeys(names):
            if name == LOI:
                objectives[name] = LOIObjective(
                    target.image,
                    scales,
                    table.get("accuracy", "exact"),
                    nan_policy=policy,
                    tone=tone,
                    weights=target.weights,
                    exposure=table.get("exposure", "given"),
                    colours=table.get("colours", "channels"),
                )
            else:
                objectives[name] = make_baseline(
                    name, target.image, nan_policy=policy, tone=tone, weights=target.weights
                )
    except LoiError as error:
        raise reader.error("objective", str(error)) from error
    return objectives


def _fit_options(reader: TableReader, table: Mapping[str, Any], views: Collection[str]) -> FitOptions:
    reader.check_keys("fit", table, FIT_KEYS)
    options = FitOptions(**table)
    try:
        check_fit_options(options.steps, options.learning_rate, options.seed, options.decay, options.starts)
    except OptionError as error:
        raise reader.error("fit", str(error)) from error
    if options.stages not in ("auto", "none"):
        raise reader.error("fit", f"`stages` must be 'auto' or 'none', got {shown(options.stages)}")
    if options.polish not in ("pixels", "none"):
        raise reader.error("fit", f"`polish` must be 'pixels' or 'none', got {shown(options.polish)}")
    count = options.views_per_step
    if count is not None and "" in views:
        raise reader.error("fit", f"`views_per_step` must be left out of a scene without [views], got {shown(count)}")
    if count is not None and not 1 <= (whole_number(count) or 0) <= len(views):
        raise reader.error("fit", f"`views_per_step` must be a whole number from 1 to {len(views)}, got {shown(count)}")
    return options
