"""What a renderer is made from: the variant, the scene, the targets, the sensor and the samples, each checked."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import drjit as dr
import mitsuba as mi

from loi_core.errors import OptionError, ParameterError
from loi_core.renderers.handles import Rotate, Target, targets_of
from loi_core.support.values import whole_number
from loi_core.support.wording import shown
from loi_mitsuba.scene.safety import SceneLoadError, check_scene_file, check_types, looking_in

__all__ = [
    "LoadedScene",
    "SceneLoadError",
    "Target",
    "checked_samples",
    "checked_targets",
    "find_sensor",
    "fresh",
    "load_scene",
    "load_with_floats",
    "most_samples",
    "one_line",
    "parsed",
    "use_variant",
]

"""What a parameter stands for: an entry of the scene by name, or a handle on a shape."""

VARIANTS: Final = ("cuda_ad_rgb", "llvm_ad_rgb")
MOST_SAMPLES: Final = 2**32 - 1  # in one image; Mitsuba counts them in 32 bits


def use_variant() -> str:
    """The variant in use, once there is one that has gradients."""
    if mi.variant() is None:
        mi.set_variant(*VARIANTS)
    variant = str(mi.variant())
    if "_ad_" not in variant:
        msg = f"Mitsuba's variant {variant!r} has no gradients; call mi.set_variant('llvm_ad_rgb')"
        raise OptionError(msg)
    return variant


@dataclass(frozen=True)
class LoadedScene:
    """A scene, and how it was loaded.

    Attributes
    ----------
    scene : mi.Scene
    in_order : bool
        Whether its shapes are known to come in the file's own order. Mitsuba, asked to optimise a scene as it loads it,
        merges some meshes and moves the others behind all other shapes.
    floats : bool
        Whether textures of 8 bits were loaded as floats, which have a gradient.
    """

    scene: Any
    in_order: bool
    floats: bool = False


def load_scene(scene: Any) -> LoadedScene:
    """The scene that a dict, a path or a scene stands for."""
    # Merging equal objects, as Mitsuba does by itself, would make one parameter change several of them.
    if isinstance(scene, LoadedScene):
        return scene
    if isinstance(scene, mi.Scene):
        return LoadedScene(scene, in_order=False)
    try:
        if isinstance(scene, dict):
            check_types(scene)
            loaded = mi.load_dict(fresh(scene), optimize=False)
        elif isinstance(scene, str | Path):
            check_scene_file(Path(scene))
            loaded = mi.load_file(str(scene), optimize=False)
        else:
            loaded = scene
    except RuntimeError as error:
        msg = f"`scene` cannot be loaded: {one_line(error)}"
        raise SceneLoadError(msg) from None
    if not isinstance(loaded, mi.Scene):
        msg = f"`scene` must be a dict, the path of an XML file, or an mi.Scene, got a {type(loaded).__name__}"
        raise OptionError(msg)
    return LoadedScene(loaded, in_order=True)


def load_with_floats(scene: dict[str, Any] | str | Path) -> LoadedScene:
    """A scene whose textures hold floats, whatever their files hold; it has been loaded before, so that it is sound."""
    with parsed(scene, floats=True) as (config, state):
        loaded = mi.parser.instantiate(config, state)
    return LoadedScene(loaded[0] if isinstance(loaded, list) else loaded, in_order=True, floats=True)


@contextlib.contextmanager
def parsed(scene: dict[str, Any] | str | Path, *, floats: bool) -> Iterator[tuple[Any, Any]]:
    """What a scene is made from, to be changed and instantiated within; with `floats`, textures hold floats.

    Raises
    ------
    SceneLoadError
        If Mitsuba cannot, or something within fails in Mitsuba.
    """
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_equivalent = config.merge_meshes = False
    folders = [] if isinstance(scene, dict) else [Path(scene).parent]
    with looking_in([Path(mi.__file__).parent, *folders], also=True):
        try:
            if isinstance(scene, dict):
                state = mi.parser.parse_dict(config, fresh(scene))
            else:
                state = mi.parser.parse_file(config, str(scene))
            mi.parser.transform_all(config, state)
            for node in state.nodes if floats else ():
                if node.props.plugin_name() == "bitmap" and node.type == mi.ObjectType.Texture:
                    node.props["format"] = "variant"
            yield config, state
        except RuntimeError as error:
            msg = f"`scene` cannot be loaded: {one_line(error)}"
            raise SceneLoadError(msg) from None


def fresh(description: dict[str, Any]) -> dict[str, Any]:
    """A dict to load a scene from, again and again: Mitsuba empties the tensors in the one that it is given."""

    def own(value: Any) -> Any:
        if isinstance(value, dict):
            return fresh(value)
        return type(value)(value) if dr.is_tensor_v(value) else value

    return {key: own(value) for key, value in description.items()}


def checked_targets(parameters: object) -> dict[str, Target]:
    """Targets by parameter; tables of scene files become handles."""
    targets = targets_of(parameters)
    for name, target in targets.items():
        if isinstance(target, Rotate) and target.axis is None:
            msg = f"`parameters[{name!r}]`: Rotate needs `axis` in Mitsuba; several turn a shape freely"
            raise ParameterError(msg)
    return targets


def find_sensor(scene: Any, index: int) -> Any:
    """The sensor of that number."""
    sensors = scene.sensors()
    if not sensors:
        msg = "`scene` has no sensor"
        raise OptionError(msg)
    number = whole_number(index)
    if number is None or not 0 <= number < len(sensors):
        msg = f"`sensor` must be the number of one of the scene's {len(sensors)} sensors, from 0, got {shown(index)}"
        raise OptionError(msg)
    return sensors[number]


def most_samples(film: Any) -> int:
    """The most samples per pixel that one image may have, with the border if the film samples there."""
    border = 2 * film.rfilter().border_size() if film.sample_border() else 0
    width, height = film.crop_size()
    return MOST_SAMPLES // int((width + border) * (height + border))


def one_line(error: Exception) -> str:
    """What Mitsuba says, without the trace of the Python in which some of its plugins are written."""
    said, _, trace = str(error).strip().partition("Traceback (most recent call last):")
    return " ".join([*said.split(), *" ".join(trace.splitlines()[-1:]).split()])


def checked_samples(name: str, value: object, most: int) -> int:
    """`value`, once it is known to be a number of samples."""
    samples = whole_number(value)
    if samples is None or not 1 <= samples <= most:
        msg = f"`{name}` must be a whole number of samples from 1 to {most} for this film, got {shown(value)}"
        raise OptionError(msg)
    return samples
