"""Names of a scene's objects that are readable, and the same in every process.

``mi.traverse`` names an object without an id after its address or its number, as ``object_12``.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from typing import Any, Final, TypeAlias

import mitsuba as mi
import numpy as np

from mitsuba_boundaries.geometry.bounds import bounding_box

__all__ = ["ancestors", "is_merged", "readable_names"]

SceneParameters: TypeAlias = Any

ZERO_TOLERANCE: Final = 1e-5  # coordinates below it are rounding errors, and 0 in a name
_ADDRESS = re.compile(r"object_\d+(_\d+)?")
_WORD_BOUNDARY = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


def readable_names(params: SceneParameters, *, in_order: bool) -> tuple[dict[str, str], dict[str, str]]:
    """Return readable names of all objects by key, and positional names of meshes without an id.

    The order of meshes that Mitsuba may have merged or moved is not the file's, so they are not numbered.
    """
    names: dict[str, str] = {}
    counts: defaultdict[str, int] = defaultdict(int)
    reserved = {word for key in params.properties for word in key.split(".")}
    positional = _positional_names(params)
    unordered = set() if in_order else _unordered_meshes(params, positional)
    for key in params.properties:
        words = key.split(".")[:-1]
        nodes = ancestors(params, params.properties[key][2])
        for depth in range(1, len(words) + 1):
            path, parent = ".".join(words[:depth]), names.get(".".join(words[: depth - 1]), "")
            if path in names:
                continue
            word = words[depth - 1]
            node = nodes[depth] if len(nodes) == len(words) + 1 else None
            if path in unordered:
                word = positional[path]
            elif node is not None and not node.id() and _ADDRESS.fullmatch(word):
                class_name = _snake_case_class(node)
                while (word := f"{class_name}_{counts[class_name]}") in reserved:
                    counts[class_name] += 1
                counts[class_name] += 1
            names[path] = f"{parent}.{word}" if parent else word
    return names, positional


def _positional_names(params: SceneParameters) -> dict[str, str]:
    """Return a name with the position of each mesh without an id, and with its size where positions coincide."""
    names: dict[str, str] = {}
    sizes: dict[str, str] = {}
    for key in params.properties:
        folder, _, entry = key.rpartition(".")
        node = params.properties[key][2]
        if entry in ("vertex_positions", "to_world") and isinstance(node, mi.Mesh) and not node.id():
            if is_merged(node):
                names[folder] = "merged_meshes"
                continue
            names[folder] = f"{_snake_case_class(node)}_at_{_joined(bounding_box(node).mean(axis=0))}"
            sizes[folder] = f"_size_{_joined(np.ptp(bounding_box(node), axis=0))}"
    listed = list(names.values())
    names = {key: name + sizes.get(key, "") if listed.count(name) > 1 else name for key, name in names.items()}
    listed = list(names.values())
    numbers = {name: iter(range(len(listed))) for name in listed}
    # Meshes of one size in one position cannot be distinguished, so their numbers are arbitrary.
    return {key: f"{name}_{next(numbers[name])}" if listed.count(name) > 1 else name for key, name in names.items()}


def _joined(coordinates: Any) -> str:
    return "_".join(f"{value:.5g}" for value in np.where(np.abs(coordinates) < ZERO_TOLERANCE, 0.0, coordinates))


def _unordered_meshes(params: SceneParameters, positional: Mapping[str, str]) -> set[str]:
    """Return the meshes that may be out of order: without merged meshes, a mesh that is alone of its kind is not."""
    nodes = {params.properties[key][2]: key.rpartition(".")[0] for key in params.properties}
    meshes = {folder: node for node, folder in nodes.items() if folder in positional}
    classes = [_snake_case_class(node) for node in meshes.values()]
    merged = any(map(is_merged, meshes.values()))
    return {folder for folder, node in meshes.items() if merged or classes.count(_snake_case_class(node)) > 1}


def _snake_case_class(node: Any) -> str:
    return _WORD_BOUNDARY.sub("_", node.class_name()).lower()


def is_merged(node: Any) -> bool:
    """Return whether Mitsuba has merged several meshes into this one; it then joins their names."""
    if not isinstance(node, mi.Mesh) or node.class_name() != "Mesh" or node.id():
        return False
    return " + " in str(node).partition("bbox")[0]


def ancestors(params: SceneParameters, node: Any) -> list[Any]:
    """Return the objects from the scene down to `node`."""
    chain = []
    while node is not None:
        chain.append(node)
        node = params.hierarchy[node][0]
    return chain[::-1]
