"""The renderer that a table of a scene file names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from inspect import Parameter, formatannotation, signature
from pathlib import Path
from typing import Any

from loi_core.errors import LoiError
from loi_core.io.images import FloatImage, read_image
from loi_core.plugins.registry import RendererFactory, load_renderer
from loi_core.renderers.blurred import BLUR_KEYS, BlurredRenderer
from loi_core.renderers.contract import Renderer
from loi_core.scenes.target import read_target
from loi_core.scenes.where import Where
from loi_core.support.guards import is_ctrl_c, wrap_errors
from loi_core.support.values import whole_number
from loi_core.support.wording import described, shown

__all__ = ["make_renderer"]


def make_renderer(
    where: Where,
    heading: str,
    table: Mapping[str, Any],
    target: FloatImage,
    *,
    samples: int | None,
    moving: Iterable[str],
) -> tuple[Renderer, int | None]:
    """The renderer of a view, and its samples per pixel if that is an option.

    A table `blur` is for a renderer that takes it, or else for a blur around it, of what is `moving` by default.
    """
    folder = where.path.parent
    if "name" not in table:
        raise where.error(heading, "`name` is missing")
    name = where.text(heading, table, "name")
    factory = load_renderer(name)
    accepted = _accepted(factory)
    options = {key: value for key, value in table.items() if key not in ("name", "images")}
    blur = where.table(heading, table, "blur") if "blur" in table else None
    where.known(f"{heading}.blur", blur or {}, BLUR_KEYS)
    if "blur" not in (accepted or {}):
        options.pop("blur", None)
    images = where.table(heading, table, "images")
    for key in images:
        if key in options:
            raise where.error(f"{heading}.images", f"`{key}` is given in [renderer] as well")
        options[key] = _read_image(folder / where.text(f"{heading}.images", images, key), factory)
    for key, argument in (accepted or {}).items():
        given = options.get(key)
        if not _is_path(argument):
            continue
        if isinstance(given, str):
            options[key] = folder / where.text(heading, options, key)
        elif isinstance(given, dict):  # a table by name, such as of meshes
            inner = f"{heading}.{key}"
            paths = {
                name: folder / where.text(inner, given, name) for name, one in given.items() if isinstance(one, str)
            }
            options[key] = given | paths
    if accepted is not None and not any(one.kind is Parameter.VAR_KEYWORD for one in accepted.values()):
        where.known(heading, options, tuple(accepted))
    for key, size in (("height", target.shape[0]), ("width", target.shape[1])):
        if accepted is None or key not in accepted:
            continue
        if options.setdefault(key, size) != size:  # a renderer that has to be told its size gets the target's
            raise where.error(heading, f"`{key}` must be that of the target, {size}, got {shown(options[key])}")
    if samples is not None:
        options["spp"] = samples
    for key, argument in (accepted or {}).items():
        named = argument.kind in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
        if named and argument.default is Parameter.empty and key not in options:
            raise where.error(heading, f"`{key}` is missing; {name} needs it")
    try:
        renderer = factory(**options)
        usable = isinstance(renderer, Renderer)
    except BaseException as error:  # a third party may raise anything, SystemExit too
        if is_ctrl_c(error):
            raise
        said = str(error) if isinstance(error, LoiError) else f"{name} refused: {described(error)}"
        raise where.error(heading, said) from error
    if not usable:
        raise where.error(heading, f"{name} made a {type(renderer).__name__}, which is not a renderer")
    if blur is not None and "blur" not in (accepted or {}):
        renderer = _blurred(where, f"{heading}.blur", renderer, blur, moving)
    declared = (accepted or {}).get("spp")
    return renderer, whole_number(options.get("spp", declared.default if declared else None))


def _blurred(
    where: Where, heading: str, renderer: Renderer, table: Mapping[str, Any], moving: Iterable[str]
) -> Renderer:
    """A renderer whose gradients are those of its images blurred."""
    try:
        with wrap_errors("blurring"):
            names = [name for name in moving if name in renderer.parameters()]
            return BlurredRenderer(renderer, **{"names": names, **table})
    except LoiError as error:
        raise where.error(heading, str(error)) from error


def _read_image(path: Path, factory: RendererFactory) -> FloatImage:
    """Return an image option in the `image_encoding` of a renderer's class, or its stored values if it has none."""
    encoding = getattr(factory, "image_encoding", None)
    return read_image(path) if encoding is None else read_target(path, to=encoding, alpha="ignore").image


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
