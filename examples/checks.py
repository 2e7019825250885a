"""Print the measured error beside every tolerance that the loss promises: ``python -m examples.checks``.

Run it from the root of the repository, with the development extras installed. ``--quick`` checks the gradient with one
of the five presets; JAX compiles a program for each.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import array_api_strict
import jax
import jax.numpy as jnp
import numpy as np
import torch
from scipy import stats

from loi_core import LOIObjective, ScaleSpace
from loi_core.method.dispatch import ARRAY_API
from loi_core.objectives import ReferencePlanes

STORED: Final = Path(__file__).parents[1] / "tests" / "data" / "released_loss.npz"
SHAPE: Final = (24, 19, 3)
SPACES: Final = {
    "paper vector": ScaleSpace.paper("vector"),
    "paper path": ScaleSpace.paper("path"),
    "paper raster": ScaleSpace.paper("raster"),
    "path, zero boundary": ScaleSpace.paper("path", boundary="zero"),
    "released": ScaleSpace.released((1, 5), (1, 5, 15), 8, 61),
}
QUICK_PRESET: Final = "paper path"


def relative(actual: Any, expected: Any) -> float:
    """Return the relative error in the 2-norm."""
    return float(np.linalg.norm(np.asarray(actual) - expected) / np.linalg.norm(expected))


def gradient_errors(image: Any, reference: Any, scales: ScaleSpace) -> dict[str, float]:
    """Return the errors of the analytic gradient against differences, torch, JAX and array_api_strict."""
    objective = LOIObjective(reference, scales)
    _, gradient = objective.value_and_grad(image)
    direction = np.random.default_rng(1).standard_normal(SHAPE)
    inner_difference = objective.value(image + 1e-7 * direction) - objective.value(image - 1e-7 * direction)
    outer_difference = objective.value(image + 2e-7 * direction) - objective.value(image - 2e-7 * direction)
    slope = float(np.sum(gradient * direction))
    leaf = torch.tensor(image, requires_grad=True)
    LOIObjective(torch.tensor(reference), scales).value(leaf).backward()
    assert leaf.grad is not None
    traced = LOIObjective(jnp.asarray(reference), scales)
    planes = ReferencePlanes(jnp.moveaxis(jnp.asarray(reference), -1, 0), None, ARRAY_API)
    comparison = traced.compare_with(planes)
    forward = jax.grad(lambda image: sum(comparison.compare(image, gradient=False).terms.values()))
    jaxed = jax.jit(forward)(jnp.moveaxis(jnp.asarray(image), -1, 0))
    strict = LOIObjective(array_api_strict.asarray(reference), scales)
    return {
        "central differences": abs((8 * inner_difference - outer_difference) / 12e-7 - slope)
        / float(np.linalg.norm(gradient)),
        "torch autograd": relative(leaf.grad, gradient),
        "JAX grad": relative(jnp.moveaxis(jaxed, 0, -1), gradient),
        "array_api_strict": relative(strict.value_and_grad(array_api_strict.asarray(image))[1], gradient),
    }


def rows(presets: Iterable[str]) -> list[tuple[str, float, float]]:
    """Return the name, measured value and tolerance of every check; the gradient is checked with `presets`."""
    image, reference = np.random.default_rng(3).uniform(0.02, 0.98, (2, *SHAPE))
    bounds = {"central differences": 1e-6, "torch autograd": 1e-10, "JAX grad": 1e-10, "array_api_strict": 1e-12}
    worst = dict.fromkeys(bounds, 0.0)
    for preset in presets:
        for name, error in gradient_errors(image, reference, SPACES[preset]).items():
            worst[name] = max(worst[name], error)
    table = [(f"gradient against {name}", worst[name], bound) for name, bound in bounds.items()]
    stored = np.load(STORED, allow_pickle=False)
    for case in ("a", "d"):
        config = json.loads(str(stored[f"{case}_config"]))
        scales = ScaleSpace.released(config["sigma"], config["alpha"], config["nb"], config["ks"])
        objective = LOIObjective(stored[f"{case}_reference"].astype(np.float64), scales)
        value, gradient = objective.value_and_grad(stored[f"{case}_image"].astype(np.float64))
        expected = float(stored[f"{case}_loss"])
        table.append((f"released loss, case {case}", abs(float(value) / expected - 1.0), 1e-5))
        table.append((f"released gradient, case {case}", relative(gradient, stored[f"{case}_grad"]), 1e-3))
    flat = LOIObjective(reference[..., :1], ScaleSpace(0, 1e6, 1e-3)).value(image[..., :1])
    distance = stats.wasserstein_distance(image[..., 0].ravel(), reference[..., 0].ravel())
    table.append(("whole image against scipy's Wasserstein distance, beta 1e-3", abs(float(flat) - distance), 1e-3))
    return table


def main() -> int:
    """Print the table; return 1 if a tolerance is exceeded."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--quick", action="store_true", help=f"check the gradient with the preset {QUICK_PRESET!r} only"
    )
    is_quick = parser.parse_args().quick
    jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]  # untyped in JAX
    table = rows((QUICK_PRESET,) if is_quick else tuple(SPACES))
    print("| check | measured | tolerance |\n| --- | --- | --- |")
    for name, measured, bound in table:
        print(f"| {name} | {measured:.1e} | {bound:.0e} |")
    return int(any(measured >= bound for _, measured, bound in table))


if __name__ == "__main__":
    sys.exit(main())
