"""Shared by several tests: typical scales, random images, and finite differences."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias

import numpy as np
import pytest

from loi_core import ScaleSpace

Host: TypeAlias = np.ndarray[Any, Any]

FINISHED = (0, 3)
"""Exit statuses of a fit that ran to its end, whether it found its target or not."""

SCALES: dict[str, ScaleSpace] = {
    "paper vector": ScaleSpace.paper("vector"),
    "paper path": ScaleSpace.paper("path"),
    "paper raster": ScaleSpace.paper("raster"),
    "paper path, zero": ScaleSpace.paper("path", boundary="zero"),
    "for image": ScaleSpace.for_image(24, 19),
    "no blur at all": ScaleSpace(0, 0, 0.1),
    "wider than the image": ScaleSpace((0, 60), (0, 500), 0.1),
    "two tonal scales": ScaleSpace(1, 3, (0.05, 0.2), bounds=(-0.5, 2.0)),
    "centred": ScaleSpace((1, 4), (2, 9), 0.125, centred=True),
    "centred squares": ScaleSpace((0, 2), (2, 9), 0.125, p=0.5, centred=True),
    "squared distance": ScaleSpace((1, 4), (2, 9), 0.125, p=0.5),
    "released": ScaleSpace.released((1, 5), (1, 5, 15), 8, 61),
}


@contextmanager
def without_numba() -> Iterator[None]:
    """Compare as if Numba were not installed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LOI_COMPILED", "0")
        yield


def images(shape: tuple[int, ...], seed: int, minimum: float = 0.02, maximum: float = 0.98) -> tuple[Host, Host]:
    """Return two random images strictly inside the default bounds, without clipping and without ties."""
    rng = np.random.default_rng(seed)
    first, second = rng.uniform(minimum, maximum, (2, *shape))
    return first, second


def directional_difference(function: Callable[[Host], Any], at: Host, direction: Host, step: float) -> float:
    """Return the central difference of fourth order of `function` along `direction`.

    Its error is step^4 times a fifth derivative plus rounding over step, so in float64 a step near 1e-4 leaves
    about 1e-11 on a smooth function of size 1.
    """
    inner = float(function(at + step * direction)) - float(function(at - step * direction))
    outer = float(function(at + 2 * step * direction)) - float(function(at - 2 * step * direction))
    return (8.0 * inner - outer) / (12.0 * step)


def relative_error(actual: Host, expected: Host) -> float:
    """Return the Euclidean norm of the difference over the norm of the expected array."""
    return float(np.linalg.norm(np.asarray(actual) - np.asarray(expected)) / np.linalg.norm(np.asarray(expected)))


def program_output(code: str, **environment: str) -> str:
    """Return the output of a program, followed by the name of each warning about compiled loops."""
    process = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
        env={**os.environ, "PYTHONWARNINGS": "always::RuntimeWarning", **environment},
    )
    return process.stdout.strip() + "".join(re.findall("CompiledLoopsWarning", process.stderr))
