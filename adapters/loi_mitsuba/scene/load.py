"""Load scenes, and check the arguments that every renderer of a scene takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import mitsuba as mi

from loi_core.errors import LoiError, OptionError, ParameterError
from loi_core.renderers.poses import ParameterTarget, Rotate, parse_targets
from loi_core.support.values import whole_number
from loi_core.support.wording import printable, shown
from mitsuba_boundaries.loading import load_unmerged
from mitsuba_boundaries.scene_checks import UnsafeSceneError, check_scene

__all__ = [
    "LoadedScene",
    "ParameterTarget",
    "SceneLoadError",
    "checked_samples",
    "checked_targets",
    "find_sensor",
    "load_scene",
    "one_line",
    "use_variant",
]

VARIANTS: Final = ("cuda_ad_rgb", "llvm_ad_rgb")
MAX_MESSAGE_LENGTH: Final = 1000


class SceneLoadError(LoiError, ValueError):
    """A scene that Mitsuba cannot load, or that names a plugin which is not Mitsuba's own."""


def use_variant() -> str:
    """Return Mitsuba's variant, after setting a differentiable one if none is set.

    Raises
    ------
    OptionError
        If the variant that is set has no gradients.
    """
    if mi.variant() is None:
        mi.set_variant(*VARIANTS)
    variant = str(mi.variant())
    if "_ad_" not in variant:
        msg = f"Mitsuba's variant {variant!r} has no gradients; call mi.set_variant('llvm_ad_rgb')"
        raise OptionError(msg)
    return variant


@dataclass(frozen=True)
class LoadedScene:
    """A scene and the way it was loaded.

    Attributes
    ----------
    scene : mi.Scene
    in_order : bool
        Whether the shapes are in the order of the file. With its own optimisations on, Mitsuba merges some meshes and
        moves the others behind all other shapes.
    float_textures : bool
        Whether 8-bit textures were loaded as floats, which have a gradient.
    """

    scene: Any
    in_order: bool
    float_textures: bool = False


def load_scene(scene: Any, *, float_textures: bool = False) -> LoadedScene:
    """Load a dict or an XML file, or wrap a scene that is loaded already.

    Mitsuba's optimisations are off: a parameter of merged objects would change all of them. With `float_textures`,
    8-bit textures are loaded as floats.

    Raises
    ------
    SceneLoadError
        If the scene cannot be loaded.
    OptionError
        If `scene` is of another type.
    """
    if isinstance(scene, LoadedScene):
        return scene
    if isinstance(scene, mi.Scene):
        return LoadedScene(scene, in_order=False)
    loaded = scene
    if isinstance(scene, dict | str | Path):
        try:
            check_scene(scene if isinstance(scene, dict) else Path(scene))
            loaded = load_unmerged(scene, float_textures=float_textures)
        except (RuntimeError, UnsafeSceneError) as error:
            msg = f"`scene` cannot be loaded: {one_line(error)}"
            raise SceneLoadError(msg) from None
    if not isinstance(loaded, mi.Scene):
        msg = f"`scene` must be a dict, the path of an XML file, or an mi.Scene, got a {type(loaded).__name__}"
        raise OptionError(msg)
    return LoadedScene(loaded, in_order=True, float_textures=float_textures)


def checked_targets(parameters: object) -> dict[str, ParameterTarget]:
    """Return the target of each parameter, with handles in place of a scene file's tables."""
    targets = parse_targets(parameters)
    for name, target in targets.items():
        if isinstance(target, Rotate) and target.axis is None:
            msg = f"`parameters[{name!r}]`: Rotate needs `axis` in Mitsuba; several Rotates turn a shape freely"
            raise ParameterError(msg)
    return targets


def find_sensor(scene: Any, index: int) -> Any:
    """Return the scene's sensor with that index."""
    sensors = scene.sensors()
    if not sensors:
        msg = "`scene` has no sensor"
        raise OptionError(msg)
    number = whole_number(index)
    if number is None or not 0 <= number < len(sensors):
        msg = f"`sensor` must be the number of one of the scene's {len(sensors)} sensors, from 0, got {shown(index)}"
        raise OptionError(msg)
    return sensors[number]


def one_line(error: Exception) -> str:
    """Return Mitsuba's message in one line, without the traceback of plugins written in Python."""
    message, _, trace = str(error).strip().partition("Traceback (most recent call last):")
    return printable(" ".join([message, *trace.splitlines()[-1:]]))[:MAX_MESSAGE_LENGTH]


def checked_samples(name: str, value: object, largest: int) -> int:
    """Return `value` as a number of samples per pixel, 1 to `largest`."""
    samples = whole_number(value)
    if samples is None or not 1 <= samples <= largest:
        msg = f"`{name}` must be a whole number of samples from 1 to {largest} for this film, got {shown(value)}"
        raise OptionError(msg)
    return samples
