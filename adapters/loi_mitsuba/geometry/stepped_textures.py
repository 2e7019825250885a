"""Textures with steps, which have no gradient where they move, and interpolated ones that stand for them.

Mitsuba differentiates what a texture looks like between its steps, and not that these move. A ramp in place of a step
has a gradient, which is that of the step for all that changes little over the ramp.
"""

from __future__ import annotations

from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = ["RAMP", "has_stepped_texture", "is_stepped_texture", "ramp_texture"]

FINE: Final = 4  # texels along each side of what is of one colour: the ramp is one of them wide
RAMP: Final = f"with ramps 1/{FINE} as wide as a check or texel, for steps that move have no gradient"
LARGEST: Final = 4096  # texels along a side
PLACES: Final = 4096
CLOSE: Final = 1e-3  # texels, between two places of one texel
STEADY: Final = 0.9  # of pairs of places so close, where the next texel differs, that are equal if nothing interpolates
COLOURS: Final = {"color0": 0.4, "color1": 0.2}  # of a checkerboard that is not told


def has_stepped_texture(shape: Any) -> bool:
    """Whether a texture of a shape has steps, which move with it."""
    nodes = {one[2] for one in mi.traverse(shape).properties.values()}
    return any(is_stepped_texture(one) for one in nodes)


def is_stepped_texture(node: Any) -> bool:
    """Whether an object of a scene is a texture with steps: a checkerboard, or a bitmap that is not interpolated."""
    if not isinstance(node, mi.Texture):
        return False
    kind = node.class_name()
    if kind == "Checkerboard":
        return True
    if not kind.startswith("BitmapTexture") or not mi.is_rgb:
        return False
    params = mi.traverse(node)
    height, width, channels = params["data"].shape
    turned = np.array(params["to_uv"].matrix, dtype=np.float64).reshape(3, 3)[:2, :2]
    texel = np.linalg.pinv(turned) @ np.array([1.0 / width, 1.0 / height])
    first = np.random.default_rng(0).random((PLACES, 2))
    point = dr.zeros(mi.SurfaceInteraction3f, 3 * PLACES)
    point.uv = mi.Point2f(np.concatenate([first, first + CLOSE * texel, first + texel]).astype(np.float32).T)
    seen = np.array(node.eval_1(point) if channels == 1 else node.eval(point)).reshape(-1, 3, PLACES)
    differs = np.any(seen[:, 0] != seen[:, 2], axis=0)
    equal = np.all(seen[:, 0] == seen[:, 1], axis=0)
    return bool(np.any(differs) and np.mean(equal[differs]) > STEADY)


def ramp_texture(props: Any) -> bool:
    """Make an interpolated bitmap of the properties of a texture with steps; False if they have none, or cannot be."""
    kind = props.plugin_name()
    if kind == "checkerboard":
        return _interpolate_checks(props)
    if kind == "bitmap" and props.get("filter_type", "bilinear") == "nearest":
        _interpolate_texels(props)
        return True
    return False


def _interpolate_checks(props: Any) -> bool:
    colours = [props.get(name, usual) for name, usual in COLOURS.items()]
    if not all(isinstance(one, int | float | mi.ScalarColor3d) for one in colours):
        return False  # they are textures themselves
    first, second = (np.broadcast_to(np.array(one, dtype=np.float32), 3) for one in colours)
    if min(first.min(), second.min()) < 0.0 or max(first.max(), second.max()) > 1.0:
        return False  # which a bitmap would not hold
    half = np.arange(2 * FINE) >= FINE
    checks = np.where((half[:, None] == half)[..., None], first, second)
    for name in set(props.keys()) & set(COLOURS):
        del props[name]
    props.set_plugin_name("bitmap")
    props["bitmap"] = mi.Bitmap(np.ascontiguousarray(checks))
    return True


def _interpolate_texels(props: Any) -> None:
    props["filter_type"] = "bilinear"
    if "data" in props:
        image = mi.Bitmap(np.array(props["data"], dtype=np.float32))
        del props["data"]
    elif "bitmap" in props:
        image = props["bitmap"]
    else:
        image = mi.Bitmap(str(mi.file_resolver().resolve(str(props["filename"]))))
        del props["filename"]
    finer = mi.Bitmap(_finer(np.array(image)), image.pixel_format())
    finer.set_srgb_gamma(image.srgb_gamma())
    finer.set_premultiplied_alpha(image.premultiplied_alpha())
    props["bitmap"] = finer


def _finer(image: Any) -> Any:
    """Every texel several times, along both axes."""
    times = max(1, min(FINE, LARGEST // max(image.shape[:2])))
    return np.ascontiguousarray(image.repeat(times, axis=0).repeat(times, axis=1))
