"""Construction of the renderer that a table of a scene file names."""

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
from loi_core.scenes.tables import TableReader
from loi_core.scenes.target import read_target
from loi_core.support.guards import is_ctrl_c, wrap_errors
from loi_core.support.values import whole_number
from loi_core.support.wording import described, shown

__all__ = ["make_renderer"]


def make_renderer(
    reader: TableReader,
    heading: str,
    table: Mapping[str, Any],
    target: FloatImage,
    *,
    samples: int | None,
    optimised: Iterable[str],
) -> tuple[Renderer, int | None]:
    """Return the renderer of a view, and its samples per pixel; None without that option.

    A table `blur` goes to a renderer that takes it. Any other renderer is wrapped in a :class:`BlurredRenderer`, which
    blurs the `optimised` parameters by default.
    """
    if "name" not in table:
        raise reader.error(heading, "`name` is missing")
    name = reader.text(heading, table, "name")
    factory = load_renderer(name)
    arguments = _arguments(factory)
    declared = arguments or {}
    blur = reader.table(heading, table, "blur") if "blur" in table else None
    reader.check_keys(f"{heading}.blur", blur or {}, BLUR_KEYS)
    options = _options(reader, heading, table, declared, factory)
    if arguments is not None and not any(argument.kind is Parameter.VAR_KEYWORD for argument in arguments.values()):
        reader.check_keys(heading, options, tuple(arguments))
    for key, size in (("height", target.shape[0]), ("width", target.shape[1])):
        if key in declared and options.setdefault(key, size) != size:
            raise reader.error(heading, f"`{key}` must be that of the target, {size}, got {shown(options[key])}")
    if samples is not None:
        options["spp"] = samples
    for key, argument in declared.items():
        by_keyword = argument.kind in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
        if by_keyword and argument.default is Parameter.empty and key not in options:
            raise reader.error(heading, f"`{key}` is missing; {name} needs it")
    renderer = _call_factory(reader, heading, name, factory, options)
    if blur is not None and "blur" not in declared:
        renderer = _blurred(reader, f"{heading}.blur", renderer, blur, optimised)
    default = declared["spp"].default if "spp" in declared else None
    return renderer, whole_number(options.get("spp", default))


def _options(
    reader: TableReader,
    heading: str,
    table: Mapping[str, Any],
    declared: Mapping[str, Parameter],
    factory: RendererFactory,
) -> dict[str, Any]:
    """Return the arguments of a factory from its table, with images read and paths relative to the scene file."""
    folder = reader.path.parent
    options = {key: value for key, value in table.items() if key not in ("name", "images")}
    if "blur" not in declared:
        options.pop("blur", None)
    images = reader.table(heading, table, "images")
    for key in images:
        if key in options:
            raise reader.error(f"{heading}.images", f"`{key}` is given in [renderer] as well")
        options[key] = _read_image(folder / reader.text(f"{heading}.images", images, key), factory)
    for key, argument in declared.items():
        value = options.get(key)
        if not _is_path(argument):
            continue
        if isinstance(value, str):
            options[key] = folder / reader.text(heading, options, key)
        elif isinstance(value, dict):  # a table of named paths, such as meshes
            names = [name for name, path in value.items() if isinstance(path, str)]
            options[key] = value | {name: folder / reader.text(f"{heading}.{key}", value, name) for name in names}
    return options


def _call_factory(
    reader: TableReader, heading: str, name: str, factory: RendererFactory, options: Mapping[str, Any]
) -> Renderer:
    try:
        renderer = factory(**options)
        usable = isinstance(renderer, Renderer)
    except BaseException as error:  # a third party may raise anything, SystemExit too
        if is_ctrl_c(error):
            raise
        message = str(error) if isinstance(error, LoiError) else f"{name} refused: {described(error)}"
        raise reader.error(heading, message) from error
    if not usable:
        raise reader.error(heading, f"{name} made a {type(renderer).__name__}, which is not a renderer")
    return renderer


def _blurred(
    reader: TableReader, heading: str, renderer: Renderer, table: Mapping[str, Any], optimised: Iterable[str]
) -> Renderer:
    try:
        with wrap_errors("blurring"):
            names = [name for name in optimised if name in renderer.parameters()]
            return BlurredRenderer(renderer, **{"names": names, **table})
    except LoiError as error:
        raise reader.error(heading, str(error)) from error


def _read_image(path: Path, factory: RendererFactory) -> FloatImage:
    """Return an image option in the `image_encoding` of a renderer's class, or its stored values without one."""
    encoding = getattr(factory, "image_encoding", None)
    return read_image(path) if encoding is None else read_target(path, to=encoding, alpha="ignore").image


def _arguments(factory: RendererFactory) -> Mapping[str, Parameter] | None:
    """Return the declared arguments of a factory; None for compiled factories without a signature."""
    try:
        return signature(factory).parameters
    except Exception:  # a third party may declare anything
        return None


def _is_path(argument: Parameter) -> bool:
    """Return whether an argument is annotated as a path, or as a type that allows one."""
    # The annotation is compared as text: it often is a string, which may name types imported for type checking only.
    try:
        annotation = formatannotation(argument.annotation)
    except Exception:  # a third party may annotate with anything
        return False
    return re.search(r"\bPath\b", annotation) is not None
