"""Choice of the backend that compares an image: Numba's compiled loops, an adapter's, or the image's own array library.

Every array library can compare images through whole-array operations. On the CPU, loops compiled by Numba are several
times faster. They take NumPy arrays, so images of other libraries that NumPy can read are passed there and back.
Adapters may register faster backends for their library's other devices. ``LOI_COMPILED=0`` disables all of these.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

import numpy as np

from loi_core.method.array_comparison import ArrayComparison
from loi_core.method.comparison import Comparison
from loi_core.method.compiled import compiles
from loi_core.method.plan import Plan
from loi_core.method.scales import ScaleSpace
from loi_core.support.arrays import Array, from_numpy, is_numpy_array, is_read_by_numpy, is_recorded, to_numpy

__all__ = ["ARRAY_API", "NUMBA", "Backend", "OwnLibrary", "choose_backend", "numba_supports", "register_backend"]


class Backend(Protocol):
    """An implementation of the comparison, with the conversion of arrays to and from its library."""

    def to_backend(self, image: Array) -> Array:
        """Return `image` as an array of the library that computes."""

    def to_library(self, result: Array, like: Array) -> Array:
        """Return `result` as an array of the library, dtype and device of `like`."""

    def comparison(self, scales: ScaleSpace, plan: Plan, reference: Array, weights: Array | None = None) -> Comparison:
        """Prepare a comparison with a reference: planes within the bounds, and weights, shape (N, H, W)."""


class OwnLibrary:
    """Base of backends that compute in the image's own library, so that nothing is converted."""

    def to_backend(self, image: Array) -> Array:
        """See :class:`Backend`."""
        return image

    def to_library(self, result: Array, like: Array) -> Array:  # noqa: ARG002  # it is like that already
        """See :class:`Backend`."""
        return result


class _ArrayApi(OwnLibrary):
    """Operations on whole arrays."""

    def comparison(self, scales: ScaleSpace, plan: Plan, reference: Array, weights: Array | None = None) -> Comparison:
        return ArrayComparison.of(scales, plan, reference, weights)


class _Numba:
    """Loops compiled by Numba, on NumPy arrays."""

    def to_backend(self, image: Array) -> Array:
        return to_numpy(image)

    def to_library(self, result: Array, like: Array) -> Array:
        # C-contiguous, so that torch's `view` can reshape it.
        return result if is_numpy_array(like) else from_numpy(np.asarray(result, order="C"), like)

    def comparison(self, scales: ScaleSpace, plan: Plan, reference: Array, weights: Array | None = None) -> Comparison:
        from loi_core.method.compiled.loop_comparison import LoopComparison  # imports Numba, which is slow

        return LoopComparison.of(scales, plan, reference, weights)


ARRAY_API: Final[Backend] = _ArrayApi()
NUMBA: Final[Backend] = _Numba()
_REGISTERED: Final[list[tuple[Callable[[Array], bool], Backend]]] = []


def register_backend(supports: Callable[[Array], bool], backend: Backend) -> None:
    """Compare by `backend` the images for which `supports` returns True, if Numba cannot read them."""
    _REGISTERED.append((supports, backend))


def numba_supports(dtype: str) -> bool:
    """Return whether Numba can and may compile the loops for a dtype, which must be "float32" or "float64".

    The first call for a dtype compiles its loops, or loads them from a cache.
    """
    return dtype in ("float32", "float64") and compiles(dtype)


def choose_backend(image: Array) -> Backend:
    """Return `NUMBA` wherever it can compare `image`, else a registered backend that supports it, else `ARRAY_API`.

    Numba cannot read arrays on another device or traced arrays, and no framework can differentiate through its loops.
    """
    if is_read_by_numpy(image) and not is_recorded(image) and numba_supports(str(image.dtype).removeprefix("torch.")):
        return NUMBA
    return next((backend for supports, backend in _REGISTERED if supports(image)), ARRAY_API)
