"""Strategies of hypothesis for several modules, and bounds of differences."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st

from loi_core import ScaleSpace
from loi_core.stability import allowed
from tests.helpers import Host

__all__ = ["FEWER_EXAMPLES", "SEEDS", "THOROUGH", "Problem", "max_differences", "problems", "thorough"]

THOROUGH: Final = os.environ.get("HYPOTHESIS_PROFILE") == "thorough"
"""Whether the thorough tier runs, which takes an hour."""

thorough: Final = pytest.mark.skipif(not THOROUGH, reason="takes long; in the thorough tier")
"""Marks tests that shorter tests mostly cover."""

FEWER_EXAMPLES: Final = settings(max_examples=max(1, settings().max_examples // 8))
"""An eighth of the examples, for slow ones, such as a compilation by JAX for each shape."""

Problem: TypeAlias = tuple[Host, Host, ScaleSpace, str]
"""Image, reference, scales and dtype."""

SEEDS: Final = st.integers(0, 2**31)
"""Seeds of random generators."""

CONTENT_KINDS: Final = ("flat", "ramp", "step", "noise", "hdr", "saturated")


@st.composite
def contents(draw: st.DrawFn, shape: tuple[int, ...]) -> Host:
    """Draw an image of a kind that renderers produce."""
    content = draw(st.sampled_from(CONTENT_KINDS))
    rng = np.random.default_rng(draw(SEEDS))
    rows, columns = np.linspace(0, 1, shape[-3])[:, None, None], np.linspace(0, 1, shape[-2])[None, :, None]
    makers: dict[str, Callable[[], Host]] = {
        "flat": lambda: np.full(shape, rng.uniform()),
        "ramp": lambda: np.broadcast_to(0.7 * rows * rng.uniform() + 0.3 * columns, shape),
        "step": lambda: np.broadcast_to(np.where(columns > rng.uniform(), 0.8, 0.1) + 0.0 * rows, shape),
        "noise": lambda: rng.uniform(size=shape),
        "hdr": lambda: rng.exponential(size=shape) * 10.0 ** rng.integers(-2, 5),
        "saturated": lambda: rng.integers(0, 2, size=shape),
    }
    return np.array(makers[content](), dtype=np.float64)


@st.composite
def problems(draw: st.DrawFn) -> Problem:
    """Draw two images of one shape, scales, and a dtype."""
    batch = draw(st.sampled_from([(), (), (1,), (2,), (2, 1)]))
    size = st.integers(1, 14)
    shape = (*batch, draw(size), draw(size), draw(st.integers(1, 4)))
    scale = st.sampled_from([0.0, 0.3, 1.0, 2.5, 5.0, 15.0, 100.0])
    scale_lists = st.lists(scale, min_size=1, max_size=3, unique=True)
    presets = [ScaleSpace.paper("vector"), ScaleSpace.paper("path"), ScaleSpace.for_image(*shape[-3:-1])]
    scales = draw(
        st.one_of(
            st.sampled_from([*presets, ScaleSpace.released((1, 5), (1, 5), 8, 21)]),
            st.builds(
                ScaleSpace,
                scale_lists,
                scale_lists,
                st.sampled_from([0.05, 0.125, 0.4]),
                boundary=st.sampled_from(["reflect", "zero"]),
                bounds=st.sampled_from([(0.0, 1.0), (-0.5, 2.0)]),
                centred=st.booleans(),
            ),
        )
    )
    image, reference = draw(contents(shape)), draw(contents(shape))
    if draw(st.booleans()):  # equal in some rows, which backends that read values skip
        image[..., draw(st.integers(0, shape[-3] - 1)) :, :, :] = 0.5
        reference = np.where(image == 0.5, image, reference)
    return image, reference, scales, draw(st.sampled_from(["float64", "float32"]))


def max_differences(image: Host, reference: Host, scales: ScaleSpace, shift: float = 0.0) -> tuple[float, float]:
    """Return the largest differences of two losses, and of their gradients in the 1-norm, with errors of opposite sign.

    `shift` is the difference of intensities between libraries, in eps.
    """
    bound = allowed(image, reference, scales, float(np.finfo(image.dtype).eps), shift=shift)
    return 2.0 * bound.loss, 2.0 * bound.norm
