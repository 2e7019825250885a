"""Which way an image is compared: by operations on whole arrays, or by compiled loops. It is decided here alone.

Arrays of any library can be compared by operations on whole arrays. On the processor, loops that Numba compiled are
several times faster; they take NumPy arrays, so images of other libraries that NumPy can read go there and back.
``LOI_COMPILED=0`` keeps everything to whole arrays.
"""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np

from loi_core.method.array_comparison import ArrayComparison
from loi_core.method.blurs import Blur, GaussianBlur, PlaneBlur
from loi_core.method.comparison import Comparison
from loi_core.method.compiled import compiles
from loi_core.method.plan import Plan
from loi_core.method.scales import ScaleSpace
from loi_core.support.arrays import Array, from_numpy, is_numpy_array, is_read_by_numpy, is_recorded, to_numpy

__all__ = ["BY_ARRAYS", "BY_LOOPS", "Way", "loops_take", "plane_blur", "way_for"]


class Way(Protocol):
    """Where images are compared, and by what."""

    def take(self, image: Array) -> Array:
        """`image` as an array of the library that does the work."""

    def give(self, result: Array, like: Array) -> Array:
        """What came of it, as an array of the library, dtype and device of the image."""

    def comparison(self, scales: ScaleSpace, plan: Plan, reference: Array, weights: Array | None = None) -> Comparison:
        """All that depends on the reference alone: planes within the bounds, and weights, shape (N, H, W)."""


class _ByArrays:
    """By operations on whole arrays, in the image's own library."""

    def take(self, image: Array) -> Array:
        return image

    def give(self, result: Array, like: Array) -> Array:  # noqa: ARG002  # it is like that already
        return result

    def comparison(self, scales: ScaleSpace, plan: Plan, reference: Array, weights: Array | None = None) -> Comparison:
        return ArrayComparison.of(scales, plan, reference, weights)


class _ByLoops:
    """By loops that Numba compiled, on NumPy arrays."""

    def take(self, image: Array) -> Array:
        return to_numpy(image)

    def give(self, result: Array, like: Array) -> Array:
        # In one piece, so that torch's `view` can reshape it.
        return result if is_numpy_array(like) else from_numpy(np.asarray(result, order="C"), like)

    def comparison(self, scales: ScaleSpace, plan: Plan, reference: Array, weights: Array | None = None) -> Comparison:
        from loi_core.method.compiled.loop_comparison import LoopComparison  # with Numba, which takes long to import

        return LoopComparison.of(scales, plan, reference, weights)


BY_ARRAYS: Final[Way] = _ByArrays()
BY_LOOPS: Final[Way] = _ByLoops()


def loops_take(dtype: str) -> bool:
    """Whether compiled loops compare arrays of a dtype: "float32" or "float64", where Numba can and may compile.

    The first time that a dtype is asked for, its loops are compiled, or loaded from a cache.
    """
    return dtype in ("float32", "float64") and compiles(dtype)


def plane_blur(blur: PlaneBlur, like: Array) -> Blur:
    """A blur of one plane, shape (H, W), that is an array like `like`: by loops wherever they can."""
    if is_numpy_array(like) and loops_take(str(like.dtype)):
        from loi_core.method.compiled.inner import LonePlaneBlur

        return LonePlaneBlur.of(blur, like.dtype)
    return GaussianBlur(blur, like)


def way_for(image: Array) -> Way:
    """The way to compare an image of any library: by loops wherever they can.

    They cannot read what lies on another device or is traced, and a framework cannot differentiate through them.
    """
    if is_read_by_numpy(image) and not is_recorded(image) and loops_take(str(image.dtype).removeprefix("torch.")):
        return BY_LOOPS
    return BY_ARRAYS
