"""What happens to pixels that are NaN or infinite."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from loi_core.arrays import Array, namespace, to_numpy
from loi_core.errors import NonFiniteImageError, OptionError
from loi_core.messages import shown

__all__ = ["NanPolicy", "check_nan_policy", "count_non_finite", "require_finite"]

NanPolicy = Literal["raise", "mask"]


def check_nan_policy(policy: object) -> NanPolicy:
    """`policy` itself, once it is known to be allowed."""
    for allowed in get_args(NanPolicy):
        if isinstance(policy, str) and policy == allowed:
            return allowed  # type: ignore[no-any-return]  # get_args is untyped; it yields the literals above
    msg = f"`nan_policy` must be one of {', '.join(map(repr, get_args(NanPolicy)))}, got {shown(policy)}"
    raise OptionError(msg)


def count_non_finite(array: Array) -> int:
    """How many values of `array` are NaN or infinite."""
    xp = namespace(array)
    return int(xp.sum(xp.astype(~xp.isfinite(array), xp.int32)))  # JAX has no int64 unless asked


def require_finite(name: str, image: Array) -> None:
    """Raise :class:`NonFiniteImageError` if `image` holds NaN or infinite values."""
    xp = namespace(image)
    if bool(xp.all(xp.isfinite(image))):
        return
    bad = ~np.isfinite(to_numpy(image))
    first = tuple(int(index) for index in np.unravel_index(int(np.argmax(bad)), bad.shape))
    raise NonFiniteImageError(name, int(bad.sum()), first, int(bad.size))
