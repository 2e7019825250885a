"""The loss on a GPU: ``python -m benchmarks.gpu``, which takes at most five minutes.

Prints one table of errors against whole-array operations, times beside the times of SSIM, memory and launches, each
with its goal, for torch's Triton kernels, JAX and meshes, and ends with 1 if a goal is missed. Without a GPU it prints
the launches, the memory and the operations of the comparison, and their time at a bandwidth and a rate of operations.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

# Two frameworks share a GPU here; JAX would take three quarters of it to itself.
os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")

# isort: split
import jax
import numpy as np
import torch
from torch import Tensor

import loi_jax
import loi_torch
from loi_core import ScaleSpace
from loi_core.method.array_comparison import ArrayComparison
from loi_core.method.planner import make_plan
from loi_torch.mesh import Camera, Light, box, draw
from loi_torch.triton_backend.backend import FAILED_DEVICES
from loi_torch.triton_backend.comparison import TritonComparison
from loi_torch.triton_backend.cost import cost_of

SIZES: Final = ((192, 256), (512, 512), (1080, 1920))
SCALES: Final = ("default", "path")
EPS: Final = float(np.finfo(np.float32).eps)
MIB: Final = 2.0**20

MAX_LAUNCHES: Final = {"default": 30, "path": 240}
MAX_MIB: Final = {"default": 100.0, "path": 150.0}
MAX_MS: Final = {(192, 256): 1.0, (512, 512): 2.0, (1080, 1920): 10.0}
MAX_VALUE_ERROR: Final = 1e-5
MAX_GRADIENT_ERROR: Final = 1e-3
MAX_COMPILE_S: Final = 30.0
MAX_TOTAL_S: Final = 300.0

EVALUATIONS: Final = 20
ROUNDS: Final = 5


@dataclass(frozen=True)
class Result:
    """A number, and the largest that is allowed, if any."""

    what: str
    value: float
    limit: float = float("inf")

    @property
    def missed(self) -> bool:
        """Whether the goal is missed, as by NaN."""
        return not self.value <= self.limit


def main() -> int:
    """Print the table; return 1 if a goal is missed."""
    start = time.monotonic()
    has_gpu = torch.cuda.is_available()
    if not has_gpu:
        print("torch finds no GPU; modelled costs of a value with its gradient, 3 channels")
    print(f"{'size':>10} {'scales':>8}  {'quantity':<32} {'value':>10} {'goal':>10}")
    missed = 0
    for name in SCALES:
        for size in SIZES:
            missed += table("x".join(map(str, size)), name, modelled(name, size))
            if has_gpu:
                missed += table("x".join(map(str, size)), name, measured(name, size))
    if has_gpu:
        for size in SIZES if jax.default_backend() == "gpu" else ():
            missed += table("x".join(map(str, size)), "default", by_jax(size))
        missed += table("192x256", "default", compiled())
        missed += table("192x256", "", drawn())
        missed += table("", "", [Result("devices on which kernels failed", len(FAILED_DEVICES), 0)])
        missed += table("", "", [Result("whole run, s", time.monotonic() - start, MAX_TOTAL_S)])
    else:
        print_kernels("path", SIZES[-1])
    return 1 if missed else 0


def table(size: str, name: str, results: Iterable[Result]) -> int:
    """Print rows of the table; return the number of goals that are missed."""
    missed = 0
    try:
        for result in results:
            missed += result.missed
            goal = "" if result.limit == float("inf") else f"{result.limit:.4g}"
            mark = "  missed" if result.missed else ""
            print(f"{size:>10} {name:>8}  {result.what:<32} {result.value:>10.4g} {goal:>10}{mark}", flush=True)
    except Exception as error:  # noqa: BLE001  # the other rows are worth a GPU's time
        print(f"{size:>10} {name:>8}  {type(error).__name__}: {error}", flush=True)
        return missed + 1
    return missed


def scales_of(name: str, height: int, width: int) -> ScaleSpace:
    """Return the default scales of a size, or a preset of the paper."""
    return ScaleSpace.for_image(height, width) if name == "default" else ScaleSpace.paper("path")


def modelled(name: str, size: tuple[int, int]) -> Iterator[Result]:
    """Yield the launches, the memory and the operations of a comparison."""
    cost = cost_of(scales_of(name, *size), *size)
    yield Result("launches", len(cost.launches), MAX_LAUNCHES[name])
    yield Result("modelled memory, MiB", cost.peak_bytes / MIB, MAX_MIB[name])
    yield Result("operations, 1e9", cost.operations / 1e9)
    yield Result("modelled time, ms", 1e3 * cost.seconds(), MAX_MS[size])


def print_kernels(name: str, size: tuple[int, int]) -> None:
    """Print the launches, memory traffic and operations of each kernel."""
    launches: Counter[str] = Counter()
    traffic: Counter[str] = Counter()
    operations: Counter[str] = Counter()
    for launch in cost_of(scales_of(name, *size), *size).launches:
        kernel = launch.kernel if isinstance(launch.kernel, str) else launch.kernel.__name__
        launches[kernel] += 1
        traffic[kernel] += launch.bytes
        operations[kernel] += round(launch.operations)
    print(f"\nkernels, scales {name} at {size}: launches, MB, 1e9 operations")
    for kernel, count in launches.items():
        print(f"{kernel:>24} {count:4d} {traffic[kernel] / 1e6:9.1f} {operations[kernel] / 1e9:8.2f}")


def images(size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Return an image and a target on the GPU, shape (H, W, 3)."""
    hosts = np.random.default_rng(0).uniform(size=(2, *size, 3)).astype(np.float32)
    image, target = torch.from_numpy(hosts).cuda()
    return image, target


def relative(value: Tensor, expected: Tensor) -> float:
    """Return the relative error of a gradient."""
    return float(torch.linalg.norm(value - expected) / torch.linalg.norm(expected))


def measured(name: str, size: tuple[int, int]) -> Iterator[Result]:
    """Yield errors, memory and times of torch on the GPU."""
    scales = scales_of(name, *size)
    image, target = images(size)
    planes, target_planes = (pixels.movedim(-1, 0).contiguous() for pixels in (image, target))
    plan = make_plan(scales, *size, tolerance=0.0, eps=EPS)
    result = TritonComparison.of(scales, plan, target_planes).compare(planes, gradient=True)
    expected = ArrayComparison.of(scales, plan, target_planes).compare(planes.clone(), gradient=True)
    value, exact = (float(sum(one.terms.values())) for one in (result, expected))
    gradients = [torch.as_tensor(one.cotangent) for one in (result, expected)]
    yield Result("error of the value", abs(value - exact) / exact, MAX_VALUE_ERROR)
    yield Result("error of the gradient", relative(*gradients), MAX_GRADIENT_ERROR)
    del result, expected, gradients
    torch.cuda.synchronize()
    held = torch.cuda.memory_allocated()
    torch.cuda.reset_peak_memory_stats()
    TritonComparison.of(scales, plan, target_planes).compare(planes, gradient=True)
    torch.cuda.synchronize()
    yield Result("memory, MiB", (torch.cuda.max_memory_allocated() - held) / MIB, MAX_MIB[name])

    variable = image.clone().requires_grad_()
    loss = loi_torch.LOILoss(scales)

    def step() -> Tensor:
        return torch.autograd.grad(loss(variable, target), variable)[0]

    eager = step()
    graph, replayed = captured(step)
    graph.replay()
    yield Result("error of a CUDA graph's gradient", relative(replayed, eager), 0.0)
    loss_ms, graph_ms, ssim_ms = milliseconds([step, graph.replay, ssim(variable, target)])
    yield Result("loss and gradient, ms", loss_ms)
    yield Result("loss and gradient, graph, ms", graph_ms, MAX_MS[size])
    yield Result("SSIM and gradient, ms", ssim_ms)


def captured(step: Callable[[], Tensor]) -> tuple[torch.cuda.CUDAGraph, Tensor]:
    """Return a CUDA graph of a step, which has been called before, and its result."""
    stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]  # in torch
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):  # the first backward pass on a stream may allocate outside of the graph
        for _ in range(3):
            step()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, stream=stream):
        result = step()
    return graph, result


def ssim(variable: Tensor, target: Tensor) -> Callable[[], object]:
    """Return an evaluation with its gradient of fused-ssim's SSIM if it is installed, else pytorch-msssim's MS-SSIM."""
    try:
        from fused_ssim import fused_ssim as similarity
    except ImportError:
        from pytorch_msssim import ms_ssim

        similarity = partial(ms_ssim, data_range=1.0)
    reference = target.movedim(-1, 0)[None].contiguous()

    def evaluate() -> object:
        return torch.autograd.grad(similarity(variable.movedim(-1, 0)[None].contiguous(), reference), variable)

    return evaluate


def milliseconds(calls: list[Callable[[], Any]]) -> list[float]:
    """Return the median times of calls, made in turns."""
    for call in calls:
        call()
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(ROUNDS):
        for call, samples in zip(calls, times, strict=True):
            torch.cuda.synchronize()
            start, stop = (torch.cuda.Event(enable_timing=True) for _ in range(2))  # type: ignore[no-untyped-call]
            start.record()
            for _ in range(EVALUATIONS):
                call()
            stop.record()
            stop.synchronize()
            samples.append(start.elapsed_time(stop) / EVALUATIONS)
    return [statistics.median(samples) for samples in times]


def by_jax(size: tuple[int, int]) -> Iterator[Result]:
    """Yield the compile time, error and time of JAX."""
    image, target = images(size)
    variable = image.clone().requires_grad_()
    (expected,) = torch.autograd.grad(loi_torch.LOILoss()(variable, target), variable)
    arrays = [jax.device_put(pixels.cpu().numpy()) for pixels in (image, target)]
    start = time.perf_counter()
    function = jax.jit(jax.value_and_grad(loi_jax.loi_loss)).lower(*arrays).compile()
    yield Result("JAX: compilation, s", time.perf_counter() - start, MAX_COMPILE_S)
    gradient = torch.from_numpy(np.array(function(*arrays)[1])).cuda()
    yield Result("JAX: error of the gradient", relative(gradient, expected), MAX_GRADIENT_ERROR)
    samples = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        values = [function(*arrays)[0] for _ in range(EVALUATIONS)]
        values[-1].block_until_ready()  # calls run in turn
        samples.append(1e3 * (time.perf_counter() - start) / EVALUATIONS)
    yield Result("JAX: loss and gradient, ms", statistics.median(samples))


def compiled() -> Iterator[Result]:
    """Yield the error of the gradient of a compiled step with the loss."""
    image, target = images((192, 256))
    loss = loi_torch.LOILoss()

    def objective(pixels: Tensor) -> Any:
        return loss(torch.sigmoid(pixels), target)

    variable = image.clone().requires_grad_()
    (expected,) = torch.autograd.grad(objective(variable), variable)
    (gradient,) = torch.autograd.grad(torch.compile(objective)(variable), variable)
    yield Result("torch.compile: error", relative(gradient, expected), MAX_GRADIENT_ERROR)


def drawn() -> Iterator[Result]:
    """Yield the errors of an image of a mesh on the GPU, and of its gradient, against the processor's."""

    def image_and_gradient(device: str) -> tuple[Tensor, Tensor, float]:
        vertices = box().vertices.detach().to(device).requires_grad_()
        start = time.perf_counter()
        mesh = replace(box(colours=(0.8, 0.4, 0.2)), vertices=vertices)
        image = draw([mesh], Camera((2.0, 2.0, 4.0), fov=40.0), 192, 256, lights=[Light(direction=(-1.0, -2.0, -3.0))])
        (gradient,) = torch.autograd.grad(image.square().sum(), vertices)
        gradient.cpu()
        milliseconds = 1e3 * (time.perf_counter() - start)
        if not image.device.type == gradient.device.type == device:
            msg = f"the image of a mesh on {device} is on {image.device}, its gradient on {gradient.device}"
            raise RuntimeError(msg)
        return image.detach().cpu(), gradient.cpu(), milliseconds

    expected, expected_gradient, _ = image_and_gradient("cpu")
    image_and_gradient("cuda")
    image, gradient, milliseconds = image_and_gradient("cuda")
    yield Result("mesh.draw: error of the image", relative(image, expected), MAX_VALUE_ERROR)
    yield Result("mesh.draw: error of the gradient", relative(gradient, expected_gradient), MAX_GRADIENT_ERROR)
    yield Result("mesh.draw: image and gradient, ms", milliseconds)


if __name__ == "__main__":
    sys.exit(main())
