"""Measure the libraries and dtypes that each objective supports: ``python -m examples.capabilities``.

"yes": the objective keeps every rule of the conformance kit. "float32": it compares images of 16 bits in float32.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import jax
import numpy as np
import torch

from loi_core import MSSSIM, GaussianPyramid, LOIObjective, Objective, PixelL2, ScaleSpace
from loi_core.support.arrays import Array, Host
from loi_core.support.markdown import markdown
from loi_core.testing import check_objective

__all__ = ["OBJECTIVES", "capability", "table"]

SHAPE: Final = (24, 31, 2)
SCALES: Final = ScaleSpace((0.0, 2.0), (1.0, 5.0), 0.125)
DTYPES: Final = ("float64", "float32", "float16", "bfloat16")

OBJECTIVES: Final[dict[str, Callable[[Array], Objective]]] = {
    "LOIObjective": lambda reference: LOIObjective(reference, SCALES),
    "PixelL2": PixelL2,
    "GaussianPyramid": GaussianPyramid,
    "MSSSIM": MSSSIM,
}


def _jax(host: Host) -> Any:
    return jax.numpy.asarray(host)


LIBRARIES: Final[dict[str, Callable[[Host], Any]]] = {"NumPy": lambda host: host, "torch": torch.asarray, "JAX": _jax}


def capability(objective: str, library: str, dtype: str) -> str:
    """Return the support of an objective for images of a library and dtype, by trying it."""
    make, asarray = OBJECTIVES[objective], LIBRARIES[library]
    if dtype in ("float64", "float32"):
        check_objective(make, asarray=asarray, shape=SHAPE, dtype=dtype)
        return "yes"
    image, reference = np.random.default_rng(0).uniform(size=(2, *SHAPE)).astype("float32")
    if library == "NumPy":
        if dtype == "bfloat16":
            return "no such array"
        half: Any = image.astype(dtype)
    elif library == "torch":
        half = torch.asarray(image).to(getattr(torch, dtype))
    else:
        half = _jax(image).astype(dtype)
    value, gradient = make(reference).value_and_grad(half)
    return "float32" if value.dtype == gradient.dtype == half.dtype else "wider results"


def table() -> list[str]:
    """Return the table of objectives by libraries and dtypes, in Markdown."""
    rows = [
        [objective, library, *(capability(objective, library, dtype) for dtype in DTYPES)]
        for objective in OBJECTIVES
        for library in LIBRARIES
    ]
    return markdown(["objective", "library", *DTYPES], rows)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]  # untyped in JAX
    print("\n".join(table()))
