"""A program that compares the Triton kernels, interpreted on the processor, with whole-array operations.

Triton reads ``TRITON_INTERPRET`` as it is imported, so the test runs this in a process of its own.
"""

from __future__ import annotations

import itertools
from typing import Any, Final

import numpy as np
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from loi_core import ScaleSpace
from loi_core.method.array_comparison import ArrayComparison
from loi_core.method.planner import make_plan
from loi_core.method.reference import loss_and_gradient
from loi_torch.triton_backend import comparison as executor
from loi_torch.triton_backend import stack_blurs
from loi_torch.triton_backend.comparison import TritonComparison

EPS: Final = float(np.finfo(np.float32).eps)
VALUE_ERROR: Final = 1e-5
GRADIENT_ERROR: Final = 1e-3

CASES: Final[dict[str, tuple[ScaleSpace, tuple[int, int, int], bool]]] = {
    "a pyramid, from differences of one tile": (ScaleSpace(1, 5, 1.0, tails=0), (1, 20, 40), True),
    "a pyramid, from differences wider than a tile": (ScaleSpace(1, (20, 60), 1.0, tails=0), (1, 20, 66), True),
    "extents of the resolution of the image": (ScaleSpace((0, 1), (0, 2), 1.0, tails=1), (1, 12, 20), False),
    "several blocks of rows": (ScaleSpace(1, 2, 1.0, tails=0), (1, 70, 18), False),
    "an extent of the resolution of the image beside a pyramid": (
        ScaleSpace(1, (1, 9), 1.0, tails=0),
        (1, 8, 40),
        True,
    ),
    "a power": (ScaleSpace(1, (0, 9), 1.0, p=2, tails=0), (1, 12, 40), True),
    "centred, weighted": (ScaleSpace(1, (0, 3), (0.5, 1.0), tails=0, centred=True), (2, 12, 9), True),
    "means of the whole image": (ScaleSpace((1, 200), (9, 300), 0.5, tails=1), (1, 12, 20), False),
    "zeros around bounds above 0": (ScaleSpace((0, 1), (0, 5), 1.0, (1, 3), "zero", tails=0), (1, 12, 20), False),
    "as released": (ScaleSpace(1, (3, 9), 0.25, convention="released", kernel_size=9), (1, 12, 20), False),
}


def planes(scales: ScaleSpace, shape: tuple[int, int, int], seed: int, *, weighted: bool) -> list[Any]:
    """Return image, reference, and weights or None; the images are equal in a corner."""
    rng = np.random.default_rng(seed)
    low, high = scales.bounds
    image, reference = (rng.uniform(low, high, shape).astype(np.float32) for _ in range(2))
    image[:, : shape[1] // 3, : shape[2] // 3] = reference[:, : shape[1] // 3, : shape[2] // 3]
    weights = rng.uniform(size=shape) * (rng.uniform(size=shape) > 0.2)
    tensors = [torch.from_numpy(image), torch.from_numpy(reference)]
    return [*tensors, torch.from_numpy(weights.astype(np.float32)) if weighted else None]


def check(scales: ScaleSpace, shape: tuple[int, int, int], seed: int, *, weighted: bool) -> None:
    """Check values and gradients against whole-array operations."""
    image, reference, weights = planes(scales, shape, seed, weighted=weighted)
    plan = make_plan(scales, *shape[1:], tolerance=0.0, eps=EPS, weighted=weighted)
    expected = ArrayComparison.of(scales, plan, reference, weights).compare(image.clone(), gradient=True)
    comparison = TritonComparison.of(scales, plan, reference, weights)
    result = comparison.compare(image, gradient=True)
    value, exact = (float(sum(one.terms.values())) for one in (result, expected))
    assert abs(value - exact) <= VALUE_ERROR * exact, f"value {value}, expected {exact}"
    for key, term in expected.terms.items():
        assert abs(float(result.terms[key] - term)) <= VALUE_ERROR * exact, f"term {key}"
    error, allowed = distance(result.cotangent, expected.cotangent), GRADIENT_ERROR
    if scales.p != 1.0:
        # The slope is infinite at 0, so rounding errors of the whole-array operations count as well.
        truth = double_gradient(scales, image, reference, weights)
        error, allowed = distance(result.cotangent, truth), GRADIENT_ERROR + distance(expected.cotangent, truth)
    assert error <= allowed, f"gradient off by {error:.1e}, allowed {allowed:.1e}"


def distance(gradient: Any, expected: Any) -> float:
    return float((gradient - expected).norm() / expected.norm().clamp(min=1e-20))


def double_gradient(scales: ScaleSpace, image: Any, reference: Any, weights: Any) -> Any:
    """Return the gradient by the dense reference implementation, in float64."""
    gradients = []
    for index in range(image.shape[0]):
        host, target = (one[index].double().numpy() for one in (image, reference))
        plane_weights = None if weights is None else weights[index].double().numpy()
        gradients.append(loss_and_gradient(host, target, scales, channel_axis=None, eps=EPS, weights=plane_weights)[1])
    return torch.from_numpy(np.stack(gradients)) / len(gradients)


@settings(max_examples=4, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    st.builds(
        ScaleSpace,
        st.sampled_from([0, 1, 2.5, (0, 1)]),
        st.sampled_from([0, 2, (1, 5), 100]),
        st.sampled_from([0.5, 1.0]),
        st.sampled_from([(0.0, 1.0), (-1.0, 1.0), (2.0, 3.0)]),
        st.sampled_from(["reflect", "zero"]),
        tails=st.just(1),
        centred=st.booleans(),
    ),
    st.tuples(st.integers(1, 2), st.integers(1, 12), st.integers(1, 18)),
    st.booleans(),
    st.integers(0, 2**31),
)
def check_any(scales: ScaleSpace, shape: tuple[int, int, int], weighted: bool, seed: int) -> None:
    """Check any scales and sizes."""
    check(scales, shape, seed, weighted=weighted)


def check_chunks() -> None:
    """Check that levels and planes which are handled a few at a time give the same result."""
    executor.MIN_MEMORY = executor.MEMORY_PLANES = 0  # type: ignore[misc]  # constants elsewhere
    check(ScaleSpace(1, (0, 9), 1.0, tails=0), (2, 8, 40), 0, weighted=True)


def check_repeated() -> None:
    """Check that a second evaluation gives the same bits, and one without a gradient the same terms."""
    scales = ScaleSpace(1, (1, 9), 1.0, tails=0)
    image, reference, _ = planes(scales, (1, 8, 40), 0, weighted=False)
    plan = make_plan(scales, 8, 40, tolerance=0.0, eps=EPS)
    comparison = TritonComparison.of(scales, plan, reference)
    result, again = (comparison.compare(image, gradient=True) for _ in range(2))
    assert distance(result.cotangent, again.cotangent) == 0.0
    assert result.terms == again.terms
    assert comparison.compare(image, gradient=False).terms == result.terms


def check_equal() -> None:
    """Check that equal images have the loss 0 and no gradient."""
    scales = ScaleSpace(1, (0, 9), 1.0, tails=0)
    image, *_ = planes(scales, (1, 8, 40), 0, weighted=False)
    plan = make_plan(scales, 8, 40, tolerance=0.0, eps=EPS)
    result = TritonComparison.of(scales, plan, image).compare(image.clone(), gradient=True)
    assert not any(result.terms.values())
    assert distance(result.cotangent, torch.zeros_like(image)) == 0.0


if __name__ == "__main__":
    # Fewer and larger tiles take less time to interpret.
    for name, size in {
        "ELEMENTS": 4096,
        "PULLED_ROWS": 64,
        "LEVEL_ROWS": 512,
        "COLUMNS": 128,
        "TILE": 8192,
    }.items():
        setattr(executor, name, size)
    stack_blurs.LINES = 256  # type: ignore[misc]
    for seed, (name, (scales, shape, weighted)) in zip(itertools.count(), CASES.items()):
        check(scales, shape, seed, weighted=weighted)
        print(name, flush=True)
    check_any()
    check_repeated()
    check_equal()
    check_chunks()
