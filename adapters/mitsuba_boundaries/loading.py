"""Parse scenes with Mitsuba, so that their nodes can be changed before its objects are made."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi

__all__ = ["file_search_path", "load_unmerged", "parsed_scene", "with_sampled_borders"]


def load_unmerged(scene: dict[str, Any] | str | Path, *, float_textures: bool = False) -> Any:
    """Load a scene without Mitsuba's own optimisations, which merge and reorder meshes.

    Parameters
    ----------
    scene : dict or path
    float_textures : bool
        Load 8-bit bitmaps as floats, which have a gradient.

    Raises
    ------
    RuntimeError
        If Mitsuba cannot load the scene.
    """
    with parsed_scene(scene, float_textures=float_textures) as (config, state):
        loaded = mi.parser.instantiate(config, state)
    return loaded[0] if isinstance(loaded, list) and len(loaded) == 1 else loaded


@contextmanager
def parsed_scene(scene: dict[str, Any] | str | Path, *, float_textures: bool = False) -> Iterator[tuple[Any, Any]]:
    """Parse a scene into the configuration and state that ``mi.parser.instantiate`` takes.

    Change and instantiate the state within the context, where the scene's files are found.
    """
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_equivalent = config.merge_meshes = False
    folders = [] if isinstance(scene, dict) else [Path(scene).parent]
    with file_search_path([Path(mi.__file__).parent, *folders], extend=True):
        if isinstance(scene, dict):
            state = mi.parser.parse_dict(config, _copied_description(scene))
        else:
            state = mi.parser.parse_file(config, str(scene))
        mi.parser.transform_all(config, state)
        for node in state.nodes if float_textures else ():
            if node.props.plugin_name() == "bitmap" and node.type == mi.ObjectType.Texture:
                node.props["format"] = "variant"
        yield config, state


@contextmanager
def file_search_path(folders: Iterable[Path], *, extend: bool = False) -> Iterator[None]:
    """Replace or `extend` Mitsuba's search path for files within the context."""
    previous = mi.file_resolver()
    resolver = mi.FileResolver(previous) if extend else mi.FileResolver()
    if not extend:
        resolver.clear()
    for folder in folders:
        resolver.append(str(folder))
    mi.set_file_resolver(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(previous)


def with_sampled_borders(scene: dict[str, Any]) -> dict[str, Any]:
    """Return a scene's dict whose films sample their borders, which boundary terms of shapes that cross it need.

    The film of a scene that is loaded cannot be changed.
    """
    return {key: _with_sampled_border(value) if isinstance(value, dict) else value for key, value in scene.items()}


def _with_sampled_border(sensor: dict[str, Any]) -> dict[str, Any]:
    return {
        key: {"sample_border": True, **value} if isinstance(value, dict) and "film" in str(value.get("type")) else value
        for key, value in sensor.items()
    }


def _copied_description(description: dict[str, Any]) -> dict[str, Any]:
    """Copy a scene's dict with its tensors, which Mitsuba empties when it loads them."""

    def copied(value: Any) -> Any:
        if isinstance(value, dict):
            return _copied_description(value)
        return type(value)(value) if dr.is_tensor_v(value) else value

    return {key: copied(value) for key, value in description.items()}
