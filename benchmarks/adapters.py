"""Measure the overhead of each adapter: value and gradient through it against the core alone, on the same arrays.

Run from the root of the repository: ``python -m benchmarks.adapters``. Prints a Markdown table.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, cast

import loi_mitsuba  # before mitsuba, so that Dr.Jit gets an LLVM that works

# isort: split
import drjit as dr
import jax
import jax.numpy as jnp
import mitsuba as mi
import numpy as np
import torch

import loi_jax
import loi_torch
from loi_core import LOIObjective, ScaleSpace

SIZES: Final = ((48, 64), (96, 128), (192, 256))
SECONDS: Final = 4.0  # of measuring for each row
ROOT: Final = Path(__file__).parents[1]

Pair = tuple[Callable[[], Any], Callable[[], Any]]


def torch_pair(image: Any, reference: Any, scales: ScaleSpace) -> Pair:
    """The core on torch tensors, and the same through autograd."""
    tensor = torch.tensor(image)
    leaf = torch.tensor(image, requires_grad=True)
    target = torch.tensor(reference)
    core, loss = LOIObjective(target, scales), loi_torch.LOILoss(scales)

    def bridge() -> None:
        leaf.grad = None
        loss(leaf, target).backward()

    return lambda: core.value_and_grad(tensor), bridge


def jax_pair(image: Any, reference: Any, scales: ScaleSpace) -> Pair:
    """The core on NumPy arrays, and the same under ``jit`` through ``grad``."""
    array, target = jnp.asarray(image), jnp.asarray(reference)
    core = LOIObjective(reference, scales)
    through = jax.jit(jax.value_and_grad(lambda image, target: loi_jax.loi_loss(image, target, scales)))
    wait: Any = jax.block_until_ready
    return lambda: core.value_and_grad(image), lambda: wait(through(array, target))


def drjit_pair(backend: str) -> Callable[[Any, Any, ScaleSpace], Pair]:
    """The core on the arrays of `backend`, and the same through a Dr.Jit tensor and ``dr.backward``."""

    def pair(image: Any, reference: Any, scales: ScaleSpace) -> Pair:
        tensor = mi.TensorXf(image)
        convert = torch.tensor if backend == "torch" else np.array
        core = LOIObjective(convert(reference), scales)
        array = convert(image)
        target, options = mi.TensorXf(reference), cast("Any", {"backend": backend})

        def bridge() -> None:
            dr.enable_grad(tensor)
            dr.set_grad(tensor, 0.0)
            dr.backward(loi_mitsuba.loi_loss(tensor, target, scales, **options))
            dr.eval(dr.grad(tensor))
            dr.sync_thread()

        return lambda: core.value_and_grad(array), bridge

    return pair


def ratio(pair: Pair) -> tuple[float, float]:
    """Median milliseconds of the core, and median of the ratios of neighbouring runs, in alternating order."""
    core, bridge = pair
    for _ in range(3):
        core()
        bridge()
    times: list[float] = []
    ratios: list[float] = []
    started = time.perf_counter()
    while time.perf_counter() - started < SECONDS or len(ratios) < 7:
        first, second = (core, bridge) if len(ratios) % 2 else (bridge, core)
        started_first = time.perf_counter()
        first()
        started_second = time.perf_counter()
        second()
        finished = time.perf_counter()
        lone, bridged = (started_second - started_first, finished - started_second)
        if first is bridge:
            lone, bridged = bridged, lone
        times.append(lone)
        ratios.append(bridged / lone)
    return 1e3 * statistics.median(times), statistics.median(ratios)


def code_lines(path: Path) -> int:
    """Lines that are neither blank, comment nor docstring."""
    count, quoted = 0, False
    for line in path.read_text().splitlines():
        text = line.strip()
        if quoted or text.startswith(('"""', 'r"""')):
            if text.count('"""') % 2:
                quoted = not quoted
            continue
        count += bool(text) and not text.startswith("#")
    return count


def main() -> int:
    """Print the table."""
    mi.set_variant("llvm_ad_rgb")
    scales = ScaleSpace.paper("path")
    pairs: dict[str, Callable[[Any, Any, ScaleSpace], Pair]] = {
        "torch autograd": torch_pair,
        "JAX, jit": jax_pair,
        "Dr.Jit over torch": drjit_pair("torch"),
        "Dr.Jit over NumPy": drjit_pair("numpy"),
    }
    print("float32, RGB, paper('path'), value and gradient; ratio of the bridge to the core alone\n")
    print("| bridge | " + " | ".join(f"{width}x{height}: core ms | ratio" for height, width in SIZES) + " |")
    print("| --- " * (1 + 2 * len(SIZES)) + "|")
    for name, make in pairs.items():
        cells = []
        for height, width in SIZES:
            image, reference = np.random.default_rng(0).uniform(size=(2, height, width, 3)).astype(np.float32)
            milliseconds, overhead = ratio(make(image, reference, scales))
            cells += [f"{milliseconds:.1f}", f"{overhead:.3f}"]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)
    print()
    for package in ("loi_torch", "loi_jax", "loi_mitsuba"):
        print(f"- `{package}/loss.py`: {code_lines(ROOT / 'adapters' / package / 'loss.py')} lines of code")
    return 0


if __name__ == "__main__":
    sys.exit(main())
