"""The Triton kernels on a GPU: ``python -m benchmarks.gpu``, which takes at most five minutes.

Prints one table of errors against whole-array operations, times beside pytorch-msssim (and fused-ssim where it is
installed), memory and launches, and ends with 1 if a goal is missed. Without a GPU it prints what the comparison would
launch, allocate and compute, and the time that this takes at a bandwidth and a rate of operations.
"""

from __future__ import annotations

import statistics
import sys
from collections import Counter
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

import loi_torch
from loi_core import ScaleSpace
from loi_core.method.array_comparison import ArrayComparison
from loi_core.method.planner import make_plan
from loi_torch.triton_backend.comparison import TritonComparison
from loi_torch.triton_backend.cost import ComparisonCost, cost_of

SIZES: Final = ((192, 256), (512, 512), (1080, 1920))
BANDWIDTH: Final = 3e12  # bytes a second, of an H100
OPERATIONS: Final = 3e13  # float32 multiplications and additions a second that are reached there
MIB: Final = 2.0**20
MAX_LAUNCHES: Final = {(192, 256): 30, (512, 512): 30, (1080, 1920): 60}  # default scales
MAX_MIB: Final = {"default": 100.0, "path": 150.0}
VALUE_ERROR: Final = 1e-5
GRADIENT_ERROR: Final = 1e-3
EVALUATIONS: Final = 20
ROUNDS: Final = 5
LINE: Final = "{:>10} {:>8} {:>9} {:>8} {:>10} {:>10} {:>10} {:>10} {:>11} {:>9} {:>9}"


def scales_of(name: str, height: int, width: int) -> ScaleSpace:
    """Return the default scales of a size, or a preset of the paper."""
    return ScaleSpace.for_image(height, width) if name == "default" else ScaleSpace.paper("path")


def main() -> int:
    """Print the table; return 1 if a goal is missed."""
    if not torch.cuda.is_available():
        print("torch finds no GPU; modelled costs of a value with its gradient, 3 channels")
    missed = []
    names = ["size", "scales", "launches", "MiB", "Gflop", "bound ms"]
    if torch.cuda.is_available():
        names += ["value", "gradient", "loss ms", "graph ms", "MS-SSIM ms"]
    print(LINE.format(*names, *[""] * (11 - len(names))))
    for name in ("default", "path"):
        for size in SIZES:
            cost = cost_of(scales_of(name, *size), *size)
            cells = [
                "x".join(map(str, size)),
                name,
                str(len(cost.launches)),
                f"{cost.peak_bytes / MIB:.0f}",
                f"{cost.operations / 1e9:.1f}",
                f"{1e3 * cost.seconds(BANDWIDTH, OPERATIONS):.2f}",
            ]
            missed += goals_missed(cost, name, size)
            if torch.cuda.is_available():
                measured, faults = measure(name, size)
                cells += measured
                missed += faults
            print(LINE.format(*cells, *[""] * (11 - len(cells))), flush=True)
    print_kernels(cost_of(ScaleSpace.for_image(1080, 1920), 1080, 1920))
    if torch.cuda.is_available():
        missed += compiled_faults()
    for goal in missed:
        print(f"missed: {goal}")
    return 1 if missed else 0


def goals_missed(cost: ComparisonCost, name: str, size: tuple[int, int]) -> list[str]:
    """Return the goals of launches and memory that a comparison misses."""
    goals = []
    if name == "default" and len(cost.launches) > MAX_LAUNCHES[size]:
        goals.append(f"{len(cost.launches)} launches at {size}, allowed {MAX_LAUNCHES[size]}")
    if cost.peak_bytes > MAX_MIB[name] * MIB:
        goals.append(f"{cost.peak_bytes / MIB:.0f} MiB in the scales {name} at {size}, allowed {MAX_MIB[name]:.0f}")
    return goals


def print_kernels(cost: ComparisonCost) -> None:
    """Print the launches, memory traffic and operations of each kernel."""
    launches: Counter[str] = Counter()
    traffic: Counter[str] = Counter()
    operations: Counter[str] = Counter()
    for launch in cost.launches:
        kernel = launch.kernel if isinstance(launch.kernel, str) else launch.kernel.__name__
        launches[kernel] += 1
        traffic[kernel] += launch.bytes
        operations[kernel] += round(launch.operations)
    print("\nkernels, default scales at 1080x1920: launches, MB, Gflop")
    for kernel, count in launches.items():
        print(f"{kernel:>20} {count:4d} {traffic[kernel] / 1e6:9.1f} {operations[kernel] / 1e9:8.2f}")


def measure(name: str, size: tuple[int, int]) -> tuple[list[str], list[str]]:
    """Return cells of errors and times on the GPU, and the goals that are missed."""
    scales = scales_of(name, *size)
    rng = np.random.default_rng(0)
    hosts = [rng.uniform(size=(3, *size)).astype(np.float32) for _ in range(2)]
    image, target = (torch.from_numpy(host).cuda() for host in hosts)
    plan = make_plan(scales, *size, tolerance=0.0, eps=float(np.finfo(np.float32).eps))
    comparison = TritonComparison.of(scales, plan, target)
    result = comparison.compare(image, gradient=True)
    expected = ArrayComparison.of(scales, plan, target).compare(image.clone(), gradient=True)
    value, exact = (float(sum(one.terms.values())) for one in (result, expected))
    value_error = abs(value - exact) / exact
    gradient, exact_gradient = (torch.as_tensor(one.cotangent) for one in (result, expected))
    gradient_error = float(torch.linalg.norm(gradient - exact_gradient) / torch.linalg.norm(exact_gradient))
    del result, expected, gradient, exact_gradient
    torch.cuda.synchronize()
    held = torch.cuda.memory_allocated()
    torch.cuda.reset_peak_memory_stats()
    comparison.compare(image, gradient=True)
    mebibytes = (torch.cuda.max_memory_allocated() - held) / MIB

    def step() -> None:
        comparison.compare(image, gradient=True)

    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        step()
    loss_ms, graph_ms, peer_ms = milliseconds([step, graph.replay, peer(image, target)])
    faults = [
        f"{what} {error:.1e} in the scales {name} at {size}, allowed {allowed:.0e}"
        for what, error, allowed in (
            ("error of the value", value_error, VALUE_ERROR),
            ("error of the gradient", gradient_error, GRADIENT_ERROR),
        )
        if not error <= allowed
    ]
    if mebibytes > MAX_MIB[name]:
        faults.append(f"{mebibytes:.0f} MiB measured in the scales {name} at {size}, allowed {MAX_MIB[name]:.0f}")
    times = [f"{one:.2f}" for one in (loss_ms, graph_ms, peer_ms)]
    return [f"{value_error:.1e}", f"{gradient_error:.1e}", *times], faults


def peer(image: Tensor, target: Tensor) -> Callable[[], object]:
    """Return an evaluation of SSIM with its gradient: by fused-ssim if it is installed, else by pytorch-msssim."""
    try:
        from fused_ssim import fused_ssim as ssim
    except ImportError:
        from pytorch_msssim import ms_ssim as ssim
    variable = image[None].clone().requires_grad_()

    def evaluate() -> object:
        return torch.autograd.grad(ssim(variable, target[None]), variable)

    return evaluate


def milliseconds(calls: list[Callable[[], Any]]) -> list[float]:
    """Return the median times of calls, made in turns."""
    for call in calls:
        call()
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(ROUNDS):
        for call, samples in zip(calls, times, strict=True):
            start, stop = (torch.cuda.Event(enable_timing=True) for _ in range(2))  # type: ignore[no-untyped-call]
            start.record()
            for _ in range(EVALUATIONS):
                call()
            stop.record()
            stop.synchronize()
            samples.append(start.elapsed_time(stop) / EVALUATIONS)
    return [statistics.median(samples) for samples in times]


def compiled_faults() -> list[str]:
    """Return a fault if ``torch.compile`` of a step with the loss changes its gradient."""
    image, target = torch.rand(2, 192, 256, 3, device="cuda")
    loss = loi_torch.LOILoss()

    def objective(pixels: Tensor) -> Any:
        return loss(torch.sigmoid(pixels), target)

    gradients = []
    for function in (objective, torch.compile(objective)):
        variable = image.clone().requires_grad_()
        gradients += torch.autograd.grad(function(variable), variable)
    error = float(torch.linalg.norm(gradients[0] - gradients[1]) / torch.linalg.norm(gradients[0]))
    return [] if error <= GRADIENT_ERROR else [f"torch.compile changes the gradient by {error:.1e}"]


if __name__ == "__main__":
    sys.exit(main())
