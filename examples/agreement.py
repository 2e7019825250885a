"""Measure the differences between backends: ``python -m examples.agreement [EXAMPLES]``, from the root.

Draws the problems of ``tests/conformance/test_backends.py`` and prints, for each backend and dtype, the worst
difference from NumPy in loss and gradient, and its fraction of the bound that the tests assert.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict

import jax
import numpy as np
from hypothesis import HealthCheck, Phase, given, settings

from loi_core import LOIObjective
from tests.conformance.test_backends import BACKENDS
from tests.strategies import Problem, max_differences, problems


def main() -> int:
    """Print the table; return 1 if a bound is exceeded."""
    parser = argparse.ArgumentParser(prog="python -m examples.agreement", description=__doc__)
    parser.add_argument("examples", type=int, nargs="?", default=300, help="problems to draw (default: 300; minutes)")
    examples = parser.parse_args().examples
    jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]  # untyped in JAX
    worst: dict[tuple[str, str], list[float]] = defaultdict(lambda: [0.0] * 4)
    count: dict[str, int] = defaultdict(int)

    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(problems())
    def measure(problem: Problem) -> None:
        image, reference, scales, dtype = problem
        image, reference = image.astype(dtype), reference.astype(dtype)
        count[dtype] += 1
        value, gradient = LOIObjective(reference, scales).value_and_grad(image)
        loss_bound, gradient_bound = max_differences(image, reference, scales)
        size = max(float(np.abs(gradient).sum()), 1e-30)
        for name, backend in BACKENDS.items():
            if name == "Dr.Jit" and dtype == "float64":
                continue
            backend_value, slopes = backend(image, reference, scales, None)
            loss, slope = abs(float(backend_value) - float(value)), float(np.abs(slopes - gradient).sum())
            fractions = _fraction(loss, loss_bound), _fraction(slope, gradient_bound)
            errors = (loss / max(abs(float(value)), 1e-30), fractions[0], slope / size, fractions[1])
            if float(value) == 0.0:
                errors = (0.0, errors[1], 0.0, errors[3])
            worst[name, dtype] = [max(pair) for pair in zip(worst[name, dtype], errors, strict=True)]

    measure()
    print(f"{sum(count.values())} problems: {', '.join(f'{number} in {dtype}' for dtype, number in count.items())}\n")
    print("| backend | dtype | loss, relative | of its bound | gradient, relative 1-norm | of its bound |")
    print("| --- | --- | --- | --- | --- | --- |")
    for (name, dtype), (loss, loss_share, slope, slope_share) in sorted(worst.items()):
        print(f"| {name} | {dtype} | {loss:.1e} | {loss_share:.2f} | {slope:.1e} | {slope_share:.2f} |")
    return int(any(max(row[1], row[3]) > 1.0 for row in worst.values()))


def _fraction(difference: float, bound: float) -> float:
    """Return a difference as a fraction of its bound, which is 0 where nothing may differ, as for equal images."""
    if difference == 0.0:
        return 0.0
    return difference / bound if bound else float("inf")


if __name__ == "__main__":
    sys.exit(main())
