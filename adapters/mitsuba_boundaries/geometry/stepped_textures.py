"""Textures with discontinuities, and their ramped stand-ins.

Mitsuba differentiates texture values but not the motion of discontinuities in the texture. A ramp in place of a step
has a gradient, which equals the step's for everything that varies slowly over the width of the ramp.
"""

from __future__ import annotations

from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = ["RAMP", "has_stepped_texture", "is_stepped_texture", "ramp_texture"]

SUBDIVISION: Final = 4  # texels along each side of a check or original texel; the ramp is one of them wide
RAMP: Final = f"with ramps 1/{SUBDIVISION} as wide as a check or texel, because moving steps have no gradient"
MAX_SIDE: Final = 4096  # texels along a side
PROBES: Final = 4096  # random texture coordinates
PROBE_OFFSET: Final = 1e-3  # texels between two lookups in one texel
MIN_EQUAL_FRACTION: Final = 0.9  # of such pairs, next to a different texel, are equal unless the texture interpolates
DEFAULT_COLOURS: Final = {"color0": 0.4, "color1": 0.2}  # of Mitsuba's checkerboard


def has_stepped_texture(shape: Any) -> bool:
    """Return whether a shape has a texture with discontinuities, which move with the shape."""
    return any(is_stepped_texture(node) for node in {entry[2] for entry in mi.traverse(shape).properties.values()})


def is_stepped_texture(node: Any) -> bool:
    """Return whether an object of a scene is a checkerboard, or a bitmap without interpolation.

    A loaded bitmap does not expose its filter, so pairs of nearby lookups are compared.
    """
    if not isinstance(node, mi.Texture):
        return False
    type_name = node.class_name()
    if type_name == "Checkerboard":
        return True
    if not type_name.startswith("BitmapTexture") or not mi.is_rgb:
        return False
    params = mi.traverse(node)
    height, width, channels = params["data"].shape
    to_uv = np.array(params["to_uv"].matrix, dtype=np.float64).reshape(3, 3)[:2, :2]
    texel = np.linalg.pinv(to_uv) @ np.array([1.0 / width, 1.0 / height])
    uv = np.random.default_rng(0).random((PROBES, 2))
    point = dr.zeros(mi.SurfaceInteraction3f, 3 * PROBES)
    point.uv = mi.Point2f(np.concatenate([uv, uv + PROBE_OFFSET * texel, uv + texel]).astype(np.float32).T)
    value = np.array(node.eval_1(point) if channels == 1 else node.eval(point)).reshape(-1, 3, PROBES)
    next_differs = np.any(value[:, 0] != value[:, 2], axis=0)
    is_equal = np.all(value[:, 0] == value[:, 1], axis=0)
    return bool(np.any(next_differs) and np.mean(is_equal[next_differs]) > MIN_EQUAL_FRACTION)


def ramp_texture(props: Any) -> bool:
    """Replace the steps of a parsed texture by ramps.

    Parameters
    ----------
    props : mi.Properties
        Of a texture; changed in place to an interpolated bitmap.

    Returns
    -------
    bool
        False if the texture has no steps, or cannot be replaced.
    """
    type_name = props.plugin_name()
    if type_name == "checkerboard":
        return _ramp_checkerboard(props)
    if type_name == "bitmap" and props.get("filter_type", "bilinear") == "nearest":
        _ramp_bitmap(props)
        return True
    return False


def _ramp_checkerboard(props: Any) -> bool:
    colours = [props.get(name, default) for name, default in DEFAULT_COLOURS.items()]
    if not all(isinstance(colour, int | float | mi.ScalarColor3d) for colour in colours):
        return False  # nested textures
    first, second = (np.broadcast_to(np.array(colour, dtype=np.float32), 3) for colour in colours)
    if min(first.min(), second.min()) < 0.0 or max(first.max(), second.max()) > 1.0:
        return False  # outside the range of a reflectance bitmap
    is_second_half = np.arange(2 * SUBDIVISION) >= SUBDIVISION
    checks = np.where((is_second_half[:, None] == is_second_half)[..., None], first, second)
    for name in set(props.keys()) & set(DEFAULT_COLOURS):
        del props[name]
    props.set_plugin_name("bitmap")
    props["bitmap"] = mi.Bitmap(np.ascontiguousarray(checks))
    return True


def _ramp_bitmap(props: Any) -> None:
    """Replace a bitmap without interpolation by a finer, interpolated one."""
    props["filter_type"] = "bilinear"
    if "data" in props:
        image = mi.Bitmap(np.array(props["data"], dtype=np.float32))
        del props["data"]
    elif "bitmap" in props:
        image = props["bitmap"]
    else:
        image = mi.Bitmap(str(mi.file_resolver().resolve(str(props["filename"]))))
        del props["filename"]
    texels = np.array(image)
    factor = max(1, min(SUBDIVISION, MAX_SIDE // max(texels.shape[:2])))
    finer = mi.Bitmap(np.ascontiguousarray(texels.repeat(factor, axis=0).repeat(factor, axis=1)), image.pixel_format())
    finer.set_srgb_gamma(image.srgb_gamma())
    finer.set_premultiplied_alpha(image.premultiplied_alpha())
    props["bitmap"] = finer
